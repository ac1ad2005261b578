"""Intervals, means and ranks are those of the literature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm, sem, spearmanr, t

from harness.judge.statistics import (
    CONFIDENCE,
    RESAMPLES,
    interquartile_interval,
    interquartile_mean,
    mean_interval,
    normal_interval,
    rank_correlation,
)


def test_the_interval_is_students_whatever_the_order() -> None:
    values = [1.0, 2.0, 4.0, 4.5]
    expected = t.interval(0.95, 3, loc=np.mean(values), scale=sem(values))
    assert mean_interval(values) == pytest.approx(expected)
    assert mean_interval(values[::-1]) == mean_interval(values)
    assert normal_interval(3.0, 0.5) == pytest.approx(norm.interval(0.95, 3.0, 0.5))
    assert all(math.isnan(bound) for bound in (*mean_interval([4.0]), *mean_interval([])))
    assert mean_interval([4.0, 4.0, 4.0]) == (4.0, 4.0)


def test_interquartile_mean_ignores_the_outer_quarters_and_refuses_what_is_not_finite() -> None:
    assert interquartile_mean([-1e9, 1.0, 2.0, 1e9]) == 1.5
    assert interquartile_mean([3.0, 1.0, 2.0]) == 2.0  # too few to cut: the plain mean
    assert interquartile_mean([8, 1, 2, 3, 4, 5, 6, 7]) == 4.5
    assert math.isnan(interquartile_mean([]))
    for function in (mean_interval, interquartile_mean):
        with pytest.raises(ValueError, match="finite"):
            function([1.0, math.nan])


def test_interquartile_interval_resamples_within_tasks_only() -> None:
    """Runs that do not vary within their task leave nothing to resample, however far tasks lie apart."""
    assert interquartile_interval([[0.0, 0.0], [1.0, 1.0]]) == (0.5, 0.5)
    assert all(math.isnan(bound) for bound in interquartile_interval([[1.0, 2.0], [3.0]]))
    rng = np.random.default_rng(3)
    tasks = [rng.normal(size=count).tolist() for count in (2, 7, 300)]
    draws = np.random.default_rng(5)
    drawn = [draws.choice(np.sort(runs), (RESAMPLES, len(runs))) for runs in tasks]
    middle = np.sort(np.concatenate(drawn, axis=1))[:, 77 : 309 - 77].mean(axis=1)
    expected = np.quantile(middle, [(1 - CONFIDENCE) / 2, 1 - (1 - CONFIDENCE) / 2])
    assert interquartile_interval(tasks, seed=5) == tuple(expected)


def test_ranks_correlate_as_scipy_has_it() -> None:
    rng = np.random.default_rng(0)
    for size in (3, 10, 1000):
        one, other = rng.normal(size=size), rng.normal(size=size)
        for a, b in ((one, other), (one.round(), other.round(1)), (one, one**3), (one, -one)):
            assert rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic, abs=1e-12)
    assert math.isnan(rank_correlation(np.array([1.0, math.nan]), np.array([1.0, 2.0])))
