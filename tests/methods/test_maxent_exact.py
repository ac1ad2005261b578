"""Where the model is known, maximum-entropy IRL ascends the exact likelihood, and recovers an objectworld."""

from __future__ import annotations

from collections.abc import Callable
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

MakeWorld = Callable[..., Any]
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


def test_demonstrated_visits_by_hand() -> None:
    """Two episodes in a grid of two by two, where states 2 and 3 lie above 0 and 1."""
    tabular, choices = grid(2, 0.0), np.eye(5)
    paths, acts = ([0, 1, 3], [0, 0, 2]), ([0, 1], [4, 1])
    demos = Episodes(
        tuple(tabular.obs[path] for path in paths), tuple(choices[act] for act in acts), (False, False)
    )
    mu = demonstrated(demos, tabular)
    expected = np.zeros((2, 4, 5))
    expected[0, 0, 0] = expected[0, 0, 4] = expected[1, 1, 1] = expected[1, 0, 1] = 0.5
    np.testing.assert_array_equal(mu, expected)


def test_demonstrations_of_unequal_length_are_refused(finite_world: MakeWorld) -> None:
    short, long = (wander(finite_world(grid(3, 0.3), horizon), 2) for horizon in (5, 6))
    demos = Episodes(short.obs + long.obs, short.act + long.act, short.terminated + long.terminated)
    with pytest.raises(ValueError, match="equally long"):
        demonstrated(demos, grid(3, 0.3))
    with pytest.raises(ValueError, match="equally long"):
        MaxEnt(iterations=1).fit(demos, finite_world(grid(3, 0.3)), np.random.default_rng(0))


@SLIPS
@GAMMAS
@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_the_gradient_is_that_of_the_demonstrations_likelihood(
    finite_world: MakeWorld, slip: float, gamma: float, scale: float
) -> None:
    tabular = grid(3, slip)
    demos = wander(finite_world(tabular, HORIZON), 5)
    r = scale * np.random.default_rng(1).normal(size=9)
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
def test_so_it_is_where_only_some_steps_are_shown(finite_world: MakeWorld, slip: float) -> None:
    tabular, gamma = grid(3, slip), 0.9
    demos = wander(finite_world(tabular, HORIZON), 5).every(3, np.random.default_rng(2))
    r = np.random.default_rng(1).normal(size=9)
    mu = demonstrated(demos, tabular)
    assert mu.sum() == pytest.approx(sum(map(len, demos.act)) / 5)

    def likelihood(r: Array) -> float:
        _, policies = finite_soft_value_iteration(tabular.P, r, HORIZON, gamma)
        return float(mu[mu > 0] @ np.log(policies[mu > 0])) / HORIZON

    found, gradient = log_likelihood(tabular, r, mu, gamma)
    assert found == pytest.approx(likelihood(r))
    differences = [likelihood(r + change) - likelihood(r - change) for change in 1e-5 * np.eye(9)]
    np.testing.assert_allclose(gradient, np.array(differences) / 2e-5, atol=1e-8)
    learned = MaxEnt(iterations=2).fit(demos, finite_world(tabular), np.random.default_rng(0))
    assert learned.reward is not None


@SLIPS
@GAMMAS
def test_expected_visits_sum_to_the_horizon(finite_world: MakeWorld, slip: float, gamma: float) -> None:
    tabular = grid(4, slip)
    mu = demonstrated(wander(finite_world(tabular, HORIZON), 3), tabular)
    np.testing.assert_allclose(mu.sum(axis=(1, 2)), 1)
    _, gradient = log_likelihood(tabular, np.random.default_rng(1).normal(size=16), mu, gamma)
    expected = mu.sum(axis=(0, 2)) - HORIZON * gradient
    assert expected.sum() == pytest.approx(HORIZON)
    assert np.abs(gradient).max() > 0.01


def test_without_chance_expected_visits_start_where_demonstrations_do(finite_world: MakeWorld) -> None:
    tabular = grid(3, 0.0)
    demos = wander(finite_world(tabular, HORIZON), 4)
    mu, r = demonstrated(demos, tabular), np.random.default_rng(1).normal(size=9)
    starts = np.zeros(9)
    np.add.at(starts, tabular.states(np.stack([obs[0] for obs in demos.obs])), 0.25)
    _, policies = finite_soft_value_iteration(tabular.P, r, HORIZON)
    expected = state_visitations(tabular.P, policies, starts, HORIZON).sum(axis=0)
    _, gradient = log_likelihood(tabular, r, mu, gamma=1.0)
    np.testing.assert_allclose(gradient, (mu.sum(axis=(0, 2)) - expected) / HORIZON, atol=1e-12)


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


def soft_demonstrations(tabular: Tabular, count: int, gamma: float) -> Episodes:
    rng = np.random.default_rng(0)
    _, policies = finite_soft_value_iteration(tabular.P, tabular.reward, HORIZON, gamma)
    obs, acts = [], []
    for _ in range(count):
        states, choices = [rng.choice(len(tabular.start), p=tabular.start)], []
        for policy in policies:
            choices.append(rng.choice(policy.shape[1], p=policy[states[-1]]))
            after = tabular.P[states[-1], choices[-1]]
            states.append(rng.choice(len(after), p=after))
        obs.append(tabular.obs[states])
        acts.append(np.eye(policies.shape[2])[choices])
    return Episodes(tuple(obs), tuple(acts), (False,) * count)


def test_a_fit_ascends_to_where_the_gradient_vanishes(finite_world: MakeWorld) -> None:
    tabular = grid(3, 0.3)
    world = finite_world(tabular, HORIZON)
    demos = soft_demonstrations(tabular, 500, world.gamma)
    learned = MaxEnt(iterations=600, learning_rate=1e-2).fit(demos, world, np.random.default_rng(0))
    (curve,) = learned.curves.values()
    assert len(curve) == 600
    mu = demonstrated(demos, tabular)
    r = learned.reward(tabular.obs, np.zeros((9, 5)), tabular.obs)
    likelihood, gradient = log_likelihood(tabular, r, mu, world.gamma)
    at_first = log_likelihood(tabular, np.zeros(9), mu, world.gamma)[1]
    assert np.abs(gradient).max() < 2e-3 < np.abs(at_first).max()
    assert likelihood == pytest.approx(curve[-1], abs=1e-4)
    # The likeliest reward is likelier than the true one, and near it up to a constant.
    assert log_likelihood(tabular, tabular.reward, mu, world.gamma)[0] < likelihood
    np.testing.assert_allclose(r - r.mean(), tabular.reward - tabular.reward.mean(), atol=0.25)


def test_pi_star_is_solved_under_the_returned_reward(finite_world: MakeWorld) -> None:
    world = finite_world(grid(3, 0.3), HORIZON)
    learned = MaxEnt(iterations=5).fit(wander(world, 3), world, np.random.default_rng(0))
    r = learned.reward(world.model.obs, np.zeros((9, 5)), world.model.obs)
    v, _ = value_iteration(world.model.P, r, world.gamma)
    (policy,) = world.found
    np.testing.assert_allclose(policy_value(world.model.P, r, policy, world.gamma), v, atol=1e-6)
    np.testing.assert_array_equal(learned.policy(world.model.obs), policy)
    assert learned.reward.absorbing == 0


def value_difference(tabular: Tabular, policy: Policy, gamma: float) -> float:
    """The share of the true value of starting anywhere that a policy lacks."""
    best = tabular.start @ value_iteration(tabular.P, tabular.reward, gamma)[0]
    its = tabular.start @ policy_value(tabular.P, tabular.reward, policy(tabular.obs), gamma)
    return float((best - its) / best)


def test_an_objectworld_is_recovered_the_better_the_more_is_demonstrated(finite_world: MakeWorld) -> None:
    tabular = objectworld(10, 10, 2, 0.3, np.random.default_rng(0))
    differences: dict[int, list[float]] = {4: [], 128: []}
    for count, found in differences.items():
        for seed in range(3):
            world, rng = finite_world(tabular, horizon=20), np.random.default_rng(seed)
            demos = world.rollout(world.optimal(), count, rng)
            learned = MaxEnt(iterations=100, learning_rate=1e-2).fit(demos, world, rng)
            found.append(value_difference(tabular, learned.policy, world.gamma))
    uniform = value_difference(tabular, lambda obs: np.full((len(obs), 5), 0.2), world.gamma)
    assert uniform > 0.5
    assert max(differences[128]) <= 0.05
    assert np.mean(differences[128]) < 0.5 * np.mean(differences[4])


def test_what_the_reward_says_holds_at_the_discount_of_the_solve(finite_world: MakeWorld) -> None:
    """A likelihood without the discount explains long journeys to the best cells by too little."""
    world, rng = finite_world(WORLD, SPEC.horizon, SPEC.gamma), np.random.default_rng(0)
    demos = world.rollout(world.optimal(), 100, rng)
    learned = MaxEnt(iterations=100, learning_rate=1e-2).fit(demos, world, rng)
    assert value_difference(WORLD, learned.policy, SPEC.gamma) <= 0.05
