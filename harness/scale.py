"""What `bench` says of 100,000 cells and 100,000 rows: the driver's work, the store's, the report's, and the
memory of each."""

from __future__ import annotations

import contextlib
import io
import math
import resource
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from harness.bench import Measure
from harness.growth import MEGABYTE, SMOKE, apart
from harness.judge.results import (
    ALL_SHOWN,
    CONTROLS,
    REFERENCE,
    Cell,
    CellResult,
    Request,
    Shown,
    policies_of,
    row_of,
)
from harness.registry import ENVS
from harness.registry.keys import cell_keys
from harness.registry.machine import origin
from harness.run.codec import encode
from harness.run.engines import Job, Outcome
from harness.run.files import write_atomic
from harness.run.grid import Grid, Sink
from harness.run.opening import open_for_run
from harness.run.plan import Simulated
from harness.run.reporting import write_report

MANY, STORED, WORKERS = 100_000, 10_000, 1000
TASKS, METHODS = 10, ("bc", "shaped")
"""With the controls ten cells a task and seed."""
SHAPES = {
    "of many seeds": (5, 10, 1, 689),
    "of many boards": (5, 10, 100, 8),
    "of one seed": (5, 100, 100, 1),
}
"""Of runs of 100,000 rows, as of `Shape`."""
FAULTS = 0.01
"""The share of jobs that fail, and of those that are lost the first time."""
CURVE = 59
"""Points of a curve, as those of RL have at full."""


def scale() -> Iterator[Measure]:
    """Every figure, as it is measured, once each."""
    found = apart(drive, MANY)
    name = f"{found.cells:,} cells on {WORKERS:,} simulated workers"
    yield Measure(f"{name}, the driver's work for each", "ms", [found.milliseconds], bar=5)
    yield Measure(f"{name}, the same on its processor", "ms", [found.cpu], bar=5)
    yield Measure(f"{name}, what the driver holds more", "MB", [found.megabytes], bar=2000)
    yield Measure(f"{name}, simulated time without work", "%", [found.idle], bar=None)
    found = apart(drive_and_store, STORED)
    name = f"{found.cells:,} cells, stored"
    yield Measure(f"{name}, the driver's work for each", "ms", [found.milliseconds], bar=None)
    yield Measure(f"{name}, the same on its processor", "ms", [found.cpu], bar=5)
    yield Measure(f"{name}, loading each", "ms", [found.loading], bar=None)
    yield Measure("a synced file as large as a cell's, by itself", "ms", [synced(1000)], bar=None)
    for name, shape in SHAPES.items():
        rows, seconds, cpu, megabytes = apart(report, shape)
        yield Measure(f"a report of {rows:,} rows, {name}", "s", [seconds], bar=60)
        yield Measure(f"a report of {rows:,} rows, {name}, on its processor", "s", [cpu], bar=60)
        yield Measure(f"a report of {rows:,} rows, {name}", "MB", [megabytes], bar=None)
    yield Measure(f"keys of {MANY:,} cells", "s", [apart(keys_of, MANY)], bar=None)


@dataclass(frozen=True)
class Driven:
    """Of so many cells: milliseconds that the driver takes for each, in all and on its processor, without
    the engine's; MB that its process gained; and the share of its workers' time, in %, without work."""

    cells: int
    milliseconds: float
    cpu: float
    megabytes: float
    idle: float
    loading: float = math.nan
    """Milliseconds that loading a cell takes, where they were stored."""


class Account:
    """A sink that hands on what it is given, and knows what is missing."""

    def __init__(self, sink: Sink | None = None) -> None:
        self.saved: set[Cell] = set()
        self.failed = 0
        self._sink = sink

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        if result.cell in self.saved:
            raise RuntimeError(f"{result.cell.name} came twice")
        self.saved.add(result.cell)
        self.failed += result.rows[0].status == "failed"
        if self._sink:
            self._sink.save(result, files)

    def log(self, printed: bytes) -> None:
        if self._sink:
            self._sink.log(printed)

    def learned(self, cell: Cell) -> bytes:
        return self._sink.learned(cell) if self._sink else b""


class Faulty:
    """What jobs do on simulated workers: durations of all sizes, results as large as real ones, and faults.

    seconds, cpu: what it took itself. lost: how often a job was lost.
    """

    def __init__(self, seed: int = 0) -> None:
        self.seconds = self.cpu = 0.0
        self.lost = self.errors = 0
        self._rng = np.random.default_rng(seed)
        self._tried: set[str] = set()

    def __call__(self, job: Job) -> tuple[float, Outcome]:
        began, cpu = time.perf_counter(), time.process_time()
        try:
            takes = float(self._rng.lognormal(3.0, 1.0))
            first = job.name not in self._tried
            if first and self._rng.random() < FAULTS:
                self._tried.add(job.name)
                self.lost += 1
                return takes, Outcome(error="its node is gone", lost=True)
            if not job.shared and self._rng.random() < FAULTS:
                self.errors += 1
                return takes, Outcome(error="no luck", log=b"no luck\n")
            return takes, Outcome() if job.shared else Outcome(encode(result_of(job.cells[0], self._rng)))
        finally:
            self.seconds += time.perf_counter() - began
            self.cpu += time.process_time() - cpu


def request_of(cells: int) -> Request:
    """Of so many cells, about, of real tasks and methods."""
    return Request(METHODS, tuple(ENVS)[:TASKS], tuple(range(max(1, cells // 100))), SMOKE)


def drive(count: int) -> Driven:
    """The real scheduler, and nothing stored."""
    return _driven(request_of(count), Account(), {})


def drive_and_store(count: int) -> Driven:
    """The real scheduler, and every result in a run's directory."""
    request = request_of(count)
    with tempfile.TemporaryDirectory() as folder, open_for_run(Path(folder) / "run", request, {}) as run:
        found = _driven(request, Account(run), {})
        began = time.perf_counter()
        cells, _ = run.load()
        if cells.keys() != {*request.cells}:
            raise RuntimeError(f"of {found.cells} cells {len(cells)} can be loaded")
        return replace(found, loading=1000 * (time.perf_counter() - began) / found.cells)


def _driven(request: Request, sink: Account, variables: Mapping[str, str]) -> Driven:
    """Raises RuntimeError where a cell did not come, or came twice."""
    cells, does = request.cells, Faulty()
    engine = Simulated(WORKERS, does, variables)
    memory = psutil.Process().memory_info().rss
    began, cpu = time.perf_counter(), time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        Grid(request.conditions, sink, engine).run(cells)
    took, took_cpu = time.perf_counter() - began - does.seconds, time.process_time() - cpu - does.cpu
    if sink.saved != {*cells} or sink.failed != does.errors:
        raise RuntimeError(f"of {len(cells)} cells {len(sink.saved)} came, {sink.failed} of them failed")
    return Driven(
        len(cells),
        1000 * took / len(cells),
        1000 * took_cpu / len(cells),
        max(0, _most_held() - memory) / MEGABYTE,
        100 * (1 - engine.busy / (WORKERS * engine.now)),
    )


def _most_held() -> int:
    """Bytes of this process's memory, at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def synced(count: int) -> float:
    """Milliseconds of writing a file as large as a cell's, of so many, as a run writes them: most of it the
    disk's."""
    data = encode(result_of(Cell("cartpole", "bc", 0), np.random.default_rng(0)))
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        for number in range(count):
            write_atomic(Path(folder) / str(number), data)
        return 1000 * (time.perf_counter() - began) / count


def keys_of(count: int) -> float:
    """Seconds of the keys of so many cells, about, half of which differ by what is shown."""
    methods, shown = ("bc", "shaped", "gail", "airl"), tuple(Shown(n) for n in range(1, 101))
    seeds = max(1, count // (TASKS * len(shown) * 8))
    request = Request(methods, tuple(ENVS)[:TASKS], tuple(range(seeds)), SMOKE, shown)
    began = time.perf_counter()
    cell_keys(request.cells, request.conditions, {})
    return time.perf_counter() - began


Shape = tuple[int, int, int, int]
"""Tasks, methods, ways to show, seeds."""


def made_up(shape: Shape) -> tuple[Request, list[CellResult]]:
    """A run, and results of all its cells, which nobody computed."""
    tasks, methods, shown, seeds = shape
    rng = np.random.default_rng(0)
    request = Request(
        tuple(f"method{i}" for i in range(methods)),
        tuple(f"task{i}" for i in range(tasks)),
        tuple(range(seeds)),
        SMOKE,
        tuple(map(Shown, range(1, shown + 1))) if shown > 1 else (ALL_SHOWN,),
    )
    return request, [_stored(result_of(cell, rng)) for cell in request.cells]


def _stored(result: CellResult) -> CellResult:
    """As it is once it is stored, with recordings of seed 0."""
    cell = result.cell
    recordings = {f"{cell.name}__{policy}.rrd": "0" * 64 for policy in policies_of(cell)}
    facts: dict[str, Any] = {"origin": origin(), "finished": "2026-01-01 00:00", "key": "task:method"}
    return replace(result, recordings={} if cell.seed else recordings, **facts)


def report(shape: Shape) -> tuple[int, float, float, float]:
    """Rows of a run, the seconds in which its tables, figures and page are written, in all and on the
    processor, and the most MB that this process ever held."""
    request, results = made_up(shape)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "recordings").mkdir()
        for name in (name for result in results for name in result.recordings):
            (Path(folder) / "recordings" / name).touch()
        began, cpu = time.perf_counter(), time.process_time()
        write_report(Path(folder), request, results)
        took = time.perf_counter() - began, time.process_time() - cpu
    return sum(len(result.rows) for result in results), *took, _most_held() / MEGABYTE


def result_of(cell: Cell, rng: np.random.Generator) -> CellResult:
    """A result that nobody computed, with all that a real one has."""
    columns: dict[str, Any] = {
        **{"episodes": 100, "return_std": 1.0, "discounted_mean": 9.0, "discounted_std": 0.1},
        **{"length_mean": 90.0, "length_std": 1.0, "reward_distance": 0.1, "reward_floor": 0.01},
        **{"reward_rank": 0.9, "policy_ranking": 0.8, "own_return": 5.0, "own_return_shown": 6.0},
        **{"fit_seconds": 1.0, "env_steps": 1000, "check_steps": 100, "rl_solves": 1},
        **{"expert": "shipped: 01234567", "pairs": 100},
    }
    rows = [
        row_of(cell, policy, "absorbing", return_mean=_level(cell, policy) + 0.5 * rng.normal(), **columns)
        for policy in policies_of(cell)
    ]
    names = ("expert",) if cell.method == REFERENCE else ("pi_R", "pi_R_true", "loss")
    curves = {name: [(float(x), rng.normal()) for x in range(CURVE)] for name in names}
    endings = {policy: {"time limit": 70, "fell": 30} for policy in policies_of(cell)}
    seconds = {"start": 0.5, "fit": 4.0, "retrain": 5.0, "score": 1.0}
    return CellResult(cell, rows, curves, endings, details={"networks": 3.0}, seconds=seconds)


def _level(cell: Cell, policy: str) -> float:
    """The mean return, 0 to 10, so that methods and controls are told apart."""
    known = {"expert": 10.0, "random": 0.0, "pi_star": 9.0}
    if policy in known:
        return known[policy]
    return 2.0 if cell.method in CONTROLS[1:] else 8.0
