"""Intervals of scores within a range, means of the middle half, profiles and ranks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binomtest, spearmanr

from harness.judge.statistics import (
    CONFIDENCE,
    LEVELS,
    RESAMPLES,
    interquartile_interval,
    interquartile_mean,
    mean_interval,
    profile,
    rank_correlation,
    share_interval,
)


@pytest.mark.parametrize(("successes", "n"), [(0, 1), (5, 5), (4, 5), (3, 10), (0, 10), (90, 100)])
def test_the_interval_of_successes_is_clopper_and_pearsons(successes: int, n: int) -> None:
    scores = [1.0] * successes + [0.0] * (n - successes)
    exact = binomtest(successes, n).proportion_ci(CONFIDENCE, "exact")
    assert mean_interval(scores) == pytest.approx(tuple(exact), abs=2e-6)
    share = share_interval([0.9] * successes + [0.89] * (n - successes))
    assert share == pytest.approx((successes / n, *exact), abs=2e-6)


def test_the_interval_is_a_quantile_of_random_means_whatever_the_order() -> None:
    rng, scores = np.random.default_rng(0), [0.1, 0.95, 1.02, -0.3, 0.95, 0.8]
    low, high = mean_interval(scores)
    weights, tail = rng.dirichlet(np.ones(7), 200_000), (1 - CONFIDENCE) / 2
    # -0.3 and 1.02 are the ends, because both are outside 0 and 1.
    assert low == pytest.approx(np.quantile(weights @ [*scores, -0.3], tail), abs=2e-3)
    assert high == pytest.approx(np.quantile(weights @ [*scores, 1.02], 1 - tail), abs=2e-3)
    assert mean_interval(scores[::-1]) == (low, high)


def test_equal_scores_have_a_width_and_no_score_has_no_interval() -> None:
    low, high = mean_interval([1.0] * 5)
    assert (low, high) == pytest.approx((0.05**0.2, 1.0), abs=1e-6)
    assert mean_interval([1.5] * 3)[1] == 1.5
    assert all(math.isnan(bound) for bound in mean_interval([]))
    assert all(math.isnan(value) for value in share_interval([]))


def test_a_profile_is_the_share_of_runs_that_reach_each_score() -> None:
    share, low, high = profile([[0.0, 0.5, 1.0, 1.0], [0.9, 0.9, 0.2, 1.2]])
    assert share[LEVELS.index(0.9)] == 5 / 8
    assert share[0] == 1.0
    assert (np.diff(share) <= 0).all()
    assert ((low <= share) & (share <= high)).all()
    assert low[LEVELS.index(0.9)] < high[LEVELS.index(0.9)]
    assert np.isnan(profile([[0.5], [0.5, 1.0]])[1:]).all()


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
