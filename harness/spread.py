"""What `bench` says of runs on a Ray cluster, on clusters of this machine."""

from __future__ import annotations

import contextlib
import io
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace

from harness.bench import CONDITIONS, Measure, compute
from harness.engines.jobs import Engine
from harness.engines.processes import Processes
from harness.engines.ray import Ray
from harness.growth import SMOKE
from harness.judge.results import Cell, CellResult, Shown
from harness.local_cluster import local_cluster
from harness.run.grid import Grid

FEW, REPEATS = 2, 3
"""Times that a comparison of many minutes, and of seconds, is repeated."""
FULL = replace(CONDITIONS, budget="full")
EQUAL = [Cell("cartpole", "control_true", seed) for seed in range(24)]
SMALL = [Cell("cartpole", "bc", 0, Shown(demos)) for demos in range(1, 13)]
"""Of one group, and with next to no work."""


def spread() -> Iterator[Measure]:
    """Every figure, as it is measured. Raises RuntimeError where a cell failed, or without Ray."""
    os.environ["RAY_AUTH_MODE"] = "disabled"
    faster = [_seconds(1) / _seconds(2) for _ in range(FEW)]
    yield Measure(
        f"{len(EQUAL)} equal cells, two nodes of a cluster against one", "times", faster, bar=1 / 0.6
    )
    added = [1000 * (_for_each(Ray("", 1)) - _for_each(Processes(1))) for _ in range(REPEATS)]
    yield Measure("a cell on a Ray cluster, what it takes more than here", "ms", added, bar=None)


def _seconds(nodes: int) -> float:
    """Of equal cells on a cluster that did nothing before, which is there already."""
    with local_cluster(nodes) as cluster:
        began = time.perf_counter()
        compute(EQUAL, FULL, Ray(cluster.address, None))
        return time.perf_counter() - began


class _Times:
    """A sink that knows when results came."""

    def __init__(self) -> None:
        self.at: list[float] = []

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.at.append(time.perf_counter())

    def log(self, printed: bytes) -> None: ...

    def learned(self, cell: Cell) -> bytes:
        return b""


def _for_each(engine: Engine) -> float:
    """Seconds from one small cell to the next. The first waits for imports, and does not count."""
    times = _Times()
    with contextlib.redirect_stdout(io.StringIO()):
        Grid(SMOKE, times, engine).run(SMALL)
    return (times.at[-1] - times.at[0]) / (len(SMALL) - 1)
