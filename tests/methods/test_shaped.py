"""The shaped reward is eq. 4.3, and a ranked one prefers what is like demonstrations."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.base import Array, Episodes, Learned
from methods.network import Network, mlp
from methods.shaped import Shaped, ShapedReward, shaped_reward
from methods.shaped_ranked import ShapedRanked
from tests.methods.worlds import FakeWorld, constant, demonstrate

SIZES = st.integers(1, 4)
SEEDS = st.integers(0, 2**31)


def random_reward(obs_size: int, act_size: int, seed: int, scale: float = 3.0) -> ShapedReward:
    generator = torch.Generator().manual_seed(seed)
    f = mlp(obs_size, 7, act_size, generator=generator)
    chol = mlp(obs_size, 6, act_size**2, generator=generator)
    with torch.no_grad():
        for parameter in [*f.parameters(), *chol.parameters()]:
            parameter.mul_(scale)
    mean, std = np.full(obs_size, 0.2), np.full(obs_size, 0.5)
    return ShapedReward(Network.from_torch(f, mean, std, tanh=True), Network.from_torch(chol, mean, std))


@given(SIZES, SIZES, SEEDS)
@settings(deadline=None, max_examples=25)
def test_it_is_equation_4_3_in_numpy_and_in_torch(obs_size: int, act_size: int, seed: int) -> None:
    reward = random_reward(obs_size, act_size, seed)
    rng = np.random.default_rng(seed)
    obs, act = rng.normal(size=(6, obs_size)), rng.uniform(-1, 1, (6, act_size))
    expected = []
    for s, a in zip(obs, act, strict=True):
        chol = reward.chol(s[None])[0].reshape(act_size, act_size)
        matrix = chol @ chol.T + np.eye(act_size)
        assert np.linalg.eigvalsh(matrix).min() >= 1 - 1e-9
        d = a - reward.f(s[None])[0]
        expected.append(-d @ matrix @ d)
    np.testing.assert_allclose(reward(obs, act, obs), expected, rtol=1e-9)
    tensors = (torch.as_tensor(x) for x in (act, reward.f(obs), reward.chol(obs)))
    np.testing.assert_allclose(shaped_reward(*tensors).numpy(), expected, rtol=1e-9)
    np.testing.assert_array_equal(reward(obs, reward.f(obs), obs), 0)


def test_the_reward_far_from_the_demonstrations_is_no_cliff() -> None:
    demos = demonstrate(lambda obs: 0.5 * obs[:, :2], count=20)
    narrow = Episodes(tuple(1e-2 * obs for obs in demos.obs), demos.act, demos.terminated)
    reward = Shaped(steps=300).fit(narrow, FakeWorld(), np.random.default_rng(0)).reward
    assert isinstance(reward, ShapedReward)
    # Even a hundred of the demonstrations' spreads away L is smaller than the identity beside it.
    assert np.abs(reward.chol(100 * narrow.pairs()[0])).max() < 1


FITS: dict[str, Any] = {"steps": 300}
METHOD = ShapedRanked(**FITS, levels=(0.0, 0.5, 1.0), rollouts=10, reward_steps=200)


class Line:
    """A world whose observation (3,) begins with the last action's first entry."""

    obs_size, act_size, horizon, gamma, solve_steps, model = 3, 2, 10, 0.9, 30, None

    def __init__(self, mortal: bool = False) -> None:
        self.mortal = mortal
        """Whether a negative first entry of an action ends the episode."""
        self.learned: list[int] = []

    def agent(self, rng: np.random.Generator) -> Any:
        """Return an agent that always ends in the action 1."""
        policy = constant(1.0, 0.0)
        return SimpleNamespace(learn=lambda steps, reward: self.learned.append(steps), policy=policy)

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


LINE: Any = Line()
DEMOS = LINE.rollout(constant(0.7, 0.0), 5, np.random.default_rng(0))
OBS = np.random.default_rng(1).normal(size=(20, 3))


def at(x: float) -> tuple[Array, Array, Array]:
    obs = np.tile([x, 0.0, 0.0], (1, 1))
    return obs, np.zeros((1, 2)), obs


@pytest.fixture(scope="module")
def ranked() -> Learned:
    return METHOD.fit(DEMOS, LINE, np.random.default_rng(2))


def test_its_policy_is_that_of_shaped(ranked: Learned) -> None:
    shaped = Shaped(**FITS).fit(DEMOS, LINE, np.random.default_rng(2))
    np.testing.assert_array_equal(ranked.policy(OBS), shaped.policy(OBS))


def test_its_reward_prefers_demonstrated_states_whatever_the_action(ranked: Any) -> None:
    reward = ranked.reward
    values = [reward(*at(x))[0] for x in (0.7, 0.0, -0.7)]
    assert values[0] > values[1] + 0.2
    assert values[0] > values[2] + 0.5
    obs, act, after = at(0.7)
    assert reward(obs, act + 0.9, after) == reward(obs, act, after)
    assert -1 <= min(values) <= max(values) <= 1


def test_what_reinforcement_learning_finds_pays_less(ranked: Any) -> None:
    LINE.learned.clear()
    after: Any = replace(METHOD, rl_rounds=2).fit(DEMOS, LINE, np.random.default_rng(2)).reward
    assert LINE.learned == [30, 30]
    assert ranked.reward(*at(1.0)) > ranked.reward(*at(0.0))
    assert after(*at(1.0)) < after(*at(0.7)) - 0.5


@pytest.mark.parametrize("every", [1, 4])
def test_where_noise_kills_death_pays_less(every: int) -> None:
    world: Any = Line(mortal=True)
    demos = world.rollout(constant(0.7, 0.0), 5, np.random.default_rng(0)).every(
        every, np.random.default_rng(3)
    )
    reward: Any = METHOD.fit(demos, world, np.random.default_rng(2)).reward
    assert reward.absorbing < reward(*at(0.7))[0] - 0.2
