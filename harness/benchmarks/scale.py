"""Scale: what 100,000 cells ask of the driver and of the store, and 100,000 rows of the report."""

from __future__ import annotations

import contextlib
import io
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from harness.benchmarks.measure import MEGABYTE, SMOKE, Measure, apart
from harness.engines.jobs import Job, Outcome
from harness.records import ALL_SHOWN, CONTROLS, REFERENCE, Cell, CellResult, Shown, policies_of, row_of
from harness.registry import ENVS
from harness.registry.machine import origin
from harness.report.files import recorded_in, write_report
from harness.report.model import build
from harness.schedule.grid import Grid, Sink
from harness.schedule.plan import Silent, Simulated
from harness.store.codec import encode
from harness.store.opening import open_for_run
from harness.store.request import Request

MANY, STORED, WORKERS = 100_000, 10_000, 1000
TASKS, METHODS = 10, ("bc", "shaped")
"""Ten cells a task and seed, with the controls."""
Shape = tuple[int, int, int, int]
"""Tasks, methods, ways to show demonstrations, and seeds of a run."""
SHAPES: dict[str, Shape] = {"of many seeds": (5, 10, 1, 689), "of many boards": (5, 10, 100, 8)}
"""Runs of 100,000 rows."""
FAULTS = 0.01
"""The share of jobs that fail, and of those that are lost the first time."""
CURVE = 59
"""Points of a curve, as many as RL's have at full."""


def measures() -> Iterator[Measure]:
    """Take each measure once."""
    cells, cpu, megabytes = apart(drive, MANY)
    name = f"{cells:,} cells on {WORKERS:,} simulated workers"
    yield Measure(f"{name}, the driver's processor for each", "ms", [cpu], bar=5)
    yield Measure(f"{name}, memory that the driver adds", "MB", [megabytes], bar=2000)
    cells, cpu = apart(drive_and_store, STORED)
    yield Measure(f"{cells:,} cells, stored, the driver's processor for each", "ms", [cpu], bar=5)
    for name, shape in SHAPES.items():
        rows, seconds = apart(report, shape)
        yield Measure(f"a report of {rows:,} rows, {name}, on its processor", "s", [seconds], bar=60)


class Account(Silent):
    """A sink that counts the results of each cell, and those of failed cells."""

    def __init__(self) -> None:
        self.saved: Counter[Cell] = Counter()
        self.failed = 0

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.saved[result.cell] += 1
        self.failed += result.rows[0].status == "failed"


class Faulty:
    """Simulated work: jobs of any duration, results as large as real ones, and faults. `lost`, `errors`: how
    many jobs were lost, and failed."""

    def __init__(self) -> None:
        self.lost, self.errors = 0, 0
        self._rng = np.random.default_rng(0)
        self._tried: set[str] = set()

    def __call__(self, job: Job) -> tuple[float, Outcome]:
        takes = float(self._rng.lognormal(3.0, 1.0))
        if job.name not in self._tried and self._rng.random() < FAULTS:
            self._tried.add(job.name)
            self.lost += 1
            return takes, Outcome(error="its node is gone", lost=True)
        if not job.shared and self._rng.random() < FAULTS:
            self.errors += 1
            return takes, Outcome(error="no luck", log=b"no luck\n")
        return takes, Outcome() if job.shared else Outcome(encode(result_of(job.cells[0], self._rng)))


def request_of(cells: int) -> Request:
    """Return a request of about this many cells of real tasks and methods."""
    return Request(METHODS, tuple(ENVS)[:TASKS], tuple(range(max(1, cells // 100))), SMOKE)


def drive(count: int) -> tuple[int, float, float]:
    """Run the scheduler on about `count` simulated cells.

    Return their number, the processor's milliseconds for each, simulation included, and the MB that this
    process adds. Raises RuntimeError where a cell does not come, or comes twice.
    """
    request, account, work = request_of(count), Account(), Faulty()
    memory = psutil.Process().memory_info().rss
    cpu = _driven(request, account, work)
    cells, came = len(request.cells), account.saved.total()
    if account.saved != Counter(request.cells) or account.failed != work.errors:
        raise RuntimeError(f"of {cells} cells {came} came, {account.failed} of them failed")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return cells, cpu, max(0, most - memory) / MEGABYTE


def drive_and_store(count: int) -> tuple[int, float]:
    """Do the same with a store on disk. Raises RuntimeError where a cell cannot be loaded."""
    request = request_of(count)
    with tempfile.TemporaryDirectory() as folder, open_for_run(Path(folder) / "run", request, {}) as run:
        cpu = _driven(request, run, Faulty())
        loaded, _ = run.load()
    if loaded.keys() != {*request.cells}:
        raise RuntimeError(f"of {len(request.cells)} cells {len(loaded)} can be loaded")
    return len(loaded), cpu


def _driven(request: Request, sink: Sink, work: Faulty) -> float:
    began = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        Grid(request.conditions, sink, Simulated(WORKERS, work)).run(request.cells)
    return 1000 * (time.process_time() - began) / len(request.cells)


def made_up(shape: Shape) -> tuple[Request, list[CellResult]]:
    """Return a run's request, and made-up results of all its cells, as they are stored."""
    tasks, methods, ways, seeds = shape
    request = Request(
        tuple(f"method{i}" for i in range(methods)),
        tuple(f"task{i}" for i in range(tasks)),
        tuple(range(seeds)),
        SMOKE,
        tuple(map(Shown, range(1, ways + 1))) if ways > 1 else (ALL_SHOWN,),
    )
    rng, results = np.random.default_rng(0), []
    facts: dict[str, Any] = {"origin": origin(), "finished": "2026-01-01 00:00", "key": "task:method"}
    for cell in request.cells:
        recordings = {f"{cell.name}__{policy}.rrd": "0" * 64 for policy in policies_of(cell) if not cell.seed}
        results.append(replace(result_of(cell, rng), recordings=recordings, **facts))
    return request, results


def report(shape: Shape) -> tuple[int, float]:
    """Return a run's rows, and the processor seconds in which its tables, figures and page are written."""
    request, results = made_up(shape)
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        write_report(Path(folder), build(request, results, recorded_in(Path(folder))))
        return sum(len(result.rows) for result in results), time.process_time() - began


def result_of(cell: Cell, rng: np.random.Generator) -> CellResult:
    """Return a made-up result of about a real one's size."""
    columns: dict[str, Any] = {
        **{"episodes": 100, "return_std": 1.0, "discounted_mean": 9.0, "discounted_std": 0.1},
        **{"length_mean": 90.0, "length_std": 1.0, "reward_distance": 0.1, "reward_floor": 0.01},
        **{"reward_rank": 0.9, "policy_ranking": 0.8, "own_return": 5.0, "own_return_shown": 6.0},
        **{"fit_seconds": 1.0, "env_steps": 1000, "check_steps": 100, "rl_solves": 1},
        **{"expert": "shipped: 01234567", "pairs": 100},
    }
    trained = 2.0 if cell.method in CONTROLS[1:] else 8.0
    levels = {"expert": 10.0, "random": 0.0, "pi_star": 9.0, "pi_R": trained}
    rows = [
        row_of(cell, policy, "absorbing", return_mean=levels[policy] + 0.5 * rng.normal(), **columns)
        for policy in policies_of(cell)
    ]
    names = ("expert",) if cell.method == REFERENCE else ("pi_R", "pi_R_true", "loss")
    curves = {name: [(float(x), rng.normal()) for x in range(CURVE)] for name in names}
    endings = {row.policy: {"time limit": 70, "fell": 30} for row in rows}
    seconds = {"start": 0.5, "fit": 4.0, "retrain": 5.0, "score": 1.0}
    return CellResult(cell, rows, curves, endings, details={"networks": 3.0}, seconds=seconds)
