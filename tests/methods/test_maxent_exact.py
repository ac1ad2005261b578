"""Where the model is known, maximum-entropy IRL ascends the exact likelihood, and recovers an objectworld."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from envs.gridworld import SPEC, WORLD, grid, objectworld
from envs.models import Tabular
from methods.base import Array, Episodes, Policy
from methods.maxent import MaxEnt
from methods.tabular.maxent import log_likelihood
from methods.tabular.model import (
    demonstrated,
    finite_soft_value_iteration,
    policy_value,
    state_visitations,
    value_iteration,
)
from tests.methods.worlds import FiniteWorld

HORIZON = 6
SLIPS = pytest.mark.parametrize("slip", [0.0, 0.3])
GAMMAS = pytest.mark.parametrize("gamma", [1.0, 0.8])


def wander(world: Any, count: int, seed: int = 0) -> Episodes:
    """Demonstrations of random actions."""
    rng = np.random.default_rng(seed)
    return world.rollout(lambda obs: world.random_actions(len(obs), rng), count, rng)


def naive_likelihood(tabular: Tabular, r: Array, demos: Episodes, gamma: float) -> float:
    """The sum of log pi_t(a|s) over all steps, pi_t in proportion to exp Q_t, with t steps gone."""
    v = np.zeros(len(r))
    log_policies = []
    for _ in range(HORIZON):
        q = np.array([[r[s] + gamma * row @ v for row in rows] for s, rows in enumerate(tabular.P)])
        v = logsumexp(q, axis=1)
        log_policies.insert(0, q - v[:, None])
    total = 0.0
    for obs, act in zip(demos.obs, demos.act, strict=True):
        for t, (where, choice) in enumerate(zip(obs[:-1], act, strict=True)):
            (state,) = np.flatnonzero((tabular.obs == where).all(axis=1))
            total += log_policies[t][state, choice.argmax()]
    return total


def soft_visits(tabular: Tabular, r: Array, gamma: float) -> Array:
    """(T, S, A): the state-action visitations of the soft policy."""
    _, policies = finite_soft_value_iteration(tabular.P, r, HORIZON, gamma)
    return state_visitations(tabular.P, policies, tabular.start, HORIZON)[:, :, None] * policies


@SLIPS
@GAMMAS
def test_the_gradient_is_that_of_the_demonstrations_likelihood(slip: float, gamma: float) -> None:
    tabular = grid(3, slip)
    demos = wander(FiniteWorld(tabular, HORIZON), 5)
    r = 2 * np.random.default_rng(1).normal(size=9)
    steps, size = 5 * HORIZON, 1e-5
    likelihood, gradient = log_likelihood(tabular, r, demonstrated(demos, tabular), gamma)
    assert likelihood == pytest.approx(naive_likelihood(tabular, r, demos, gamma) / steps, abs=1e-12)
    differences = [
        naive_likelihood(tabular, r + change, demos, gamma)
        - naive_likelihood(tabular, r - change, demos, gamma)
        for change in size * np.eye(9)
    ]
    assert np.abs(gradient).max() > 0.01
    np.testing.assert_allclose(gradient, np.array(differences) / (2 * size * steps), atol=1e-8)


@SLIPS
@GAMMAS
def test_the_gradient_vanishes_where_the_soft_policy_demonstrates(slip: float, gamma: float) -> None:
    tabular, rng = grid(3, slip), np.random.default_rng(0)
    r = rng.normal(size=9)
    mu = soft_visits(tabular, r, gamma)
    best, gradient = log_likelihood(tabular, r, mu, gamma)
    np.testing.assert_allclose(gradient, 0, atol=1e-12)
    assert log_likelihood(tabular, r + 7.0, mu, gamma)[0] == pytest.approx(best)
    for _ in range(20):
        assert log_likelihood(tabular, r + 0.3 * rng.normal(size=9), mu, gamma)[0] < best


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
