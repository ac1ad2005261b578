"""Results of a run as pandas frames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import BinaryIO

import pandas as pd

from harness.judge.leaderboard import Entry
from harness.records import CellResult, Row
from harness.registry import BadInput, ours
from harness.report.tables import read_csv
from harness.store.database import FILE
from harness.store.files import opened
from harness.store.opening import open_to_verify

NUMBERS = ("int", "float", "bool", "Count", "Seed")
"""Types of columns of numbers."""
TEXTS: Mapping[str, type] = {
    **{field.name: str for kind in (Row, Entry) for field in fields(kind) if field.type not in NUMBERS},
    **dict.fromkeys(("budget", "rl", "program", "finished"), str),
}
"""Columns of texts. Some look like numbers."""
CURVES = ["env", "method", "seed", "dynamics", "demos", "curve", "x", "y"]


@dataclass(frozen=True, repr=False)
class Results:
    """The results in a run's directory."""

    directory: Path
    scores: pd.DataFrame
    """A row for each policy of each cell, as in scores.csv."""
    leaderboard: pd.DataFrame
    """A row for each policy of each board, over its seeds, as in leaderboard.csv."""
    curves: pd.DataFrame
    """A row for each point of each training curve. Tables without a run have none."""

    @property
    def failed(self) -> pd.DataFrame:
        """The rows of failed cells, with their reasons."""
        return self.scores[self.scores["status"] == "failed"]

    def __repr__(self) -> str:
        cells = self.scores[["env", "method", "seed"]].drop_duplicates()
        sizes = f"{len(cells)} cells, {len(self.failed)} failed rows"
        return f"Results({str(self.directory)!r}: {sizes}; scores, leaderboard and curves are frames)"


@ours.meanwhile()
def load(directory: Path | str) -> Results:
    """Return the results in a run's directory, or the tables in a folder without a run.

    Raises BadInput where there are none, or a run's tables are not as they were written.
    """
    folder = Path(directory)
    try:
        if not os.path.lexists(folder / FILE):
            return _results(folder, opened, ())
        with open_to_verify(folder) as run:
            return _results(folder, run.opened, run.load()[0].values())
    except (OSError, ValueError) as error:
        raise BadInput(f"{folder} holds no finished run: {error}") from error


def _results(
    folder: Path, opened: Callable[[Path], AbstractContextManager[BinaryIO]], cells: Iterable[CellResult]
) -> Results:
    with opened(folder / "scores.csv") as file:
        scores = read_csv(file, TEXTS)
    with opened(folder / "leaderboard.csv") as file:
        leaderboard = read_csv(file, TEXTS)
    points = [
        (cell.env, cell.method, cell.seed, cell.dynamics, cell.shown.demos, name, x, y)
        for result in cells
        for cell in [result.cell]
        for name, curve in result.curves.items()
        for x, y in curve
    ]
    return Results(folder, scores, leaderboard, pd.DataFrame(points, columns=CURVES))
