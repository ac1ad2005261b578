"""Exact solutions of Markov decision processes meet their equations."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.gridworld import grid
from methods.tabular.model import (
    action_values,
    discounted_visitations,
    finite_soft_value_iteration,
    greedy,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)


@st.composite
def problems(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, float, np.random.Generator]:
    """A random model, some of its transitions impossible, rewards by state or by pair, a discount."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    states, actions = draw(st.integers(1, 8)), draw(st.integers(1, 4))
    weights = rng.exponential(size=(states, actions, states))
    weights *= rng.integers(2, size=weights.shape)
    weights[:, :, 0] += 0.01
    shape = draw(st.sampled_from([(states,), (states, actions)]))
    gamma = draw(st.floats(0, 0.97))
    return weights / weights.sum(axis=2, keepdims=True), rng.normal(size=shape), gamma, rng


def random_policy(P: np.ndarray, rng: np.random.Generator, *times: int) -> np.ndarray:
    return rng.dirichlet(np.ones(P.shape[1]), size=(*times, len(P)))


@settings(deadline=None, max_examples=40)
@given(problems())
def test_value_iteration_solves_bellmans_equation(problem: tuple) -> None:
    P, r, gamma, _ = problem
    for tol in (1e-2, 1e-9):
        v, q = value_iteration(P, r, gamma, tol)
        assert np.array_equal(v, q.max(axis=1))
        assert np.abs(action_values(P, r, v, gamma).max(axis=1) - v).max() <= tol
    loose, _ = value_iteration(P, r, gamma, 1e-2)
    assert np.abs(loose - v).max() <= 1e-2 + 1e-8


@settings(deadline=None, max_examples=40)
@given(problems())
def test_the_greedy_policy_is_worth_v_and_no_policy_more(problem: tuple) -> None:
    P, r, gamma, rng = problem
    v, q = value_iteration(P, r, gamma)
    np.testing.assert_allclose(policy_value(P, r, greedy(q), gamma), v, atol=1e-6)
    assert (policy_value(P, r, random_policy(P, rng), gamma) <= v + 1e-6).all()


@settings(deadline=None, max_examples=40)
@given(problems())
def test_soft_value_is_return_plus_entropy_of_the_soft_policy(problem: tuple) -> None:
    P, r, gamma, _ = problem
    v, q = soft_value_iteration(P, r, gamma)
    policy = soft_policy(q)
    np.testing.assert_allclose(policy.sum(axis=1), 1)
    surprise = r.reshape(len(P), -1) - np.log(policy)
    np.testing.assert_allclose(policy_value(P, surprise, policy, gamma), v, atol=1e-6)


def test_finite_soft_policy_weighs_paths_by_their_return() -> None:
    """In a world without chance a path's probability is exp(return) over the sum for all (Ziebart 2008)."""
    world, horizon, start = grid(2, 0.0), 3, 0
    after = world.P.argmax(axis=2)
    values, policies = finite_soft_value_iteration(world.P, world.reward, horizon)
    weights, probabilities = [], []
    for actions in itertools.product(range(5), repeat=horizon):
        state, total, probability = start, 0.0, 1.0
        for t, action in enumerate(actions):
            total += world.reward[state]
            probability *= policies[t, state, action]
            state = after[state, action]
        weights.append(math.exp(total))
        probabilities.append(probability)
    np.testing.assert_allclose(probabilities, np.array(weights) / sum(weights))
    assert values[0, start] == pytest.approx(math.log(sum(weights)))


@settings(deadline=None, max_examples=40)
@given(problems(), st.integers(1, 20), st.booleans())
def test_visitations_sum_to_the_horizon_and_give_the_return(
    problem: tuple, horizon: int, timed: bool
) -> None:
    P, _, gamma, rng = problem
    policy = random_policy(P, rng, horizon) if timed else random_policy(P, rng)
    start, r = rng.dirichlet(np.ones(len(P))), rng.normal(size=len(P))
    visits = state_visitations(P, policy, start, horizon)
    assert visits.sum() == pytest.approx(horizon)
    np.testing.assert_allclose(visits.sum(axis=1), 1)
    v = np.zeros(len(P))
    for its in reversed(np.broadcast_to(policy, (horizon, *P.shape[:2]))):
        v = (its * action_values(P, r, v, gamma)).sum(axis=1)
    assert gamma ** np.arange(horizon) @ visits @ r == pytest.approx(start @ v)


@settings(deadline=None, max_examples=40)
@given(problems())
def test_discounted_visitations_sum_to_the_horizon_and_give_the_value(problem: tuple) -> None:
    P, _, gamma, rng = problem
    policy, start, r = random_policy(P, rng), rng.dirichlet(np.ones(len(P))), rng.normal(size=len(P))
    visits = discounted_visitations(P, policy, start, gamma)
    assert visits.sum() == pytest.approx(1 / (1 - gamma))
    assert visits @ r == pytest.approx(start @ policy_value(P, r, policy, gamma))
    finite = gamma ** np.arange(1000) @ state_visitations(P, policy, start, 1000)
    np.testing.assert_allclose(visits, finite, atol=1e-8)


@settings(deadline=None, max_examples=40)
@given(problems())
def test_shaping_by_any_potential_keeps_advantages(problem: tuple) -> None:
    P, r, gamma, rng = problem
    potential = rng.normal(size=len(P))
    v, q = value_iteration(P, r, gamma)
    shaped = action_values(P, r, potential, gamma) - potential[:, None]
    shaped_v, shaped_q = value_iteration(P, shaped, gamma)
    np.testing.assert_allclose(shaped_v, v - potential, atol=1e-6)
    np.testing.assert_allclose(shaped_q - shaped_v[:, None], q - v[:, None], atol=1e-6)


def test_what_does_not_fit_is_refused() -> None:
    P = grid(2, 0.0).P
    with pytest.raises(ValueError, match="rewards must be"):
        value_iteration(P, np.full(4, math.nan), 0.9)
    with pytest.raises(ValueError, match="gamma"):
        value_iteration(P, np.zeros(4), 1.0)
