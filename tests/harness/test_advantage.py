"""A reward's rank correlation with the true advantage, where that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import linalg

from envs import SPECS, EnvSpec, cartpole
from envs.spec import Tabular
from harness.advantage import deviations, known_correlation, sampled_correlation
from harness.controls import Constant
from harness.seeds import rng_for
from harness.simulator import Simulator
from harness.world import TaskWorld, without_rewards
from methods.base import Array, Reward
from methods.shaped import Shaped
from methods.shaped_ml import ShapedML
from methods.tabular import value_iteration
from tests.harness.rewards import Seek

SEEDS = range(40)


def best(obs: Array) -> Array:
    """The target tasks' best policy."""
    return obs


def correlation(spec: EnvSpec, reward: Reward | None) -> float:
    return sampled_correlation(reward, deviations(spec, best, SEEDS, rng_for(0, "advantage")))


def test_a_reward_that_orders_actions_like_the_advantage_correlates_fully(steady: EnvSpec) -> None:
    # What one action misses is all that it loses: nothing depends on it later.
    assert correlation(steady, None) == pytest.approx(1)
    assert correlation(steady, Seek(scale=30.0)) == pytest.approx(1)
    assert correlation(steady, Seek(scale=-1.0)) == pytest.approx(-1)
    assert abs(correlation(steady, Seek(side=0.0))) < 0.9


def test_what_an_early_end_costs_counts(fragile: EnvSpec) -> None:
    # Missing by more than 0.5 loses every later reward, so how early it happens matters most.
    assert 0.5 < correlation(fragile, None) < 0.999


def test_a_reward_or_an_advantage_that_never_varies_has_no_correlation(steady: EnvSpec) -> None:
    assert math.isnan(correlation(steady, Constant(1.0, absorbing=1.0)))


def test_only_the_one_action_is_another(fragile: EnvSpec) -> None:
    moments, actions = np.array([0, 3, 9, 2]), np.array([[0.1], [-0.2], [0.3], [2.0]])
    kept = Simulator(fragile).run(best, range(4))
    for lanes in (1, 4):
        left = Simulator(fragile, lanes).run(best, range(4), leave=(moments, actions))
        for episode, before, moment, action in zip(left, kept, moments, actions, strict=True):
            expected = before.act.copy()
            expected[moment] = action
            np.testing.assert_array_equal(episode.act, expected[: len(episode.act)])
            np.testing.assert_array_equal(episode.obs[: moment + 1], before.obs[: moment + 1])
        assert len(left[3].act) == 3


@dataclass(frozen=True)
class TrulyShaped:
    """The grid's true reward shaped by its optimal values."""

    tabular: Tabular
    gamma: float
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        value = value_iteration(self.tabular.P, self.tabular.reward, self.gamma)[0]
        here, there = self.tabular.states(obs), self.tabular.states(next_obs)
        return self.tabular.reward[here] + self.gamma * value[there] - value[here]


def test_where_the_model_is_known_the_shaped_true_reward_correlates_fully() -> None:
    spec = SPECS["gridworld"]
    assert spec.tabular is not None
    shaped = TrulyShaped(spec.tabular, spec.gamma)
    assert known_correlation(shaped, spec.tabular, spec.gamma) > 0.99
    assert known_correlation(None, spec.tabular, spec.gamma) < 0.9


def best_feedback() -> Array:
    """(1, 4): K of the action -K obs that is best for cart-pole as it is near upright, where it is linear and
    pays 1 - angle^2 / 20 - action^2 / 10,000: a discounted linear-quadratic regulator."""
    upright = np.zeros(4)
    moved = np.eye(5) * 1e-6
    after = [cartpole.advance(upright + d[:4], cartpole.MAX_FORCE * d[4]) for d in moved]
    A, B = np.split(np.array(after).T / 1e-6, [4], axis=1)
    A, B = (np.sqrt(SPECS["cartpole"].gamma) * m for m in (A, B))
    Q, R = np.diag([0, 0, 1 / 20, 0]), np.array([[1e-4]])
    # A position that nothing is paid for still needs some weight, or the equation has no solution.
    P = linalg.solve_discrete_are(A, B, Q + 1e-12 * np.eye(4), R)
    return np.asarray(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))


@pytest.mark.parametrize("method", [Shaped(iterations=200), ShapedML(iterations=200)])
def test_of_the_best_cart_pole_policy_the_shaped_reward_is_the_advantage(method: Shaped) -> None:
    """What a learned expert leaves of less is its own distance from the best."""
    spec, K = SPECS["cartpole"], best_feedback()

    def regulate(obs: Array) -> Array:
        return np.clip(-obs @ K.T, -1, 1)

    demos = without_rewards(Simulator(spec).run(regulate, range(20)))
    learned = method.fit(demos, TaskWorld(spec, "absorbing", "sbx"), np.random.default_rng(0))
    assert learned.reward is not None
    held_out = deviations(spec, regulate, range(100, 300), np.random.default_rng(0))
    assert sampled_correlation(learned.reward, held_out) > 0.999
