"""Measures of the project itself: a name, a unit, samples and a bar; and how samples are taken."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from harness.engines.jobs import Engine
from harness.records import Cell, CellResult, Conditions
from harness.schedule.grid import Grid
from harness.schedule.plan import Silent

A = TypeVar("A")
T = TypeVar("T")
SMOKE, QUICK, FULL = (Conditions(budget, "absorbing", "sbx") for budget in ("smoke", "quick", "full"))
REPEATS = 5
SCORE = "of the expert"
"""Unit of normalised scores."""
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class Measure:
    """A measured quantity. `unit`: 'times' as fast, 's', 'ms', '%', 'MB' of memory, or 'of the expert'.
    `bar`: the least median of ratios and scores, the largest one of the others."""

    name: str
    unit: str
    samples: list[float]
    bar: float

    @property
    def missed(self) -> bool:
        """True where the median is on the wrong side of the bar."""
        median = statistics.median(self.samples)
        return median < self.bar if self.unit in ("times", SCORE) else median > self.bar

    def to_json(self) -> dict[str, Any]:
        """Return name, unit, median, smallest and largest sample, and bar."""
        low, high = min(self.samples), max(self.samples)
        middle = {"median": statistics.median(self.samples), "low": low, "high": high}
        return {"name": self.name, "unit": self.unit, **middle, "bar": self.bar}

    def __str__(self) -> str:
        text = "{name}: {median:.4g} {unit} ({low:.4g} to {high:.4g}), bar {bar:g}".format(**self.to_json())
        return text + " MISSED" * self.missed


def compare(
    name: str, ours: Callable[[], int], theirs: Callable[[], int], bar: float, repeats: int = REPEATS
) -> Measure:
    """Return how many times as fast ours is. Both return how much work they did, and take turns, because a
    machine's speed changes. The first turn does not count."""

    def rate(work: Callable[[], int]) -> float:
        started = time.perf_counter()
        return work() / (time.perf_counter() - started)

    ratios = []
    for repeat in range(repeats + 1):
        rates = {work: rate(work) for work in ((ours, theirs) if repeat % 2 else (theirs, ours))}
        ratios.append(rates[ours] / rates[theirs])
    return Measure(name, "times", ratios[1:], bar)


def command(arguments: Sequence[str]) -> float:
    """Return the seconds that `python -m harness` takes with these arguments, in a process of its own."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-m", "harness", *arguments], check=True, capture_output=True)
    return time.perf_counter() - started


class Collected(Silent):
    """A sink that keeps results in the order in which they come."""

    def __init__(self) -> None:
        self.results: list[CellResult] = []

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.results.append(result)


def compute(cells: list[Cell], conditions: Conditions, engine: Engine) -> list[CellResult]:
    """Return the cells' results in the order in which they came. Raises RuntimeError where one failed."""
    sink = Collected()
    with contextlib.redirect_stdout(io.StringIO()):
        Grid(conditions, sink, engine).run(cells)
    for row in (row for result in sink.results for row in result.rows):
        if row.status == "failed":
            raise RuntimeError(f"a cell failed: {row.reason}")
    return sink.results


def apart(work: Callable[[A], T], argument: A) -> T:
    """Return what the work returns in a process of its own."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(work, argument).result()
