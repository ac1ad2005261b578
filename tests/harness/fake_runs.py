"""Runs of fake_cells.py: how tests start them, and what they leave."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from harness.engines.jobs import Job
from harness.engines.processes import Processes
from harness.records import CONTROLS, LEARNED, REFERENCE, Cell, CellResult, Conditions
from harness.registry.keys import cell_keys
from harness.schedule.grid import Grid
from tests.harness.small_runs import names, stored

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FAKE = [sys.executable, str(HERE / "fake_cells.py")]
FAKE_ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
SMOKE = ("run", "--budget", "smoke", "--envs", "cartpole")
PER_SEED = 1 + len(CONTROLS)
CONDITIONS = Conditions("smoke", "absorbing", "sb3")


class Found:
    """A sink that holds what came; what was printed goes to run.log in the directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.results: list[CellResult] = []
        self.files: dict[str, bytes] = {}

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.results.append(result)
        self.files |= {f"{result.cell.name} {name}": data for name, data in files.items()}

    def handed_on(self, cell: Cell) -> Mapping[str, bytes]:
        learned = self.files.get(f"{cell.name} {LEARNED}")
        return {LEARNED: learned} if learned else {}

    def log(self, printed: bytes) -> None:
        with (self.directory / "run.log").open("ab") as file:
            file.write(printed)


def compute(directory: Path, cells: Sequence[Cell], workers: int = 1, timeout: float | None = None) -> Found:
    """Return what a grid of fake cells finds; the directory must be there."""
    found = Found(directory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRL_BENCH_FAKES", str(directory))
        patch.syspath_prepend(HERE)
        patch.setenv("PYTHONPATH", str(HERE), prepend=os.pathsep)
        engine = Processes(workers, timeout, work="fake_cells", preload="fake_preload")
        Grid(CONDITIONS, found, engine).run(cells)
    return found


def prepared(directory: Path, source: str, deterministic: bool = True) -> Mapping[str, bytes]:
    """Return what the `prepare` of a module of this source returns in a worker."""
    (directory / "prepares.py").write_text(source)
    cell = Cell("cartpole", REFERENCE, 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(directory), str(HERE)]))
        engine = Processes(1, deterministic=deterministic, work="prepares", preload="fake_preload")
        (key,) = cell_keys([cell], CONDITIONS, engine.variables).values()
        with engine:
            engine.submit(Job((cell,), True, CONDITIONS, key))
            while not (ended := engine.completed()):
                pass
    ((_, outcome),) = ended
    assert not outcome.error, outcome.error
    return outcome.files


def faults(tmp_path: Path, **behaviour: str) -> None:
    (tmp_path / "faults.json").write_text(json.dumps(behaviour))


def computed(directory: Path) -> list[str]:
    return (directory / "computed.txt").read_text().split()[::2]


def scores(directory: Path) -> dict[str, str]:
    """Return what the stored cells hold, but for when they were stored and how long they took."""
    known = {name: stored(directory, name) for name in names(directory)}
    return {name: json.dumps({**cell, "finished": "", "seconds": {}}) for name, cell in known.items()}
