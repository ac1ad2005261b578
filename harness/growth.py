"""What `bench` says of memory, and of how it and time grow with what is asked for."""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

import psutil

from harness.bench import CONDITIONS, Measure, command, compute
from harness.engines.inline import Inline
from harness.engines.processes import Processes
from harness.judge.results import Cell, Conditions, Shown
from harness.learn.seeds import rng_for
from harness.learn.world import TaskWorld
from harness.registry import ENVS, SPECS
from harness.run.experts import demonstrations_for
from methods.shaped import Shaped

A = TypeVar("A")
T = TypeVar("T")
DEMONSTRATIONS = (1, 10, 100, 1000, 10_000)
CELLS = 20
SMOKE = Conditions("smoke", "absorbing", "sbx")
MEGABYTE = 1 << 20
LOOK_EVERY = 0.2
"""Seconds between looks at processes' memory."""


def growth() -> Iterator[Measure]:
    """Every figure, as it is measured, once each."""
    for env in ("pendulum", "highway"):
        conditions = Conditions("full", "absorbing", "sbx")
        with watch() as peak:
            compute([Cell(env, "shaped", 1)], conditions, Processes(1))
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


def apart(work: Callable[[A], T], argument: A) -> T:
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
