"""Maximum-entropy IRL raises the reward where demonstrations go and lowers it where the learner goes."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from methods.base import Array, Episodes
from methods.maxent import MaxEnt, drawn_by
from methods.network import Network
from methods.stochastic import EpsilonGreedy
from tests.methods.worlds import constant, demonstrate

METHOD = MaxEnt(iterations=2, reward_steps=200, rollouts=20, averaged=1)


def test_demonstrated_actions_pay_more_than_others(world: Any) -> None:
    learned = METHOD.fit(demonstrate(constant(0.7, -0.4)), world, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    obs = rng.uniform(-1, 1, (300, 3))
    shown = learned.reward(obs, constant(0.7, -0.4)(obs), obs)
    for action in ((-0.7, 0.4), (0.7, 0.6), (-0.3, -0.4)):
        assert (shown > learned.reward(obs, constant(*action)(obs), obs)).mean() > 0.95
    np.testing.assert_allclose(learned.policy(obs[:1])[0], [0.7, -0.4], atol=0.35)
    (gaps,) = learned.curves.values()
    assert len(gaps) == 2
    assert gaps[0] > 0


def test_what_absorption_pays_is_learned(world: Any, mortal_world: Any) -> None:
    still = constant(0.0, 0.0)
    lives, dies = demonstrate(still), demonstrate(still, lifetime=2)
    at = np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 3))
    reward = METHOD.fit(lives, mortal_world, np.random.default_rng(0)).reward
    assert reward.absorbing < -0.5 < 0.5 < reward(*at)[0]
    reward = METHOD.fit(dies, world, np.random.default_rng(0)).reward
    assert reward.absorbing > 0.5


def test_the_prior_bounds_the_slope(world: Any) -> None:
    # Between two actions, all else alike, the best reward rises evenly, by 1 / prior for each unit.
    world.random_actions = lambda count, rng: constant(-0.5, 0.0)(np.zeros((count, 3)))
    obs = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    rises = []
    for prior in (1.0, 4.0):
        method = MaxEnt(iterations=1, averaged=1, reward_steps=600, rollouts=20, slope_prior=prior)
        learned = method.fit(demonstrate(constant(0.5, 0.0)), world, np.random.default_rng(0))
        values = [learned.reward(obs, constant(x, 0.0)(obs), obs).mean() for x in (-0.4, 0.0, 0.4)]
        rises.append(np.diff(values))
    np.testing.assert_allclose(rises[0], rises[0].mean(), rtol=0.25)
    assert 0.4 * 0.8 < rises[0].mean() < 0.4 * 2
    np.testing.assert_allclose(rises[0], 4 * rises[1], rtol=0.4)


def test_what_the_policy_visits_is_counted_as_it_acts_by_chance(world: Any) -> None:
    acted, rollout = [], world.rollout
    obs = np.zeros((50, 3))

    def watched(policy: Callable[[Array], Array], *asked: Any) -> Episodes:
        acted.append(policy(obs))
        return rollout(policy, *asked)

    world.rollout, world.agent = watched, functools.partial(world.agent, kind="stochastic")
    METHOD.fit(demonstrate(constant(0.0, 0.0)), world, np.random.default_rng(0))
    drawn = acted[-1]
    assert len(acted) == METHOD.iterations
    assert (drawn.std(axis=0) > 0.3).all()


def test_a_policy_without_chance_is_rolled_out_as_it_is() -> None:
    learned, rng = constant(0.2), np.random.default_rng(0)
    network = Network(np.zeros(1), np.ones(1), (np.array([[1.0, 0.0]]),), (np.zeros(2),))
    obs = np.ones((3, 1))

    class Deterministic:
        policy = staticmethod(learned)

        @property
        def behaviour(self) -> Any:
            raise ValueError("it has no stochastic policy")

    class Greedy(Deterministic):
        behaviour = EpsilonGreedy(network, 0.3)

    for agent in (Deterministic(), Greedy()):
        np.testing.assert_array_equal(drawn_by(agent, rng)(obs), learned(obs))


def test_an_expert_that_hardly_moves_does_not_make_cliffs_of_its_reward(mortal_world: Any) -> None:
    still = demonstrate(constant(0.0, 0.0))
    narrow = Episodes(tuple(1e-3 * obs for obs in still.obs), still.act, still.terminated)
    reward = METHOD.fit(narrow, mortal_world, np.random.default_rng(0)).reward
    obs = np.random.default_rng(1).uniform(-0.1, 0.1, (300, 3))
    # A step of 0.01, a hundredth of the range, is many of the expert's own spreads.
    act = constant(0.0, 0.0)(obs)
    jump = np.abs(reward(obs + 0.01, act, obs) - reward(obs, act, obs))
    assert jump.mean() < 0.1


def test_one_agent_goes_on_and_the_mean_of_the_latest_rewards_is_learned_last(world: Any) -> None:
    method = MaxEnt(iterations=3, rl_share=0.007, final_share=0.009, averaged=2, reward_steps=1)
    learned = method.fit(demonstrate(constant(0.0, 0.0)), world, np.random.default_rng(0))
    found = [(steps, warm) for _, steps, warm in world.solves]
    assert found == [(7, False), (7, True), (7, True), (9, True)]
    assert learned.reward is world.solves[-1][0]
    obs, act = np.random.default_rng(1).uniform(-1, 1, (2, 30, 3))
    of = [reward(obs, act[:, :2], obs) for reward, *_ in world.solves]
    np.testing.assert_allclose(of[3], (of[1] + of[2]) / 2)
    assert learned.reward.absorbing == pytest.approx(
        (world.solves[1][0].absorbing + world.solves[2][0].absorbing) / 2
    )


def test_an_end_that_maxent_forgets_pays_no_more_than_random_steps(mortal_world: Any) -> None:
    """After one step on the reward an end pays what chance says."""
    demos = demonstrate(lambda obs: 0 * obs[:, :2])
    obs = np.random.default_rng(1).uniform(-1, 1, (5000, 3))
    act = np.random.default_rng(2).uniform(-1, 1, (5000, 2))
    for seed in range(6):
        method = MaxEnt(iterations=1, averaged=1, reward_steps=1, rollouts=1000)
        learned = method.fit(demos, mortal_world, np.random.default_rng(seed)).reward
        assert learned.absorbing < learned(obs, act, obs).mean() + 0.01
