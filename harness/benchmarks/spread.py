"""Spread: runs on a Ray cluster of this machine."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

from harness.benchmarks.local_cluster import local_cluster
from harness.benchmarks.measure import FULL, Measure, compute
from harness.engines.ray import Ray
from harness.records import Cell

REPEATS = 2
"""Repeats of a comparison that takes many minutes."""
EQUAL = [Cell("cartpole", "control_true", seed) for seed in range(24)]


def measures() -> Iterator[Measure]:
    """Compare two nodes with one. Raises RuntimeError where a cell failed, or without Ray."""
    os.environ["RAY_AUTH_MODE"] = "disabled"
    ratios = [_seconds(1) / _seconds(2) for _ in range(REPEATS)]
    name = f"{len(EQUAL)} equal cells, two nodes of a cluster against one"
    yield Measure(name, "times", ratios, bar=1 / 0.6)


def _seconds(nodes: int) -> float:
    """Return the seconds that equal cells take on a new cluster."""
    with local_cluster(nodes) as cluster:
        began = time.perf_counter()
        compute(EQUAL, FULL, Ray(cluster.address, None))
        return time.perf_counter() - began
