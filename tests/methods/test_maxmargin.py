"""Apprenticeship by maximum margin finds a constant expert, and a mixture as good as an optimal one."""

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
from tests.methods.worlds import FiniteWorld, constant, demonstrate

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
    one, other = learned.curves["margin"][1:3]
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
    margins, distances = np.array(learned.curves["margin"]), learned.curves["distance"]
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
