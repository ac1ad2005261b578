"""Growth: the memory of processes, and how it grows with cells."""

from __future__ import annotations

import resource
from collections.abc import Iterator

import psutil

from harness.benchmarks.measure import FULL, MEGABYTE, SMOKE, Measure, apart, compute
from harness.engines.inline import Inline
from harness.engines.processes import Processes
from harness.records import Cell

CELLS = 20
"""Cells of one process."""


def measures() -> Iterator[Measure]:
    """Take each measure once."""
    for env in ("pendulum", "highway"):
        peak = apart(largest_process, env)
        yield Measure(f"{env}, a cell of shaped at full, its process", "MB", [peak], bar=700)
    sizes = apart(cells_in_a_row, CELLS)
    gained = sizes[-1] - sizes[CELLS // 2 - 1]
    yield Measure(f"memory that cells {CELLS // 2 + 1} to {CELLS} of a process add", "MB", [gained], bar=10)


def largest_process(env: str) -> float:
    """Return the most memory, in MB, that one process held resident to compute a cell at full."""
    compute([Cell(env, "shaped", 1)], FULL, Processes(1))
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


def cells_in_a_row(count: int) -> list[float]:
    """Return this process's memory after each of this many equal cells, in MB."""
    sizes, engine = [], Inline()
    for _ in range(count):
        compute([Cell("cartpole", "shaped", 1)], SMOKE, engine)
        sizes.append(psutil.Process().memory_info().rss / MEGABYTE)
    return sizes
