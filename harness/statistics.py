"""Statistics over seeds: the interquartile mean, and bootstrap intervals that reproduce."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 10_000
CONFIDENCE = 0.95


def mean_interval(values: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """The 95 % percentile bootstrap interval of the mean of independent values.

    With fewer than two values there is none: (NaN, NaN). With equal values it is that value, which says
    that they did not vary here, not that they could not. Of few values the interval is too narrow: of
    three normal ones it covers the truth 77 times in 100, of five 87 times. Equal values and `seed` give
    an equal interval, in whatever order they come. Raises ValueError for values that are not finite.
    """
    if not np.isfinite(values).all():
        raise ValueError(f"values must be finite, not {list(values)}")
    if len(values) < 2:
        return math.nan, math.nan
    ordered = np.sort(np.asarray(values, np.float64))
    if ordered[0] == ordered[-1]:
        return float(ordered[0]), float(ordered[0])
    from scipy.stats import bootstrap

    interval = bootstrap(
        (ordered,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def interquartile_mean(values: Sequence[float]) -> float:
    """The mean of the middle half: a quarter of the values, rounded down, is cut from either end
    (Agarwal et al. 2021). NaN without values. Raises ValueError for values that are not finite."""
    if not np.isfinite(values).all():
        raise ValueError(f"values must be finite, not {list(values)}")
    if not len(values):
        return math.nan
    return float(_middle_means(np.asarray(values, np.float64)))


def interquartile_interval(tasks: Sequence[Sequence[float]], seed: int = 0) -> tuple[float, float]:
    """The 95 % interval of the interquartile mean of all tasks' values together, by the stratified
    bootstrap: each task's runs are resampled among themselves (Agarwal et al. 2021).

    (NaN, NaN) where a task has fewer than two runs. Raises ValueError for values that are not finite.
    """
    if not all(np.isfinite(runs).all() for runs in tasks):
        raise ValueError("values must be finite")
    if not tasks or min(len(runs) for runs in tasks) < 2:
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    draws = [rng.choice(np.sort(runs), (RESAMPLES, len(runs))) for runs in tasks]
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(_middle_means(np.concatenate(draws, axis=1)), [tail, 1 - tail])
    return float(low), float(high)


def _middle_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interquartile means along the last axis."""
    cut = values.shape[-1] // 4
    means: NDArray[np.float64] = np.sort(values)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return means
