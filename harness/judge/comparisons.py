"""Comparisons of methods over runs and tasks (Agarwal et al. 2021).

Performance profiles and the probability of improvement have intervals of the stratified bootstrap. There is
also the Pareto front of scores and costs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from harness.records import Row

RESAMPLES = 2000
FEWEST_SEEDS, MOST_SEEDS = 3, 50
"""Seeds of a task: methods with fewer are left out, and so are seeds beyond the second number."""
Runs = Mapping[str, Sequence[float]]
"""Scores in the order of seeds, by task."""


def runs_of(
    rows: Sequence[Row], policy: str, without: Sequence[str] = ()
) -> dict[str, dict[str, list[float]]]:
    """Return the runs of each method with at least `FEWEST_SEEDS` scores in every environment but `without`,
    at most `MOST_SEEDS` in each."""
    found: dict[str, dict[str, list[float]]] = {}
    envs = {row.env for row in rows} - {*without}
    for row in rows:
        if row.policy == policy and row.env in envs and math.isfinite(row.normalized_score):
            its = found.setdefault(row.method, {}).setdefault(row.env, [])
            if len(its) < MOST_SEEDS:
                its.append(row.normalized_score)
    return {
        method: runs
        for method, runs in found.items()
        if runs.keys() == envs and min(map(len, runs.values())) >= FEWEST_SEEDS
    }


def profile(runs: Runs, levels: Sequence[float]) -> NDArray[np.float64]:
    """Return the share of runs above each of L levels, as the mean over tasks and the ends of its 95 %
    interval, (L, 3)."""

    def shares(*tasks: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        return np.stack(
            [np.mean([(task > level).mean(axis=axis) for task in tasks], axis=0) for level in levels]
        )

    tasks = [np.asarray(scores, np.float64) for scores in runs.values()]
    return np.stack([shares(*tasks), *_bootstrap(tasks, shares)], axis=-1)


def improvement(runs: Runs, others: Runs) -> tuple[float, float, float]:
    """Return the probability that a run scores more than one of the others in a random task, and the ends of
    its 95 % interval. Equal scores count half. Both have the same tasks."""
    pairs = [(np.asarray(runs[task], np.float64), np.asarray(others[task], np.float64)) for task in runs]
    count = len(pairs)

    def probability(*sides: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        tasks: NDArray[np.float64] = np.mean(
            [
                (np.sign(one[..., :, None] - other[..., None, :]) / 2 + 0.5).mean(axis=(-1, -2))
                for one, other in zip(sides[:count], sides[count:], strict=True)
            ],
            axis=0,
        )
        return tasks

    sides = [one for one, _ in pairs] + [other for _, other in pairs]
    low, high = _bootstrap(sides, probability)
    return float(probability(*sides)), float(low), float(high)


def _bootstrap(
    samples: Sequence[NDArray[np.float64]], statistic: Callable[..., NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the ends of the 95 % interval; each sample is resampled by itself."""
    from scipy.stats import bootstrap

    found = bootstrap(
        tuple(samples),
        statistic,
        n_resamples=RESAMPLES,
        batch=200,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return np.asarray(found.confidence_interval)


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the numbers of the points (cost, score) that no other one beats, by cost. A point is beaten by
    equal scores at lower cost, and by higher scores at equal cost."""
    best, kept = -math.inf, []
    for number in sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1])):
        if points[number][1] > best:
            best = points[number][1]
            kept.append(number)
    return kept
