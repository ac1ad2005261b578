"""Scores are what they claim, and so is the verdict on RL."""

from __future__ import annotations

import math

import numpy as np
import pytest

from envs import EnvSpec
from harness.judge.evaluation import evaluate, is_solved
from methods.rewards import Constant


def test_returns_are_sums_of_true_rewards(steady: EnvSpec) -> None:
    scored = evaluate(steady, lambda obs: obs, range(6))
    # Each of ten steps pays 1.
    np.testing.assert_allclose(scored.returns, 10)
    assert scored.endings == {"time limit": 6}
    assert scored.columns() == {
        "episodes": 6,
        **{"return_mean": pytest.approx(10), "return_std": pytest.approx(0)},
        **{"discounted_mean": pytest.approx((1 - 0.9**10) / 0.1), "discounted_std": pytest.approx(0)},
        **{"length_mean": 10, "length_std": 0},
    }
    worse = evaluate(steady, lambda obs: 0 * obs, [3])
    rewards = 1 - np.abs(worse.episodes[0].obs[:-1, 0])
    assert worse.discounted[0] == pytest.approx(sum(0.9**t * r for t, r in enumerate(rewards)), rel=1e-6)


def test_endings_and_returns_under_another_reward_are_counted(fragile: EnvSpec) -> None:
    scored = evaluate(fragile, lambda obs: -0.2 * obs, range(30), Constant(2.0, absorbing=0.5))
    assert scored.endings["missed"] >= (scored.lengths < 10).sum() > 10
    assert sum(scored.endings.values()) == 30
    assert len(scored.episodes[0].obs) == scored.lengths[0] + 1
    np.testing.assert_allclose(scored.own, 1.5 * scored.lengths)
    columns = scored.columns()
    assert columns["own_return"] == pytest.approx(1.5 * scored.lengths.mean())
    assert columns["length_std"] == pytest.approx(scored.lengths.std())
    endless = evaluate(fragile, lambda obs: -0.2 * obs, range(3), Constant(np.inf, absorbing=0.5))
    assert "own_return" not in endless.columns()


@pytest.mark.parametrize(
    ("own", "star", "random", "expected"),
    [
        *((10.0, 10.0, 0.0, 1), (9.5, 10.0, 0.0, 1), (9.49, 10.0, 0.0, 0), (12.0, 10.0, 0.0, 1)),
        *((-10.5, -10.0, -20.0, 1), (-10.6, -10.0, -20.0, 0)),
        *((2.9, -4.0, 3.0, 0), (3.0, -4.0, 3.0, 1), (2.9, 3.0, 3.0, 0)),
        *((-1e7, -1e7 - 1e-5, -1e7, 1), (-1e7 - 1e-5, -1e7, -1e7, 1)),
    ],
)
def test_rl_has_solved_a_reward_at_95_percent_of_what_pi_star_earns_more_than_chance(
    own: float, star: float, random: float, expected: float
) -> None:
    assert is_solved(own, star, random) == expected
    for unknown in (math.nan, math.inf, 1e101):
        for returns in ((unknown, star, random), (own, unknown, random), (own, star, unknown)):
            assert math.isnan(is_solved(*returns))
