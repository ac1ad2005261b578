import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.gridworld import grid, objectworld
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

RIGHT, UP, LEFT, DOWN, STAY = range(5)


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


def test_values_of_a_grid_solved_by_hand() -> None:
    """Without slip the corner pays 1 for ever: V = gamma^steps / (1 - gamma)."""
    world, gamma = grid(3, 0.0), 0.5
    v, q = value_iteration(world.P, world.reward, gamma)
    steps = np.array([4, 3, 2, 3, 2, 1, 2, 1, 0])
    np.testing.assert_allclose(v, 2 * gamma**steps, atol=1e-9)
    assert q[8, STAY] == pytest.approx(2)
    assert q[8, LEFT] == pytest.approx(1 + gamma * 1)
    assert q[4, DOWN] == pytest.approx(gamma * 2 * gamma**3)


def test_values_with_slip_solved_by_hand() -> None:
    """One state in two pays 1; either action goes there with probability 0.9 or 0.2."""
    P = np.array([[[0.1, 0.9], [0.8, 0.2]], [[0.1, 0.9], [0.8, 0.2]]])
    v, q = value_iteration(P, np.array([0.0, 1.0]), 0.5)
    np.testing.assert_allclose(v, [0.9, 1.9], atol=1e-9)
    np.testing.assert_allclose(q, [[0.9, 0.55], [1.9, 1.55]], atol=1e-9)
    assert greedy(q).tolist() == [[1, 0], [1, 0]]


def test_soft_values_solved_by_hand() -> None:
    """With equal actions the soft value adds log A a step: V = (r + log A) / (1 - gamma)."""
    P = np.ones((1, 3, 1))
    v, q = soft_value_iteration(P, np.array([2.0]), 0.75)
    assert v[0] == pytest.approx(4 * (2 + math.log(3)))
    np.testing.assert_allclose(soft_policy(q), 1 / 3)


@settings(deadline=None)
@given(problems())
def test_value_iteration_solves_bellmans_equation(problem: tuple) -> None:
    P, r, gamma, _ = problem
    for tol in (1e-2, 1e-9):
        v, q = value_iteration(P, r, gamma, tol)
        assert np.array_equal(v, q.max(axis=1))
        assert np.abs(action_values(P, r, v, gamma).max(axis=1) - v).max() <= tol
    loose, _ = value_iteration(P, r, gamma, 1e-2)
    assert np.abs(loose - v).max() <= 1e-2 + 1e-8


@settings(deadline=None)
@given(problems())
def test_the_greedy_policy_is_worth_v_and_no_policy_more(problem: tuple) -> None:
    P, r, gamma, rng = problem
    v, q = value_iteration(P, r, gamma)
    np.testing.assert_allclose(policy_value(P, r, greedy(q), gamma), v, atol=1e-6)
    assert (policy_value(P, r, random_policy(P, rng), gamma) <= v + 1e-6).all()


@settings(deadline=None)
@given(problems())
def test_soft_value_is_return_plus_entropy_of_the_soft_policy(problem: tuple) -> None:
    P, r, gamma, _ = problem
    v, q = soft_value_iteration(P, r, gamma)
    policy = soft_policy(q)
    np.testing.assert_allclose(policy.sum(axis=1), 1)
    surprise = r.reshape(len(P), -1) - np.log(policy)
    np.testing.assert_allclose(policy_value(P, surprise, policy, gamma), v, atol=1e-6)


@settings(deadline=None)
@given(problems())
def test_soft_value_falls_to_the_hard_one_with_the_temperature(problem: tuple) -> None:
    """t V_soft(r / t) lies between V* and V* + t log A / (1 - gamma), and falls with t."""
    P, r, gamma, _ = problem
    hard, _ = value_iteration(P, r, gamma)
    above = np.full(len(P), np.inf)
    for temperature in (1.0, 0.1, 0.01):
        soft = temperature * soft_value_iteration(P, r / temperature, gamma)[0]
        assert (soft >= hard - 1e-6).all()
        assert (soft <= above + 1e-6).all()
        assert (soft <= hard + temperature * math.log(P.shape[1]) / (1 - gamma) + 1e-6).all()
        above = soft


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


@settings(deadline=None)
@given(problems())
def test_a_long_horizon_approaches_the_infinite_one(problem: tuple) -> None:
    P, r, gamma, _ = problem
    horizon = 400
    values, policies = finite_soft_value_iteration(P, r, horizon, gamma)
    v, q = soft_value_iteration(P, r, gamma)
    left = gamma**horizon * np.abs(v).max()
    np.testing.assert_allclose(values[0], v, atol=left + 1e-6)
    np.testing.assert_allclose(policies[0], soft_policy(q), atol=4 * left + 1e-6)


@settings(deadline=None)
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


@settings(deadline=None)
@given(problems(), st.integers(1, 8), st.booleans())
def test_visitations_with_arrivals_are_those_of_each_arrival_from_its_time_on(
    problem: tuple, horizon: int, timed: bool
) -> None:
    P, _, _, rng = problem
    policy = random_policy(P, rng, horizon) if timed else random_policy(P, rng)
    policies = np.broadcast_to(policy, (horizon, *P.shape[:2]))
    arrivals = rng.normal(size=(horizon, len(P)))
    given, expected = arrivals.copy(), np.zeros_like(arrivals)
    for t, arrival in enumerate(arrivals):
        expected[t:] += state_visitations(P, policies[t:], arrival, horizon - t)
    np.testing.assert_allclose(state_visitations(P, policy, given, horizon), expected, atol=1e-9)
    assert np.array_equal(given, arrivals)
    given[1:] = 0
    np.testing.assert_allclose(
        state_visitations(P, policy, given, horizon), state_visitations(P, policy, given[0], horizon)
    )


@settings(deadline=None)
@given(problems())
def test_discounted_visitations_sum_to_the_horizon_and_give_the_value(problem: tuple) -> None:
    P, _, gamma, rng = problem
    policy, start, r = random_policy(P, rng), rng.dirichlet(np.ones(len(P))), rng.normal(size=len(P))
    visits = discounted_visitations(P, policy, start, gamma)
    assert visits.sum() == pytest.approx(1 / (1 - gamma))
    assert visits @ r == pytest.approx(start @ policy_value(P, r, policy, gamma))
    finite = gamma ** np.arange(1000) @ state_visitations(P, policy, start, 1000)
    np.testing.assert_allclose(visits, finite, atol=1e-8)


def test_visitations_by_hand() -> None:
    world = grid(2, 0.0)
    right = np.tile(np.eye(5)[RIGHT], (4, 1))
    visits = state_visitations(world.P, right, np.array([1.0, 0, 0, 0]), 3)
    assert visits.tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]]


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), st.floats(0, 0.9), st.floats(0.1, 0.95), st.integers(0, 2**32))
def test_shaping_by_the_optimal_value_gives_the_optimal_advantage(
    size: int, slip: float, gamma: float, seed: int
) -> None:
    """Ng, Harada & Russell 1999: under R + gamma V*(s') - V*(s) optimal actions pay 0 in expectation and the
    others less, so that the best policy is greedy by the reward alone, at any discount."""
    world = grid(size, slip)
    r = np.random.default_rng(seed).normal(size=size**2)
    v, q = value_iteration(world.P, r, gamma, 1e-11)
    shaped = action_values(world.P, r, v, gamma) - v[:, None]
    np.testing.assert_allclose(shaped, q - v[:, None], atol=1e-9)
    np.testing.assert_allclose(shaped.max(axis=1), 0, atol=1e-9)
    best = q >= v[:, None] - 1e-7
    assert (shaped[best] >= -2e-7).all()
    assert (shaped[~best] < -5e-8).all()
    for discount in (0.0, gamma):
        shaped_v, shaped_q = value_iteration(world.P, shaped, discount, 1e-11)
        np.testing.assert_allclose(shaped_v, 0, atol=1e-7)
        np.testing.assert_allclose(policy_value(world.P, r, greedy(shaped_q), gamma), v, atol=1e-5)


@settings(deadline=None)
@given(problems())
def test_shaping_by_any_potential_keeps_advantages(problem: tuple) -> None:
    P, r, gamma, rng = problem
    potential = rng.normal(size=len(P))
    v, q = value_iteration(P, r, gamma)
    shaped = action_values(P, r, potential, gamma) - potential[:, None]
    shaped_v, shaped_q = value_iteration(P, shaped, gamma)
    np.testing.assert_allclose(shaped_v, v - potential, atol=1e-6)
    np.testing.assert_allclose(shaped_q - shaped_v[:, None], q - v[:, None], atol=1e-6)


def test_large_rewards_end_where_rounding_does() -> None:
    world = grid(4, 0.3)
    large, _ = value_iteration(world.P, 1e12 * world.reward, 0.99, 1e-12)
    np.testing.assert_allclose(large, 1e12 * value_iteration(world.P, world.reward, 0.99)[0], rtol=1e-9)


def test_an_objectworld_is_solved() -> None:
    world = objectworld(16, 20, 2, 0.375, np.random.default_rng(0))
    v, q = value_iteration(world.P, world.reward, 0.9, 1e-6)
    np.testing.assert_allclose(policy_value(world.P, world.reward, greedy(q), 0.9), v, atol=1e-5)


@pytest.mark.parametrize("gamma", [-0.1, 1.0, math.nan])
def test_refuses_discounts(gamma: float) -> None:
    world = grid(2, 0.0)
    policy = np.full((4, 5), 0.2)
    with pytest.raises(ValueError, match="gamma"):
        value_iteration(world.P, world.reward, gamma)
    with pytest.raises(ValueError, match="gamma"):
        policy_value(world.P, world.reward, policy, gamma)
    with pytest.raises(ValueError, match="gamma"):
        discounted_visitations(world.P, policy, world.start, gamma)


def test_refuses_rewards_horizons_and_tolerances() -> None:
    world = grid(2, 0.0)
    for reward in (np.zeros(5), np.zeros((4, 4)), np.zeros((1, 4)), np.full(4, math.nan)):
        with pytest.raises(ValueError, match="rewards must be"):
            value_iteration(world.P, reward, 0.9)
    with pytest.raises(ValueError, match="horizon"):
        finite_soft_value_iteration(world.P, world.reward, 0)
    with pytest.raises(ValueError, match="horizon"):
        state_visitations(world.P, np.full((4, 5), 0.2), world.start, 0)
    with pytest.raises(ValueError, match="gamma"):
        finite_soft_value_iteration(world.P, world.reward, 3, 1.1)
    with pytest.raises(ValueError, match="tol"):
        soft_value_iteration(world.P, world.reward, 0.9, 0.0)
