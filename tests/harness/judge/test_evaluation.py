"""Scores are what they claim."""

from __future__ import annotations

import numpy as np
import pytest

from envs import EnvSpec
from harness.judge.evaluation import evaluate, totals
from harness.rl.simulator import Simulator
from methods.base import Array
from methods.rewards import Constant


def on_target(obs: Array) -> Array:
    return obs


def test_returns_are_sums_of_true_rewards(steady: EnvSpec) -> None:
    scored = evaluate(steady, on_target, range(6))
    # Each of ten steps pays 1.
    np.testing.assert_allclose(scored.returns, 10)
    np.testing.assert_allclose(scored.discounted, (1 - 0.9**10) / (1 - 0.9))
    assert scored.lengths.tolist() == [10.0] * 6
    assert scored.endings == {"time limit": 6}
    assert scored.columns() == {
        "episodes": 6,
        **{"return_mean": pytest.approx(10), "return_std": pytest.approx(0)},
        **{"discounted_mean": pytest.approx((1 - 0.9**10) / 0.1), "discounted_std": pytest.approx(0)},
        **{"length_mean": 10, "length_std": 0},
    }


def test_later_rewards_are_discounted_more(steady: EnvSpec) -> None:
    scored = evaluate(steady, lambda obs: 0 * obs, [3])
    rewards = 1 - np.abs(scored.episodes[0].obs[:-1, 0])
    np.testing.assert_allclose(scored.episodes[0].rewards, rewards, rtol=1e-6)
    assert scored.discounted[0] == pytest.approx(sum(0.9**t * r for t, r in enumerate(rewards)), rel=1e-6)


def test_returns_under_another_reward_are_counted_from_what_absorption_pays(fragile: EnvSpec) -> None:
    scored = evaluate(fragile, lambda obs: -0.2 * obs, range(30), Constant(2.0, absorbing=0.5))
    np.testing.assert_allclose(scored.own, 1.5 * scored.lengths)
    assert scored.columns()["own_return"] == pytest.approx(1.5 * scored.lengths.mean())
    endless = evaluate(fragile, lambda obs: -0.2 * obs, range(3), Constant(np.inf, absorbing=0.5))
    assert "own_return" not in endless.columns()


def test_endings_are_counted(fragile: EnvSpec) -> None:
    scored = evaluate(fragile, lambda obs: -0.2 * obs, range(30))
    assert set(scored.endings) <= {"missed", "time limit"}
    assert sum(scored.endings.values()) == 30
    assert scored.endings["missed"] >= (scored.lengths < 10).sum() > 10
    assert len(scored.episodes[0].obs) == scored.lengths[0] + 1
    columns = scored.columns()
    assert columns["length_std"] == pytest.approx(scored.lengths.std())
    assert columns["return_mean"] == pytest.approx(scored.returns.mean())


def test_a_reward_that_writes_into_what_it_is_given_changes_nothing(steady: EnvSpec) -> None:
    class Writing(Constant):
        def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
            paid = next_obs[:, 0] - obs[:, 0]
            for array in (obs, act, next_obs):
                array[:] = 0.0
            return paid

    (episode,) = Simulator(steady).run(lambda obs: obs[:, :1] * 0.5, [0])
    before = episode.obs.copy()
    (total,) = totals(Writing(0.0, 0.0), [(episode.obs, episode.act)])
    assert total == pytest.approx(before[-1, 0] - before[0, 0])
    assert np.array_equal(episode.obs, before)
    assert episode.act.any()


def test_episodes_are_paid_one_by_one_whatever_their_lengths() -> None:
    class Step(Constant):
        def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
            return next_obs[:, 0] - obs[:, 0]

    rng = np.random.default_rng(0)
    episodes = [(rng.normal(size=(n + 1, 2)), rng.normal(size=(n, 1))) for n in (3, 1, 7)]
    paid = totals(Step(0.0, absorbing=0.5), episodes)
    np.testing.assert_allclose(paid, [o[-1, 0] - o[0, 0] - 0.5 * len(a) for o, a in episodes])
