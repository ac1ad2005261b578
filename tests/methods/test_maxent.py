"""Maximum-entropy IRL, by a network and linear, in worlds that are sampled and where the model is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from envs.gridworld import SPEC, WORLD, grid, objectworld
from envs.models import Tabular
from methods.base import Array, Episodes, Policy, Reward
from methods.maxent import MaxEnt
from methods.maxent_linear import MaxEntLinear, moments
from methods.tabular.maxent import log_likelihood
from methods.tabular.model import (
    demonstrated,
    finite_soft_value_iteration,
    policy_value,
    value_iteration,
)
from tests.methods.worlds import FiniteWorld, constant, demonstrate


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


HORIZON, GAMMA = 12, 0.9
TABULAR = objectworld(6, 5, 2, 0.2, np.random.default_rng(3))
MODEL = TABULAR.model
WEIGHTS = np.array([1.0, -0.5, 2.0, -1.0, -2.0, 1.5])


def soft_demonstrations(count: int) -> Episodes:
    """Of the policy that is optimal in return plus entropy under w^T obs."""
    rng = np.random.default_rng(0)
    _, policies = finite_soft_value_iteration(MODEL.P, MODEL.obs @ WEIGHTS, HORIZON, GAMMA)
    obs, act = np.empty((count, HORIZON + 1, 6)), np.zeros((count, HORIZON, 5))
    for i in range(count):
        state = rng.choice(len(MODEL.start), p=MODEL.start)
        obs[i, 0] = MODEL.obs[state]
        for t in range(HORIZON):
            action = rng.choice(5, p=policies[t, state])
            act[i, t, action] = 1
            state = rng.choice(len(MODEL.start), p=MODEL.P[state, action])
            obs[i, t + 1] = MODEL.obs[state]
    return Episodes(tuple(obs), tuple(act), (False,) * count)


@pytest.fixture(scope="module")
def demos() -> Episodes:
    return soft_demonstrations(1000)


def on_states(reward: Reward) -> Array:
    return reward(MODEL.obs, np.zeros((len(MODEL.obs), 5)), MODEL.obs)


def test_a_network_without_hidden_layers_climbs_to_the_same_likelihood_and_policy(demos: Episodes) -> None:
    world: Any = FiniteWorld(replace(TABULAR, features=TABULAR.obs), HORIZON, GAMMA)
    linear = MaxEntLinear(weight_prior=0.0).fit(demos, world, np.random.default_rng(0))
    deep = MaxEnt(layers=(), iterations=600, learning_rate=1e-1).fit(demos, world, np.random.default_rng(0))
    mu_demo = demonstrated(demos, MODEL)
    best, other = (log_likelihood(MODEL, on_states(fit.reward), mu_demo, GAMMA)[0] for fit in (linear, deep))
    truth = log_likelihood(MODEL, MODEL.obs @ WEIGHTS, mu_demo, GAMMA)[0]
    start = log_likelihood(MODEL, np.zeros(len(MODEL.start)), mu_demo, GAMMA)[0]
    assert start < truth - 0.1 < truth <= best
    assert best - 1e-6 < other <= best + 1e-6
    np.testing.assert_array_equal(linear.policy(MODEL.obs), deep.policy(MODEL.obs))


def test_it_finds_the_weights_that_demonstrated(demos: Episodes) -> None:
    world: Any = FiniteWorld(replace(TABULAR, features=TABULAR.obs), HORIZON, GAMMA)
    reward: Any = MaxEntLinear(weight_prior=0.0).fit(demos, world, np.random.default_rng(0)).reward
    np.testing.assert_allclose(reward.w[:-1], WEIGHTS, atol=0.4)
    assert reward.absorbing == 0
    shrunk: Any = MaxEntLinear(weight_prior=1.0).fit(demos, world, np.random.default_rng(0)).reward
    assert np.linalg.norm(shrunk.w) < 0.5 * np.linalg.norm(WEIGHTS)


def test_elsewhere_one_agent_goes_on_until_features_match(world: Any) -> None:
    demos = demonstrate(constant(0.5, -0.3))
    learned = MaxEntLinear(iterations=30, rl_share=0.007).fit(demos, world, np.random.default_rng(0))
    (gaps,) = world.curves.values()
    assert gaps[-1] < 0.1 * gaps[0]
    assert [solve[1:] for solve in world.solves] == [(7, False), *[(7, True)] * 29]
    assert learned.reward is world.solves[-1][0]


def test_moments_count_absorbing_steps_up_to_the_horizon(mortal_world: Any) -> None:
    mean, second = moments(demonstrate(constant(0.5, -1.0), lifetime=2), mortal_world)
    np.testing.assert_allclose(mean, [0.2 * 0.5, -0.2, 0.2, 0.8])
    step = np.array([0.5, -1.0, 1.0, 0.0])
    np.testing.assert_allclose(second, 0.2 * np.outer(step, step) + 0.8 * np.diag([0, 0, 0, 1]), atol=1e-12)


STEPS = 6


def wander(world: Any, count: int, seed: int = 0) -> Episodes:
    """Demonstrations of random actions."""
    rng = np.random.default_rng(seed)
    return world.rollout(lambda obs: world.random_actions(len(obs), rng), count, rng)


def naive_likelihood(tabular: Tabular, r: Array, demos: Episodes, gamma: float) -> float:
    """The sum of log pi_t(a|s) over all steps, pi_t in proportion to exp Q_t, with t steps gone."""
    v = np.zeros(len(r))
    log_policies = []
    for _ in range(STEPS):
        q = np.array([[r[s] + gamma * row @ v for row in rows] for s, rows in enumerate(tabular.P)])
        v = logsumexp(q, axis=1)
        log_policies.insert(0, q - v[:, None])
    total = 0.0
    for obs, act in zip(demos.obs, demos.act, strict=True):
        for t, (where, choice) in enumerate(zip(obs[:-1], act, strict=True)):
            (state,) = np.flatnonzero((tabular.obs == where).all(axis=1))
            total += log_policies[t][state, choice.argmax()]
    return total


@pytest.mark.parametrize("slip", [0.0, 0.3])
@pytest.mark.parametrize("gamma", [1.0, 0.8])
def test_the_gradient_is_that_of_the_demonstrations_likelihood(slip: float, gamma: float) -> None:
    tabular = grid(3, slip)
    demos = wander(FiniteWorld(tabular, STEPS), 5)
    r = 2 * np.random.default_rng(1).normal(size=9)
    steps, size = 5 * STEPS, 1e-5
    likelihood, gradient = log_likelihood(tabular, r, demonstrated(demos, tabular), gamma)
    assert likelihood == pytest.approx(naive_likelihood(tabular, r, demos, gamma) / steps, abs=1e-12)
    differences = [
        naive_likelihood(tabular, r + change, demos, gamma)
        - naive_likelihood(tabular, r - change, demos, gamma)
        for change in size * np.eye(9)
    ]
    assert np.abs(gradient).max() > 0.01
    np.testing.assert_allclose(gradient, np.array(differences) / (2 * size * steps), atol=1e-8)


def value_difference(tabular: Tabular, policy: Policy, gamma: float) -> float:
    """The share of the true value of starting anywhere that a policy lacks."""
    best = tabular.start @ value_iteration(tabular.P, tabular.reward, gamma)[0]
    its = tabular.start @ policy_value(tabular.P, tabular.reward, policy(tabular.obs), gamma)
    return float((best - its) / best)


def test_an_objectworld_is_recovered_the_better_the_more_is_demonstrated() -> None:
    tabular = objectworld(10, 10, 2, 0.3, np.random.default_rng(0))
    differences: dict[int, list[float]] = {4: [], 128: []}
    for count, found in differences.items():
        for seed in range(2):
            world, rng = FiniteWorld(tabular, horizon=20), np.random.default_rng(seed)
            demos = world.rollout(world.optimal(), count, rng)
            learned = MaxEnt(iterations=100, learning_rate=1e-2).fit(demos, world, rng)
            found.append(value_difference(tabular, learned.policy, world.gamma))
    uniform = value_difference(tabular, lambda obs: np.full((len(obs), 5), 0.2), world.gamma)
    assert uniform > 0.5
    assert max(differences[128]) <= 0.05
    assert np.mean(differences[128]) < 0.5 * np.mean(differences[4])


def test_what_the_reward_says_holds_at_the_discount_of_the_solve() -> None:
    """A likelihood without the discount explains long journeys to the best cells by too little."""
    world, rng = FiniteWorld(WORLD, SPEC.horizon, SPEC.gamma), np.random.default_rng(0)
    demos = world.rollout(world.optimal(), 100, rng)
    learned = MaxEnt(iterations=100, learning_rate=1e-2).fit(demos, world, rng)
    assert value_difference(WORLD, learned.policy, SPEC.gamma) <= 0.05
