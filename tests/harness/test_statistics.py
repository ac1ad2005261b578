from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from harness.statistics import interquartile_interval, interquartile_mean, mean_interval


def test_interval_of_coin_flips_has_binomial_quantiles() -> None:
    """Resampled means of k ones in n are Binomial(n, k/n)/n, so their quantiles are known exactly."""
    low, high = mean_interval([1.0] * 30 + [0.0] * 70)
    assert low == pytest.approx(binom.ppf(0.025, 100, 0.3) / 100, abs=0.0101)
    assert high == pytest.approx(binom.ppf(0.975, 100, 0.3) / 100, abs=0.0101)


def test_interval_covers_the_mean_of_normal_values_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(100):
        low, high = mean_interval(rng.normal(3.0, 2.0, 40).tolist())
        covered += low <= 3.0 <= high
    assert 88 <= covered <= 99


def test_interval_moves_and_scales_with_the_values() -> None:
    values = np.array([0.1, 0.5, 0.7, 1.3])
    low, high = mean_interval(values.tolist())
    moved = mean_interval((10 + 3 * values).tolist())
    assert moved == pytest.approx((10 + 3 * low, 10 + 3 * high))
    assert 0.1 <= low < values.mean() < high <= 1.3


def test_interval_reproduces_whatever_the_order_and_the_global_generator() -> None:
    first = mean_interval([3.0, 1.0, 2.0])
    np.random.seed(7)  # noqa: NPY002
    assert mean_interval([1.0, 2.0, 3.0]) == first


def test_one_value_has_no_interval_and_equal_values_have_an_empty_one() -> None:
    assert all(math.isnan(bound) for bound in (*mean_interval([4.0]), *mean_interval([])))
    assert mean_interval([4.0, 4.0, 4.0]) == (4.0, 4.0)


def test_interquartile_mean_ignores_the_outer_quarters() -> None:
    assert interquartile_mean([-1e9, 1.0, 2.0, 1e9]) == 1.5
    assert interquartile_mean([3.0, 1.0, 2.0]) == 2.0  # too few to cut: the plain mean
    assert interquartile_mean([8, 1, 2, 3, 4, 5, 6, 7]) == 4.5
    assert math.isnan(interquartile_mean([]))


def test_interquartile_interval_resamples_within_tasks_only() -> None:
    """Runs that do not vary within their task leave nothing to resample, however far tasks lie apart."""
    assert interquartile_interval([[0.0, 0.0], [1.0, 1.0]]) == (0.5, 0.5)
    low, high = interquartile_interval([[0.0, 0.2, 0.1], [0.9, 1.0, 1.1]])
    assert low < interquartile_mean([0.0, 0.2, 0.1, 0.9, 1.0, 1.1]) < high
    assert all(math.isnan(bound) for bound in interquartile_interval([[1.0, 2.0], [3.0]]))


def test_interquartile_interval_of_one_small_task_is_that_of_the_mean() -> None:
    """Of three values nothing is cut, so both intervals are of the mean; they differ by resampling only."""
    runs = [1.0, 2.0, 4.0]
    assert interquartile_interval([runs]) == pytest.approx(mean_interval(runs), abs=0.05)


@pytest.mark.parametrize("function", [mean_interval, interquartile_mean])
def test_values_that_are_not_finite_are_refused(function) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="finite"):
        function([1.0, math.nan])
