"""Statistics over seeds: means, interquartile means, profiles, ranks and probabilities, with intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 10_000
AT_ONCE = 500
"""Resamples in memory at a time."""
CONFIDENCE = 0.9
"""The level of all intervals. results/studies/coverage.csv has what they cover."""
RANGE = (0.0, 1.0)
"""The range of a score in intervals of means: from the random policy to the expert."""
SUCCESS = 0.9
"""The score from which on a run succeeds."""
LEVELS = tuple(level / 10 for level in range(12))
"""Scores of a performance profile."""
Array = NDArray[np.float64]
STEP, HALVINGS = 0.125, 20
"""The step of an integral over logarithms, and the steps of a search."""
ROUNDING = 1e-9
"""The spread of values that are equal up to rounding."""
_FREQUENCIES = np.exp(np.arange(-14, 8, STEP))[:, None]


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the interval of the mean of independent scores within `RANGE` (Gaffke 2005), to four digits.

    An end is a quantile of the mean of the values and that end of the range, with weights uniform on the
    simplex. Of zeros and ones this is the interval of Clopper & Pearson (1934), so equal scores have a width.
    A score outside widens the range to itself. It is (NaN, NaN) without values. Raises ValueError for values
    that are not finite.
    """
    ordered = np.sort(_finite(values))
    if not len(ordered):
        return math.nan, math.nan
    low, high = min(RANGE[0], ordered[0]), max(RANGE[1], ordered[-1])
    return _lower_end(ordered, low), 0.0 - _lower_end(-ordered, -high)


def _lower_end(values: Array, low: float) -> float:
    """Return the quantile of the mean of `low` and the values with random weights."""
    points, tail = np.append(values, low), (1 - CONFIDENCE) / 2
    center, spread = points.mean(), points.std() / math.sqrt(len(points) + 1)
    # The bounds of Cantelli (1928) for a quantile.
    below, above = center - spread * math.sqrt(1 / tail - 1), center + spread * math.sqrt(1 / (1 / tail - 1))
    for _ in range(HALVINGS if spread > ROUNDING else 0):
        level = (below + above) / 2
        scaled = _FREQUENCIES * ((points - level) / np.linalg.norm(points - level))
        waves = np.sin(np.arctan(scaled).sum(axis=1)) * np.exp(-0.5 * np.log1p(scaled**2).sum(axis=1))
        # The probability that the mean is at most the level (Imhof 1961).
        is_above = 0.5 - waves.sum() * STEP / math.pi > tail
        below, above = (below, level) if is_above else (level, above)
    return round(float(above), 6)


def share_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the share of scores that reach `SUCCESS`, with the interval of Clopper & Pearson (1934)."""
    reached = [float(value >= SUCCESS) for value in values]
    return (math.fsum(reached) / len(reached) if reached else math.nan, *mean_interval(reached))


def interquartile_mean(values: Sequence[float]) -> float:
    """Return the mean of the middle half: a quarter of the values, rounded down, is cut from either end
    (Agarwal et al. 2021). It is NaN without values. Raises ValueError for values that are not finite."""
    return float(_middle_means(_finite(values))) if len(values) else math.nan


def interquartile_interval(tasks: Sequence[Sequence[float]], seed: int = 0) -> tuple[float, float]:
    """Return the interval of the interquartile mean of all tasks' values together.

    It is (NaN, NaN) where a task has fewer than two runs. Raises ValueError for values that are not finite.
    """
    low, high = _bootstrapped(tasks, _middle_means, seed)
    return float(low), float(high)


def profile(tasks: Sequence[Sequence[float]], seed: int = 0) -> Array:
    """Return the share of all tasks' values that reach each of `LEVELS`, and its interval, (3, L).

    Intervals are NaN where a task has fewer than two runs. Raises ValueError for values that are not finite.
    """

    def shares(values: Array) -> Array:
        return np.stack([(values >= level).mean(axis=-1) for level in LEVELS], axis=-1)

    return np.vstack(
        [shares(np.concatenate([_finite(runs) for runs in tasks])), _bootstrapped(tasks, shares, seed)]
    )


def _bootstrapped(tasks: Sequence[Sequence[float]], statistic: Callable[[Array], Array], seed: int) -> Array:
    """Return the ends of the interval of a statistic of all tasks' values together, (2, ...).

    This is the stratified bootstrap: each task's runs are resampled among themselves (Agarwal et al. 2021).
    """
    ordered = [np.sort(_finite(runs)) for runs in tasks]
    if min(map(len, ordered), default=0) < 2:
        return np.full((2, *np.shape(statistic(np.zeros(1)))), math.nan)
    rng = np.random.default_rng(seed)
    # Values instead of places would take a gigabyte for 1,000 runs of 14 tasks.
    places = [
        rng.integers(0, len(runs), (RESAMPLES, len(runs))).astype(np.min_scalar_type(len(runs)))
        for runs in ordered
    ]
    resampled = []
    for first in range(0, RESAMPLES, AT_ONCE):
        some = slice(first, first + AT_ONCE)
        drawn = [runs[rows[some]] for runs, rows in zip(ordered, places, strict=True)]
        resampled.append(statistic(np.concatenate(drawn, axis=1)))
    tail = (1 - CONFIDENCE) / 2
    return np.asarray(np.quantile(np.concatenate(resampled), [tail, 1 - tail], axis=0))


def probability_of_improvement(values: Sequence[float], others: Sequence[float]) -> float:
    """Return the probability that one of the values is larger than one of the others; equal ones count half
    (Agarwal et al. 2021, after Mann & Whitney 1947). It is NaN where either is empty."""
    if not len(values) or not len(others):
        return math.nan
    gaps = np.subtract.outer(np.asarray(values, np.float64), np.asarray(others, np.float64))
    return float(((gaps > 0) + 0.5 * (gaps == 0)).mean())


def rank_correlation(one: Array, other: Array) -> float:
    """Return Spearman's correlation; equal values share their mean rank. It is NaN where a value is."""
    if np.isnan(one).any() or np.isnan(other).any():
        return math.nan
    return float(np.corrcoef(_ranks(one), _ranks(other))[0, 1])


def _ranks(values: Array) -> Array:
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = (np.cumsum(counts) - (counts - 1) / 2)[place]
    return ranks


def _finite(values: Sequence[float]) -> Array:
    if not np.isfinite(values).all():
        raise ValueError(f"values must be finite, not {list(values)}")
    return np.asarray(values, np.float64)


def _middle_means(values: Array) -> Array:
    """Return interquartile means along the last axis."""
    cut = values.shape[-1] // 4
    means: Array = np.sort(values)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return means
