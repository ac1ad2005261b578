"""Apprenticeship by maximum margin finds a constant expert, and a mixture as good as an optimal one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

from envs.gridworld import grid, objectworld
from envs.models import Tabular
from methods.base import Array, Episodes
from methods.margins import feature_expectations, max_margin, projection
from methods.maxmargin import MaxMargin
from methods.rewards import LinearReward
from methods.tabular.maxmargin import exact_feature_expectations


def constant(*action: float) -> Callable[[Array], Array]:
    return lambda obs: np.tile(action, (len(obs), 1))


@pytest.mark.parametrize(("length", "terminated"), [(10, False), (10, True), (4, True), (4, False)])
def test_feature_expectations_weigh_steps_by_discounts_that_sum_to_1(
    world: Any, length: int, terminated: bool
) -> None:
    act = np.linspace([-1.0, 0.5], [1.0, -0.5], length)
    weights = 0.9 ** np.arange(10) / sum(0.9**t for t in range(10))
    alive = weights[:length]
    expected = [*(alive @ act), alive.sum(), weights[length:].sum() if terminated else 0.0]
    one = Episodes((np.zeros((length + 1, 3)),), (act,), (terminated,))
    np.testing.assert_allclose(feature_expectations(one, world, world.phi), expected)
    # And the mean over episodes, of any length.
    still = Episodes((*one.obs, np.zeros((11, 3))), (act, np.zeros((10, 2))), (terminated, False))
    np.testing.assert_allclose(
        feature_expectations(still, world, world.phi), np.add(expected, [0, 0, 1, 0]) / 2
    )


def test_the_reward_is_linear_and_its_last_weight_is_absorption(world: Any) -> None:
    reward = LinearReward(world.phi, np.array([2.0, -1.0, 0.5, 7.0]))
    act = np.array([[1.0, 0.0], [0.5, 1.0]])
    np.testing.assert_allclose(reward(np.zeros((2, 3)), act, np.zeros((2, 3))), [2.5, 0.5])
    assert reward.absorbing == 7.0


@pytest.mark.parametrize("corner", [(0.95, -0.95), (-0.95, 0.95), (-0.95, -0.95)])
def test_it_finds_the_demonstrated_action(
    world: Any, demonstrate: Callable[..., Episodes], corner: tuple[float, float]
) -> None:
    learned = MaxMargin(iterations=4, epsilon=-1.0, waves=0).fit(
        demonstrate(constant(*corner)), world, np.random.default_rng(0)
    )
    obs = np.zeros((5, 3))
    np.testing.assert_allclose(learned.policy(obs), np.tile(corner, (5, 1)), atol=0.12)
    reward: Any = learned.reward
    assert (np.sign(reward.w[:2]) == np.sign(corner)).all()
    assert (reward(obs, np.tile(corner, (5, 1)), obs) > reward(obs, np.zeros((5, 2)), obs)).all()


def test_the_margin_never_rises_and_the_closest_policy_is_chosen(
    world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    learned = MaxMargin(iterations=5, epsilon=-1.0, waves=0).fit(
        demonstrate(constant(0.3, -0.6)), world, np.random.default_rng(0)
    )
    margins, distances = learned.curves["margin"], learned.curves["distance"]
    # The last is of R*, the mean weights.
    assert len(margins) == len(distances) == 6
    assert (np.diff(margins) <= 1e-6).all()
    assert margins[-1] < 0.5 * margins[0]
    # Here phi is the action itself and a constant.
    action = learned.policy(np.zeros((1, 3)))[0]
    assert np.linalg.norm(action - [0.3, -0.6]) == pytest.approx(min(distances))


@pytest.mark.parametrize("best", range(4))
def test_the_closest_policy_is_returned_with_the_mean_of_the_latest_rewards(
    world: Any, demonstrate: Callable[..., Episodes], monkeypatch: pytest.MonkeyPatch, best: int
) -> None:
    actions = [(0.9, -0.9), (0.9, -0.8), (0.8, -0.9), (0.8, -0.8)]
    actions[best] = (0.4, -0.5)
    rewards: list[Any] = []

    def solve(reward: Any, *_: object, **__: object) -> Callable[[Array], Array]:
        rewards.append(reward)
        return constant(*actions[len(rewards) - 1])

    monkeypatch.setattr(world, "solved", solve)
    learned: Any = MaxMargin(iterations=3, averaged=2, epsilon=-1.0).fit(
        demonstrate(constant(0.3, -0.6)), world, np.random.default_rng(0)
    )
    np.testing.assert_array_equal(learned.policy(np.zeros((1, 3))), [[0.4, -0.5]])
    first, second, third, last = (reward.w for reward in rewards)
    np.testing.assert_array_equal(learned.reward.w, last)
    one, other = learned.curves["margin"][1:3]
    np.testing.assert_allclose(last, (one * second + other * third) / (one + other))
    assert np.abs(first - third).max() > 0.1


def test_it_stops_at_a_small_margin_and_warms_every_solve_but_the_first(
    world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    demos = demonstrate(constant(0.95, -0.95))
    MaxMargin(iterations=3, rl_share=0.007, final_share=0.009, epsilon=-1.0).fit(
        demos, world, np.random.default_rng(0)
    )
    found = [(steps, warm) for _, steps, warm in world.solves]
    assert found == [(7, False), (7, True), (7, True), (9, True)]
    world.solves.clear()
    learned = MaxMargin(iterations=3, epsilon=10.0).fit(demos, world, np.random.default_rng(0))
    assert len(world.solves) == 2
    assert len(learned.curves["margin"]) == 2


def test_what_absorption_pays_is_learned(
    world: Any, mortal_world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    rng = np.random.default_rng(0)
    lives = demonstrate(constant(0.0, 0.0))
    dies = demonstrate(constant(0.0, 0.0), lifetime=2)
    settings = MaxMargin(iterations=1)
    for demos, its_world, sign in ((lives, mortal_world, -1), (dies, world, 1)):
        reward: Any = settings.fit(demos, its_world, rng).reward
        alive = reward(np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 3)))[0]
        assert np.sign(reward.absorbing) == sign
        assert np.sign(alive) == -sign


MakeWorld = Callable[..., Any]


def from_every_state(world: Any) -> Episodes:
    """The optimal policy's demonstrations in a world without chance, one from each state."""
    after, policy = world.model.P.argmax(axis=2), world.optimal()
    obs, act = [], []
    for state in range(len(after)):
        path = [state]
        for _ in range(world.horizon):
            path.append(after[path[-1], policy(world.model.obs[path[-1:]])[0].argmax()])
        obs.append(world.model.obs[path])
        act.append(policy(obs[-1][:-1]))
    return Episodes(tuple(obs), tuple(act), (False,) * len(obs))


def test_exact_feature_expectations_are_those_of_every_episode(finite_world: MakeWorld) -> None:
    world = finite_world(grid(3, 0.0))
    exact = exact_feature_expectations(world.optimal(), world, world.model)
    np.testing.assert_allclose(
        exact, feature_expectations(from_every_state(world), world, world.phi), atol=1e-12
    )
    assert exact[-1] == 0
    assert exact.sum() == pytest.approx(1)


def test_exact_feature_expectations_are_the_limit_of_rollouts(finite_world: MakeWorld) -> None:
    world = finite_world(objectworld(5, 4, 2, 0.3, np.random.default_rng(0)))
    rollouts = world.rollout(world.optimal(), 1000, np.random.default_rng(0))
    # One episode's features differ by at most 1.
    np.testing.assert_allclose(
        exact_feature_expectations(world.optimal(), world, world.model),
        feature_expectations(rollouts, world, world.phi),
        atol=4 * 0.5 / np.sqrt(1000),
    )


def distance_to_mixtures(expert: Array, found: list[Array]) -> float:
    """From the nearest of their convex combinations."""
    sum_to_1 = np.full(len(found), 1e3)
    shares, _ = nnls(np.vstack([np.array(found).T, sum_to_1]), np.append(expert, 1e3))
    return float(np.linalg.norm(expert - shares / shares.sum() @ np.array(found)))


def tasks() -> dict[str, tuple[Tabular, int | None, float]]:
    """A world, how many demonstrations there are (None: one from each state), epsilon.

    Where there is chance, no mixture has just the demonstrations' mu_E, but one, the expert's, has it to
    within what N episodes err. Without that room in epsilon it might never stop.
    """
    return {
        "without chance": (grid(4, 0.0), None, 1e-3),
        "slippery": (grid(4, 0.3), 500, 0.02),
        "objects": (objectworld(6, 5, 2, 0.3, np.random.default_rng(0)), 1000, 0.05),
    }


@pytest.mark.parametrize("by_projection", [False, True], ids=["margin problem", "projection"])
@pytest.mark.parametrize("name", list(tasks()))
def test_it_stops_where_a_mixture_of_what_it_found_is_as_good_as_the_expert(
    finite_world: MakeWorld, monkeypatch: pytest.MonkeyPatch, name: str, by_projection: bool
) -> None:
    tabular, count, epsilon = tasks()[name]
    world, rng = finite_world(tabular, horizon=50), np.random.default_rng(0)
    demos = world.rollout(world.optimal(), count, rng) if count else from_every_state(world)
    expert = feature_expectations(demos, world, world.phi)
    error = np.linalg.norm(expert - exact_feature_expectations(world.optimal(), world, world.model))
    assert error < epsilon

    def draw(size: int, rng: np.random.Generator, uniform: Any = world.random_actions) -> Array:
        world.found.append(uniform(size, rng))
        return world.found[-1]

    monkeypatch.setattr(world, "random_actions", draw)
    monkeypatch.setattr(world, "rollout", lambda *_: pytest.fail("it needs no rollouts"))
    learned = MaxMargin(iterations=100, epsilon=epsilon, projection=by_projection).fit(demos, world, rng)
    margins, distances = np.array(learned.curves["margin"]), learned.curves["distance"]
    assert (np.diff(margins) <= 1e-6).all()
    assert margins[-1] <= epsilon < margins[-2]

    found = [exact_feature_expectations(world.policy(its), world, world.model) for its in world.found]
    assert len(found) == len(margins) + 1 > 3
    separate = projection if by_projection else max_margin
    its_margins = [separate(expert, found[: i + 1])[1] for i in range(len(margins))]
    np.testing.assert_allclose(margins, its_margins, atol=1e-6)
    assert distance_to_mixtures(expert, found[:-1]) <= epsilon + 1e-6
    # For a while, none of these did.
    assert distance_to_mixtures(expert, found[:2]) > epsilon
    # The one returned is the nearest by itself.
    alone = [float(np.linalg.norm(expert - mu)) for mu in found[1:]]
    np.testing.assert_allclose(distances, alone, atol=1e-12)
    act = learned.policy(world.model.obs)
    np.testing.assert_array_equal(act, world.found[1 + int(np.argmin(alone))])
