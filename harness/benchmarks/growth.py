"""Growth: the memory of processes, and how it grows with cells and workers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import psutil

from harness.benchmarks.measure import FULL, MEGABYTE, SMOKE, Measure, apart, command, compute, watch
from harness.engines.inline import Inline
from harness.engines.processes import Processes
from harness.records import Cell

CELLS = 20
"""Cells of one process."""
WORKERS = {1: 1400, 2: 2000}
"""MB that all processes of a small run may hold, by its workers."""


def measures() -> Iterator[Measure]:
    """Take each measure once."""
    for env in ("pendulum", "highway"):
        with watch() as peak:
            compute([Cell(env, "shaped", 1)], FULL, Processes(1))
        yield Measure(f"{env}, a cell of shaped at full, its process", "MB", peak[:1], bar=700)
    sizes = apart(cells_in_a_row, CELLS)
    gained = sizes[-1] - sizes[CELLS // 2 - 1]
    yield Measure(f"memory that cells {CELLS // 2 + 1} to {CELLS} of a process add", "MB", [gained], bar=10)
    for workers, bar in WORKERS.items():
        asked = f"--envs cartpole --seeds 1 --workers {workers}"
        with tempfile.TemporaryDirectory() as out, watch() as peak:
            command(f"run --methods shaped {asked} --budget smoke --out {out}".split())
        yield Measure(f"shaped and controls at smoke, {asked}, all processes", "MB", peak[1:], bar)


def cells_in_a_row(count: int) -> list[float]:
    """Return this process's memory after each of this many equal cells, in MB."""
    sizes, engine = [], Inline()
    for _ in range(count):
        compute([Cell("cartpole", "shaped", 1)], SMOKE, engine)
        sizes.append(psutil.Process().memory_info().rss / MEGABYTE)
    return sizes
