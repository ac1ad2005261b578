"""Runs of fake_cells.py: how tests start them, and what they leave."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from harness.engines.processes import Processes
from harness.judge.results import CONTROLS, Cell, CellResult, Conditions, artifact_of
from harness.run.grid import Grid

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FAKE = [sys.executable, str(HERE / "fake_cells.py")]
FAKE_ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
SMOKE = ("run", "--budget", "smoke", "--envs", "cartpole")
PER_SEED = 1 + len(CONTROLS)


class Found:
    """A sink that holds what came; what was printed goes to run.log in the directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.results: list[CellResult] = []
        self.files: dict[str, bytes] = {}

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.results.append(result)
        self.files |= files

    def learned(self, cell: Cell) -> bytes:
        return self.files.get(artifact_of(cell), b"")

    def log(self, printed: bytes) -> None:
        with (self.directory / "run.log").open("ab") as file:
            file.write(printed)


def compute(directory: Path, cells: Sequence[Cell], workers: int = 1, timeout: float | None = None) -> Found:
    """What a grid of fake cells finds; the directory must be there."""
    found = Found(directory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRL_BENCH_FAKES", str(directory))
        patch.syspath_prepend(HERE)
        patch.setenv("PYTHONPATH", str(HERE), prepend=os.pathsep)
        engine = Processes(workers, timeout, work="fake_cells", preload="fake_preload")
        Grid(Conditions("smoke", "absorbing", "sb3"), found, engine).run(cells)
    return found


def faults(tmp_path: Path, **behaviour: str) -> None:
    (tmp_path / "faults.json").write_text(json.dumps(behaviour))


def computed(directory: Path) -> list[str]:
    return (directory / "computed.txt").read_text().split()[::2]


def scores(directory: Path) -> dict[str, str]:
    """What the stored cells hold, but for when they were stored and how long they took."""
    found = {}
    for path in (directory / "cells").iterdir():
        stored = json.loads(path.read_text())["result"]
        found[path.name] = json.dumps({**stored, "finished": "", "seconds": {}})
    return found
