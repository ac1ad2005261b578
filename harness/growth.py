"""What `bench` says of memory, and of how it and time grow with what is asked for."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import psutil

from harness.bench import CONDITIONS, Measure, command, compute
from harness.judge.results import Cell, CellResult, Conditions, Request, Row, Shown, policies_of
from harness.learn.seeds import rng_for
from harness.learn.world import TaskWorld
from harness.registry import ENVS, SPECS
from harness.run.codec import encode
from harness.run.engines import Inline, Job, Outcome
from harness.run.experts import demonstrations_for
from harness.run.grid import Grid
from harness.run.isolated import Isolated
from harness.run.keys import TEMPLATE, program
from harness.run.store import open_for_run
from harness.show.report import report_files
from methods.shaped import Shaped

T = TypeVar("T")
DEMONSTRATIONS = (1, 10, 100, 1000, 10_000)
CELLS = 20
MANY_ROWS, MANY_CELLS = 100_000, 10_000
SMOKE = Conditions("smoke", "absorbing", "sbx")
MEGABYTE = 1 << 20
LOOK_EVERY = 0.2
"""Seconds between looks at processes' memory."""


def growth() -> Iterator[Measure]:
    """Every figure, as it is measured, once each."""
    for env in ("pendulum", "highway"):
        conditions = Conditions("full", "absorbing", "sbx")
        with watch() as peak:
            compute([Cell(env, "shaped", 1)], conditions, Isolated(1))
        yield Measure(f"{env}, a cell of shaped at full, its process", "MB", [peak.largest], bar=700)
    sizes = apart(_cells_in_a_row, CELLS)
    gained = sizes[-1] - sizes[CELLS // 2 - 1]
    yield Measure(f"cells {CELLS // 2 + 1} to {CELLS} of one process, what they add", "MB", [gained], bar=10)
    for count in DEMONSTRATIONS:
        with watch() as peak:
            seconds = apart(_fit, count)
        yield Measure(f"shaped on {count} demonstrations of cart-pole", "s", [seconds], bar=None)
        yield Measure(f"shaped on {count} demonstrations of cart-pole", "MB", [peak.largest], bar=None)
    few, more = "cartpole", ",".join(ENVS)
    for envs, seeds, workers in ((few, 1, 1), (few, 1, 2), (few, 4, 1), (few, 4, 2), (more, 1, 2)):
        asked = f"--envs {envs} --seeds {seeds} --workers {workers}"
        with tempfile.TemporaryDirectory() as out, watch() as peak:
            options = f"run --methods shaped {asked} --budget smoke --out {out}"
            seconds = command(options.split())
        yield Measure(f"shaped and controls at smoke, {asked}", "s", [seconds], bar=None)
        yield Measure(f"shaped and controls at smoke, {asked}, all processes", "MB", [peak.total], bar=None)
    with watch() as peak:
        seconds = apart(_report, MANY_ROWS)
    yield Measure(f"a report of {MANY_ROWS:,} rows", "s", [seconds], bar=60)
    yield Measure(f"a report of {MANY_ROWS:,} rows", "MB", [peak.largest], bar=2000)
    each = 1000 * apart(_drive, MANY_CELLS) / MANY_CELLS
    yield Measure(f"the driver's work for each of {MANY_CELLS:,} cells", "ms", [each], bar=5)


class Peak:
    """The most memory so far, in MB. largest: that one process held resident, what it shares with others
    included; total: that all held, what they share counted once where the system tells (Linux)."""

    largest = 0.0
    total = 0.0


@contextlib.contextmanager
def watch() -> Iterator[Peak]:
    """Looks at this process's descendants, again and again until the context ends."""
    peak, over = Peak(), threading.Event()

    def look() -> None:
        while not over.wait(LOOK_EVERY):
            found = []
            for child in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    found.append(child.memory_full_info())
            if found:
                peak.largest = max(peak.largest, *(i.rss / MEGABYTE for i in found))
                peak.total = max(peak.total, sum(getattr(i, "pss", i.rss) for i in found) / MEGABYTE)

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        yield peak
    finally:
        over.set()
        watcher.join()


def apart(work: Callable[[int], T], argument: int) -> T:
    """What it returns in a process of its own."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(work, argument).result()


def _fit(count: int) -> float:
    """Seconds of the fit alone."""
    spec = SPECS["cartpole"]
    demos = demonstrations_for("cartpole", 0, Shown(count), CONDITIONS)
    world = TaskWorld(spec, "absorbing", "sbx")
    started = time.perf_counter()
    Shaped().fit(demos, world, rng_for(0, "growth"))
    return time.perf_counter() - started


def _cells_in_a_row(count: int) -> list[float]:
    """This process's memory after each, in MB."""
    sizes, engine = [], Inline()
    for _ in range(count):
        compute([Cell("cartpole", "shaped", 1)], SMOKE, engine)
        sizes.append(psutil.Process().memory_info().rss / MEGABYTE)
    return sizes


def made_up(methods: int, seeds: int) -> tuple[Request, list[CellResult]]:
    """A run of five tasks, and results of all its cells, which nobody computed."""
    rng = np.random.default_rng(0)
    names = tuple(f"method{i}" for i in range(methods)), tuple(f"task{i}" for i in range(5))
    request = Request(*names, tuple(range(seeds)), SMOKE)
    results = []
    for cell in request.cells:
        rows = [
            Row(
                *(cell.env, cell.method, cell.seed, policy, "absorbing"),
                return_mean=rng.normal(9.0 * (policy == "expert")),
                return_std=1.0,
                length_mean=9.0,
                discounted_mean=1.0,
                fit_seconds=1.0,
                episodes=100,
            )
            for policy in policies_of(cell)
        ]
        curve = [(float(x), rng.normal()) for x in range(30)]
        results.append(CellResult(cell, rows, {"pi_R": curve}, seconds={"fit": 1.0}))
    return request, results


def _report(rows: int) -> float:
    """Seconds of the report of so many rows, about."""
    request, results = made_up(methods=10, seeds=max(1, rows // (5 * 29)))
    started = time.perf_counter()
    report_files(request, results, program()[TEMPLATE].decode(), ())
    return time.perf_counter() - started


def _drive(count: int) -> float:
    """Seconds of all that a run does for so many cells, about, besides computing them."""
    request, results = made_up(methods=2, seeds=max(1, count // 50))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        engine = _Known({result.cell: encode(result) for result in results})
        started = time.perf_counter()
        with open_for_run(Path(folder) / "run", request, engine.variables) as run:
            Grid(request.conditions, run, engine).run(request.cells)
        return time.perf_counter() - started


class _Known(Inline):
    """An engine that has every result already."""

    def __init__(self, known: Mapping[Cell, str]) -> None:
        super().__init__()
        self._known = known

    def start(self, job: Job) -> None:
        outcome = Outcome() if job.shared else Outcome(self._known[job.cells[0]])
        self._ended.append((job, outcome))
