"""Runs from Python, and what they found as pandas frames."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, SupportsIndex

import numpy as np
import pandas as pd

from harness.cli import commands
from harness.cli.arguments import parser
from harness.judge.leaderboard import Entry
from harness.records import Row
from harness.registry import KNOWN, BadInput, ours
from harness.registry import plugins as plugged_in
from harness.report.tables import read_csv
from harness.store.database import FILE
from harness.store.files import opened
from harness.store.opening import open_to_verify

DEFAULT = Path("results/latest")
NUMBERS = ("int", "float", "bool", "Count", "Seed")
"""Types of columns of numbers."""
TEXTS: Mapping[str, type] = {
    **{field.name: str for kind in (Row, Entry) for field in fields(kind) if field.type not in NUMBERS},
    **dict.fromkeys(("budget", "rl", "program", "finished"), str),
}
"""Columns of texts. Some look like numbers."""
_WANTED = {
    "methods": "names: put your class into a file, with METHODS = {'its_name': it} there, and plugins=[FILE]",
    "envs": "names: put your task into a file, with ENVS = {'its_name': it} there, and plugins=[FILE]",
    "plugins": "files, or modules, by their names",
    "options": "words of the command line",
}


@dataclass(frozen=True)
class Frames:
    """scores: a row for each policy of each cell, with the columns of `harness.records.Row`.
    `leaderboard`: those over seeds, as in leaderboard.csv."""

    scores: pd.DataFrame
    leaderboard: pd.DataFrame


def run(
    methods: Sequence[str],
    envs: Sequence[str],
    seeds: int | Sequence[int] = 1,
    budget: str = "quick",
    out: Path | str = DEFAULT,
    plugins: Sequence[Path | str] = (),
    options: Sequence[str] = (),
) -> Frames:
    """Compute the cells of a request that `out` lacks, as `irl-bench run` does, and return all of its cells.

    `seeds`: a number of seeds from 0, or a list of seeds. `plugins`: files or modules, as of `--plugin`.
    `options`: other options of `irl-bench run`, such as ["--demos", "5"].
    A failed cell is a row that says why. Plug-ins are known in this call alone, `add_plugins` aside.
    Raises `harness.registry.BadInput` for what cannot be done.
    """
    ours.first()
    lists: dict[str, Any] = {"methods": methods, "envs": envs, "plugins": plugins, "options": options}
    if not isinstance(seeds, SupportsIndex):
        lists["seeds"] = seeds
    for name, given in lists.items():
        if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
            raise BadInput(f"{name} must be a list, not {given!r:.40}")
        for one in given if name != "seeds" else ():
            if not isinstance(one, str | (Path if name == "plugins" else str)):
                raise BadInput(f"{name} must be {_WANTED[name]}, not {one!r:.80}", page="plugins")
    if isinstance(seeds, SupportsIndex):
        which = str(operator.index(seeds))
    else:
        which = ",".join(f"{seed}-{seed}" for seed in seeds)
    its_own = [f"--methods={','.join(methods)}", f"--envs={','.join(envs)}", f"--seeds={which}"]
    its_own += [f"--budget={budget}", f"--out={out}"]
    try:
        alone, none = (parser().parse_args(["run", *words]) for words in (options, ()))
    except SystemExit as error:
        raise BadInput("options cannot hold --help") from error
    for name in ("methods", "envs", "seeds", "budget", "out", "plan", "plugin"):
        if getattr(alone, name) != getattr(none, name):
            raise BadInput(f"options cannot hold --{name}")
    words = ["run", *options, *its_own, *(f"--plugin={plugin}" for plugin in plugins)]
    with KNOWN.for_now():
        commands.run(parser().parse_args(words))
    return load(out)


def add_plugins(named: Sequence[Path | str]) -> None:
    """Make known what plug-ins name, files or modules as of `--plugin`, until this process ends.

    `run` knows them then, and so does all that asks for a task, such as one that something exported is of.
    Raises BadInput for a broken one.
    """
    ours.first()
    plugged_in.add([str(name) for name in named])


def load(directory: Path | str) -> Frames:
    """Return the tables in a run's directory. Raises BadInput if it has none, or they are not as written.
    Tables in a folder without a run are taken as they are."""
    folder = Path(directory)
    files = [folder / f"{name}.csv" for name in ("scores", "leaderboard")]
    try:
        if not os.path.lexists(folder / FILE):
            return Frames(*(_table(file, opened) for file in files))
        with open_to_verify(folder) as run:
            return Frames(*(_table(file, run.opened) for file in files))
    except (OSError, ValueError) as error:
        raise BadInput(f"{folder} holds no finished run: {error}") from error


def _table(file: Path, opened: Callable[[Path], AbstractContextManager[BinaryIO]]) -> pd.DataFrame:
    with opened(file) as binary:
        return read_csv(binary, TEXTS)
