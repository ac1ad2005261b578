"""Where the model is known: exact solutions, and apprenticeship by maximum margin."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from envs.gridworld import grid, objectworld
from envs.models import Tabular
from methods.base import Array, Episodes
from methods.maxmargin import (
    MaxMargin,
    exact_feature_expectations,
    feature_expectations,
    max_margin,
)
from methods.tabular.model import (
    action_values,
    discounted_visitations,
    finite_soft_value_iteration,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)
from tests.methods.worlds import FiniteWorld, constant, demonstrate


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


POINTS = st.tuples(*[st.integers(-5, 5)] * 3).map(lambda p: np.array(p, float))


@given(POINTS, POINTS, POINTS)
@settings(deadline=None, max_examples=30)
def test_the_margin_is_the_distance_to_the_segment_of_two(expert: Array, a: Array, b: Array) -> None:
    along = b - a
    share = np.clip((expert - a) @ along / max(along @ along, 1e-12), 0, 1)
    w, t = max_margin(expert, [a, b])
    assert t == pytest.approx(np.linalg.norm(expert - a - share * along), abs=1e-4)
    assert np.linalg.norm(w) <= 1 + 1e-6
    assert min((expert - mu) @ w for mu in (a, b)) == pytest.approx(t, abs=1e-4)


@pytest.mark.parametrize(("length", "terminated"), [(10, True), (4, True), (4, False)])
def test_feature_expectations_weigh_steps_by_discounts_that_sum_to_1(
    world: Any, length: int, terminated: bool
) -> None:
    act = np.linspace([-1.0, 0.5], [1.0, -0.5], length)
    weights = 0.9 ** np.arange(10) / sum(0.9**t for t in range(10))
    alive = weights[:length]
    expected = [*(alive @ act), alive.sum(), weights[length:].sum() if terminated else 0.0]
    one = Episodes((np.zeros((length + 1, 3)),), (act,), (terminated,))
    np.testing.assert_allclose(feature_expectations(one, world, world.phi), expected)


def test_shown_steps_stand_for_all_in_feature_expectations(world: Any) -> None:
    some = Episodes((np.zeros((3, 3)),), (np.ones((3, 2)),), (True,), (np.array([1, 4, 6]),), (9,))
    living = sum(0.9**t for t in range(9)) / sum(0.9**t for t in range(10))
    expected = [living, living, living, 1 - living]
    np.testing.assert_allclose(feature_expectations(some, world, world.phi), expected)


def test_the_closest_policy_is_returned_with_the_mean_of_the_latest_rewards(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    actions = [(0.9, -0.9), (0.4, -0.5), (0.8, -0.9), (0.8, -0.8)]
    rewards: list[Any] = []

    def solve(reward: Any, *_: object, **__: object) -> Callable[[Array], Array]:
        rewards.append(reward)
        return constant(*actions[len(rewards) - 1])

    monkeypatch.setattr(world, "solved", solve)
    learned: Any = MaxMargin(iterations=3, averaged=2, epsilon=-1.0).fit(
        demonstrate(constant(0.3, -0.6)), world, np.random.default_rng(0)
    )
    np.testing.assert_array_equal(learned.policy(np.zeros((1, 3))), [[0.4, -0.5]])
    _, second, third, last = (reward.w for reward in rewards)
    np.testing.assert_array_equal(learned.reward.w, last)
    one, other = world.curves["margin"][1:3]
    np.testing.assert_allclose(last, (one * second + other * third) / (one + other))


def distance_to_mixtures(expert: Array, found: list[Array]) -> float:
    """From the nearest of their convex combinations."""
    sum_to_1 = np.full(len(found), 1e3)
    shares, _ = nnls(np.vstack([np.array(found).T, sum_to_1]), np.append(expert, 1e3))
    return float(np.linalg.norm(expert - shares / shares.sum() @ np.array(found)))


@pytest.mark.parametrize("by_projection", [False, True], ids=["margin problem", "projection"])
@pytest.mark.parametrize(
    ("tabular", "count", "epsilon"),
    [(grid(4, 0.3), 500, 0.02), (objectworld(6, 5, 2, 0.3, np.random.default_rng(0)), 1000, 0.05)],
    ids=["slippery", "objects"],
)
def test_it_stops_where_a_mixture_of_what_it_found_is_as_good_as_the_expert(
    monkeypatch: pytest.MonkeyPatch, tabular: Tabular, count: int, epsilon: float, by_projection: bool
) -> None:
    """Where there is chance only the expert has the demonstrations' mu_E, to within what N episodes err."""
    world, rng = FiniteWorld(tabular, horizon=50), np.random.default_rng(0)
    demos = world.rollout(world.optimal(), count, rng)
    expert = feature_expectations(demos, world, world.phi)
    error = np.linalg.norm(expert - exact_feature_expectations(world.optimal(), world, world.model))
    assert error < epsilon

    def draw(size: int, rng: np.random.Generator, uniform: Any = world.random_actions) -> Array:
        world.solutions.append(uniform(size, rng))
        return world.solutions[-1]

    monkeypatch.setattr(world, "random_actions", draw)
    monkeypatch.setattr(world, "rollout", lambda *_: pytest.fail("it needs no rollouts"))
    learned = MaxMargin(iterations=100, epsilon=epsilon, projection=by_projection).fit(demos, world, rng)
    margins, distances = np.array(world.curves["margin"]), learned.curves["distance"]
    assert (np.diff(margins) <= 1e-6).all()
    assert margins[-1] <= epsilon < margins[-2]

    found = [exact_feature_expectations(world.policy(its), world, world.model) for its in world.solutions]
    assert len(found) == len(margins) + 1 > 3
    assert distance_to_mixtures(expert, found[:-1]) <= epsilon + 1e-6
    assert distance_to_mixtures(expert, found[:2]) > epsilon
    alone = [float(np.linalg.norm(expert - mu)) for mu in found[1:]]
    np.testing.assert_allclose(distances, alone, atol=1e-12)
    act = learned.policy(world.model.obs)
    np.testing.assert_array_equal(act, world.solutions[1 + int(np.argmin(alone))])
