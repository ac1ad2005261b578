"""Comparisons of methods over runs and tasks (Agarwal et al. 2021): performance profiles and the probability
of improvement, with intervals of the stratified bootstrap; and the Pareto front of scores and costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from harness.judge.results import Row

RESAMPLES = 2000
FEWEST_SEEDS, MOST_SEEDS = 3, 50
"""Of a task: with fewer there is nothing to resample; more are left out."""
Runs = Mapping[str, Sequence[float]]
"""Scores by task, of the seeds in order."""


def runs_of(
    rows: Sequence[Row], policy: str, without: Sequence[str] = ()
) -> dict[str, dict[str, list[float]]]:
    """Of each method its runs, where it has `FEWEST_SEEDS` scores at least in every environment but those
    `without`; of these the first `MOST_SEEDS`."""
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
    """The share of runs that score more than each of L levels, the mean over tasks, and its 95 % interval's
    ends, (L, 3)."""

    def shares(*tasks: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        return np.stack(
            [np.mean([(task > level).mean(axis=axis) for task in tasks], axis=0) for level in levels]
        )

    tasks = [np.asarray(scores, np.float64) for scores in runs.values()]
    return np.stack([shares(*tasks), *_bootstrap(tasks, shares)], axis=-1)


def improvement(runs: Runs, others: Runs) -> tuple[float, float, float]:
    """The probability that a run of the first scores more than one of the others, in a task drawn at random,
    equal scores counting half; and its 95 % interval's ends. Both have the same tasks."""
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
    """The 95 % interval's ends, each sample resampled by itself."""
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
    """Numbers of the points (cost, score) that no other one beats, by cost: none scores as much for less, nor
    more for as much."""
    best, kept = -math.inf, []
    for number in sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1])):
        if points[number][1] > best:
            best = points[number][1]
            kept.append(number)
    return kept
