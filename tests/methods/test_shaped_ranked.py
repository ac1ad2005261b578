"""Its policy is that of `shaped`; its reward ranks what is like demonstrations above what is like noise."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from methods.base import Array, Episodes
from methods.shaped import Shaped
from methods.shaped_ranked import ShapedRanked

FITS: dict[str, Any] = {"steps": 300}
METHOD = ShapedRanked(**FITS, levels=(0.0, 0.5, 1.0), rollouts=10, reward_steps=200)


class Line:
    """A world whose observation (3,) begins with the last action's first entry."""

    obs_size, act_size, horizon, gamma, model = 3, 2, 10, 0.9, None

    def __init__(self, mortal: bool = False) -> None:
        self.mortal = mortal
        """Whether a negative first entry of an action ends the episode."""

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def rollout(self, policy: Callable[[Array], Array], episodes: int, rng: np.random.Generator) -> Episodes:
        obs, act = [], []
        for _ in range(episodes):
            seen, done = [rng.normal(0, 0.1, 3)], list[Array]()
            while len(done) < self.horizon and not (self.mortal and done and done[-1][0] < 0):
                done.append(policy(seen[-1][None])[0])
                seen.append(np.append(done[-1][0], rng.normal(0, 0.1, 2)))
            obs.append(np.array(seen))
            act.append(np.array(done))
        died = tuple(self.mortal and bool(its[-1, 0] < 0) for its in act)
        return Episodes(tuple(obs), tuple(act), died)


def expert(obs: Array) -> Array:
    return np.tile([0.7, 0.0], (len(obs), 1))


def at(x: float) -> tuple[Array, Array, Array]:
    obs = np.tile([x, 0.0, 0.0], (1, 1))
    return obs, np.zeros((1, 2)), obs


def test_its_policy_is_that_of_shaped() -> None:
    world: Any = Line()
    demos = world.rollout(expert, 5, np.random.default_rng(0))
    obs = np.random.default_rng(1).normal(size=(20, 3))
    ranked = METHOD.fit(demos, world, np.random.default_rng(2))
    shaped = Shaped(**FITS).fit(demos, world, np.random.default_rng(2))
    np.testing.assert_array_equal(ranked.policy(obs), shaped.policy(obs))


def test_its_reward_prefers_demonstrated_states_whatever_the_action() -> None:
    world: Any = Line()
    demos = world.rollout(expert, 5, np.random.default_rng(0))
    reward: Any = METHOD.fit(demos, world, np.random.default_rng(2)).reward
    values = [reward(*at(x))[0] for x in (0.7, 0.0, -0.7)]
    assert values[0] > values[1] + 0.2
    assert values[0] > values[2] + 0.5
    obs, act, after = at(0.7)
    assert reward(obs, act + 0.9, after) == reward(obs, act, after)
    assert -1 <= min(values) <= max(values) <= 1


class Taught(Line):
    """A world in which reinforcement learning always ends in this action."""

    solve_steps = 30

    def __init__(self, action: float) -> None:
        super().__init__()
        self.action, self.learned = action, list[int]()

    def agent(self, rng: np.random.Generator) -> Any:
        def learn(steps: int, reward: Any) -> None:
            self.learned.append(steps)

        return SimpleNamespace(learn=learn, policy=lambda obs: np.tile([self.action, 0.0], (len(obs), 1)))


def taught(action: float) -> tuple[Any, Any]:
    world: Any = Taught(action)
    demos = world.rollout(expert, 5, np.random.default_rng(0))
    before, after = (
        replace(METHOD, rl_rounds=rounds).fit(demos, world, np.random.default_rng(2)).reward
        for rounds in (0, 2)
    )
    assert world.learned == [30, 30]
    return before, after


def test_what_reinforcement_learning_finds_pays_less() -> None:
    before, after = taught(1.0)
    assert before(*at(1.0)) > before(*at(0.0))
    assert after(*at(1.0)) < after(*at(0.7)) - 0.5


@pytest.mark.parametrize("every", [1, 4])
def test_where_noise_kills_death_pays_less(every: int) -> None:
    world: Any = Line(mortal=True)
    demos = world.rollout(expert, 5, np.random.default_rng(0)).every(every, np.random.default_rng(3))
    reward: Any = METHOD.fit(demos, world, np.random.default_rng(2)).reward
    assert reward.absorbing < reward(*at(0.7))[0] - 0.2
