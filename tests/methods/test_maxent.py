"""Maximum-entropy IRL raises the reward where demonstrations go and lowers it where the learner goes."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from methods.base import Array, Episodes
from methods.maxent import MaxEnt
from tests.methods.worlds import constant, demonstrate

METHOD = MaxEnt(iterations=2, reward_steps=200, rollouts=20, averaged=1)


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
