"""Stand-ins for `harness.cell.run`. A cell does what its method is called, or what the file faults.json
beside the run's directory says for the cell's name; an env named 'nowhere' has no expert.

As a script it is the real command line with these cells, for tests that send it signals.
"""

import functools
import json
import math
import os
import random
import signal
import sys
import tempfile
import threading
import time
import types
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from harness.cell.phases import Phase
from harness.engines.jobs import Engine
from harness.process.environment import SAME_INSTRUCTIONS
from harness.records import Cell, CellResult, Conditions, Row, policies_of, row_of
from harness.report.model import Report
from harness.store.store import REBUILT, Store


class Panic(BaseException):
    """As those of libraries written in Rust: no Exception, and not to be pickled."""

    def __reduce__(self) -> str:
        raise TypeError("cannot pickle")


HERE = str(Path(__file__).parent)
PRELOAD = "fake_preload"
FOLDER = "IRL_BENCH_FAKES"
"""The variable that says where the run's directory is, for these cells alone."""


def prepare(cells: tuple[Cell, ...], conditions: Conditions) -> dict[str, bytes]:
    if cells[0].env == "nowhere":
        raise RuntimeError("no gradient")
    return {"shared": cells[0].env.encode()}


def run_cell(
    cell: Cell, conditions: Conditions, inputs: Mapping[str, bytes], tell: Callable[[Phase], None]
) -> tuple[CellResult, dict[str, bytes]]:
    tell(Phase("computing"))
    assert inputs == {"shared": cell.env.encode()}
    return faked(cell, conditions, Path(os.environ[FOLDER])), {}


def _hoard() -> None:
    hoard = []
    while True:  # Untouched memory takes none, but counts.
        hoard.append(np.empty(1 << 27))


def _look_for_temporary_files() -> None:
    assert list(Path(tempfile.gettempdir()).iterdir()) == []
    (Path(tempfile.gettempdir()) / "large").write_bytes(bytes(1 << 20))


def _change_the_process() -> None:
    os.chdir("/")
    os.environ["OMP_NUM_THREADS"] = "7"


RAISES = {
    "raise": ValueError("two\nlines"),
    "panic": Panic("index out of bounds"),
    "surrogate": ValueError("caf\udce9 \x1b[2J"),
    "exit": SystemExit("gave up"),
}
DOES: dict[str, Callable[[], object]] = {
    "vanish": lambda: os._exit(0),
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "group": lambda: (os.kill(0, signal.SIGTERM), time.sleep(60)),
    "server": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "stops_itself": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "hungry": _hoard,
    "sleep": lambda: time.sleep(60),
    "slow": lambda: time.sleep(2.0),
    "brief": lambda: time.sleep(0.6),
    "looks_for_temporary_files": _look_for_temporary_files,
    "changes_its_process": _change_the_process,
    "forks": os.fork,  # and both go on
    "leaves_a_thread": lambda: threading.Thread(target=time.sleep, args=(60,), daemon=True).start(),
    "draws": lambda: print("drawn:", random.random(), np.random.random()),  # noqa: NPY002
}
"""Cells of these methods do this before they return a result, if they do."""


def faked(cell: Cell, conditions: Conditions, directory: Path) -> CellResult:
    with (directory / "computed.txt").open("a") as file:
        file.write(f"{cell.name} {os.getpid()}\n")
    print("a cell speaks; pytest here:", "pytest" in sys.modules)
    for name in SAME_INSTRUCTIONS:
        print(f"{name}={os.environ.get(name)}")
    faults = directory.parent / "faults.json"
    behaviour = json.loads(faults.read_text()).get(cell.name, "") if faults.exists() else cell.method
    if behaviour in RAISES:
        raise RAISES[behaviour]
    if behaviour.startswith("leaves_one_and_"):
        _leave_one_behind(directory)
    DOES.get(behaviour.removeprefix("leaves_one_and_"), lambda: None)()
    score = math.nan if behaviour == "nan" else 100.0 * cell.seed + len(cell.method)
    steps = 1j if behaviour == "unstorable" else 7
    if behaviour == "other":
        cell = Cell(cell.env, "bc", 99)
    curves = {"pi_R": [(0.0, math.nan), (1.0, 2.5)]}
    if behaviour == "large":
        curves |= {f"loss {i}": 1000 * curves["pi_R"] for i in range(29)}
    recordings = {"ghost.rrd": "0" * 64} if behaviour == "ghost_recording" else {}
    rows = _rows(cell, conditions, score, steps)
    return CellResult(cell, rows, curves, warnings=[f"{cell.env}: low bar"], recordings=recordings)


def _rows(cell: Cell, conditions: Conditions, score: float, steps: float | complex) -> list[Row]:
    numbers = {"episodes": 1, "return_mean": score, "return_std": 0.0, "discounted_mean": score}
    numbers |= {"discounted_std": 0.0, "length_mean": 5.0, "length_std": 0.0, "env_steps": steps}
    return [row_of(cell, policy, conditions.protocol, **numbers) for policy in policies_of(cell)]


def _leave_one_behind(directory: Path) -> None:
    """Start a process of a session of its own, which keeps every file open, with another one below it."""
    left = directory / "left_behind.txt"
    if os.fork() == 0:
        os.setsid()
        os.fork()
        with left.open("a") as file:
            file.write(f"{os.getpid()}\n")
        time.sleep(60)
        os._exit(0)
    while not left.exists() or len(left.read_text().split()) < 2:
        time.sleep(0.01)


def write_report(directory: Path, report: Report) -> list[Path]:
    for name in REBUILT:
        (directory / name).write_text(f"a table of {len(report.results)} cells\n")
    return [directory / name for name in REBUILT]


def install() -> None:
    """Make the command line use the cells and the report of this file."""
    from harness.engines import inline, processes
    from harness.schedule import grid

    Grid = grid.Grid

    def told_where(conditions: Conditions, run: Store, engine: Engine, *more: object) -> grid.Grid:
        os.environ[FOLDER] = str(run.path.absolute())
        return Grid(conditions, run, engine, *more)

    grid.Grid = told_where
    processes.Processes = functools.partial(processes.Processes, work="fake_cells", preload=PRELOAD)
    inline.Inline = functools.partial(inline.Inline, work="fake_cells")
    os.environ["PYTHONPATH"] = os.pathsep.join([HERE, *filter(None, [os.environ.get("PYTHONPATH")])])
    files = types.ModuleType("harness.report.files")
    files.write_report, files.recorded_in = write_report, lambda directory: ()
    sys.modules["harness.report.files"] = files


if __name__ == "__main__":
    from harness.__main__ import start

    # What a worker of pytest starts inherits that it ignores Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    install()
    sys.exit(start())
