"""Statistics over seeds: means, interquartile means, ranks and probabilities, with 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # all of scipy.stats takes a second to import

RESAMPLES = 10_000
AT_ONCE = 500
"""Resamples in memory at a time."""
CONFIDENCE = 0.95
NORMAL = 1.959964
"""Half the normal 95 % interval, in standard errors."""


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of the mean of independent values, by Student's t.

    It is (NaN, NaN) for fewer than two values, and that value for equal ones, which does not mean that they
    could not vary. Raises ValueError for values that are not finite.
    """
    ordered = np.sort(_finite(values))
    if len(ordered) < 2:
        return math.nan, math.nan
    if ordered[0] == ordered[-1]:
        return float(ordered[0]), float(ordered[0])
    errors = float(stdtrit(len(ordered) - 1, 0.5 + CONFIDENCE / 2))
    reach = errors * float(ordered.std(ddof=1)) / math.sqrt(len(ordered))
    return float(ordered.mean()) - reach, float(ordered.mean()) + reach


def normal_interval(mean: float, error: float) -> tuple[float, float]:
    """Return the 95 % interval of a normal mean with this standard error."""
    return mean - NORMAL * error, mean + NORMAL * error


def interquartile_mean(values: Sequence[float]) -> float:
    """Return the mean of the middle half: a quarter of the values, rounded down, is cut from either end
    (Agarwal et al. 2021). It is NaN without values. Raises ValueError for values that are not finite."""
    return float(_middle_means(_finite(values))) if len(values) else math.nan


def interquartile_interval(tasks: Sequence[Sequence[float]], seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the interquartile mean of all tasks' values together, by the stratified
    bootstrap: each task's runs are resampled among themselves (Agarwal et al. 2021).

    It is (NaN, NaN) where a task has fewer than two runs. Raises ValueError for values that are not finite.
    """
    ordered = [np.sort(_finite(runs)) for runs in tasks]
    if min(map(len, ordered), default=0) < 2:
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    # Values instead of places would take a gigabyte for 1,000 runs of 14 tasks.
    places = [
        rng.integers(0, len(runs), (RESAMPLES, len(runs))).astype(np.min_scalar_type(len(runs)))
        for runs in ordered
    ]
    means = []
    for first in range(0, RESAMPLES, AT_ONCE):
        some = slice(first, first + AT_ONCE)
        drawn = [runs[rows[some]] for runs, rows in zip(ordered, places, strict=True)]
        means.append(_middle_means(np.concatenate(drawn, axis=1)))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.concatenate(means), [tail, 1 - tail])
    return float(low), float(high)


def probability_of_improvement(values: Sequence[float], others: Sequence[float]) -> float:
    """Return the probability that one of the values is larger than one of the others; equal ones count half
    (Agarwal et al. 2021, after Mann & Whitney 1947). It is NaN where either is empty."""
    if not len(values) or not len(others):
        return math.nan
    gaps = np.subtract.outer(np.asarray(values, np.float64), np.asarray(others, np.float64))
    return float(((gaps > 0) + 0.5 * (gaps == 0)).mean())


def rank_correlation(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return Spearman's correlation; equal values share their mean rank. It is NaN where a value is."""
    if np.isnan(one).any() or np.isnan(other).any():
        return math.nan
    return float(np.corrcoef(_ranks(one), _ranks(other))[0, 1])


def _ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks: NDArray[np.float64] = (np.cumsum(counts) - (counts - 1) / 2)[place]
    return ranks


def _finite(values: Sequence[float]) -> NDArray[np.float64]:
    if not np.isfinite(values).all():
        raise ValueError(f"values must be finite, not {list(values)}")
    return np.asarray(values, np.float64)


def _middle_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return interquartile means along the last axis."""
    cut = values.shape[-1] // 4
    means: NDArray[np.float64] = np.sort(values)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return means
