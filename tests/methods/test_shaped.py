"""The shaped reward is eq. 4.3, whatever its weights, and its fit finds a linear expert."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.base import Array, Episodes
from methods.network import Network, mlp
from methods.shaped import Shaped, ShapedReward, shaped_reward

GAIN = np.array([[0.5, 0.0], [-0.3, 0.4], [0.1, -0.3]])
SIZES = st.integers(1, 4)
SEEDS = st.integers(0, 2**31)


def expert(obs: Array) -> Array:
    return obs @ GAIN


def random_reward(obs_size: int, act_size: int, seed: int, scale: float = 3.0) -> ShapedReward:
    generator = torch.Generator().manual_seed(seed)
    f = mlp(obs_size, 7, act_size, generator=generator)
    chol = mlp(obs_size, 6, act_size**2, generator=generator)
    with torch.no_grad():
        for parameter in [*f.parameters(), *chol.parameters()]:
            parameter.mul_(scale)
    mean, std = np.full(obs_size, 0.2), np.full(obs_size, 0.5)
    return ShapedReward(Network.from_torch(f, mean, std, tanh=True), Network.from_torch(chol, mean, std))


def batch(obs_size: int, act_size: int, seed: int, size: int = 6) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(size, obs_size)), rng.uniform(-1, 1, (size, act_size))


@given(SIZES, SIZES, SEEDS)
@settings(deadline=None, max_examples=50)
def test_it_is_at_most_0_and_0_exactly_at_f(obs_size: int, act_size: int, seed: int) -> None:
    reward = random_reward(obs_size, act_size, seed)
    obs, act = batch(obs_size, act_size, seed)
    values = reward(obs, act, obs)
    assert values.shape == (6,)
    assert (values <= -((act - reward.f(obs)) ** 2).sum(1)).all()
    np.testing.assert_array_equal(reward(obs, reward.f(obs), obs), 0)


@given(SIZES, SIZES, SEEDS)
@settings(deadline=None, max_examples=50)
def test_it_is_equation_4_3_in_numpy_and_in_torch(obs_size: int, act_size: int, seed: int) -> None:
    reward = random_reward(obs_size, act_size, seed)
    obs, act = batch(obs_size, act_size, seed)
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


@given(SIZES, SIZES, SEEDS)
@settings(deadline=None, max_examples=25)
def test_a_batch_is_its_rows(obs_size: int, act_size: int, seed: int) -> None:
    reward = random_reward(obs_size, act_size, seed)
    obs, act = batch(obs_size, act_size, seed)
    rows = [reward(o[None], a[None], o[None]) for o, a in zip(obs, act, strict=True)]
    np.testing.assert_allclose(reward(obs, act, obs), np.concatenate(rows), rtol=1e-9)


def test_fit_recovers_a_linear_expert_without_an_environment(
    no_environment: Any, demonstrate: Callable[..., Episodes]
) -> None:
    demos = demonstrate(expert, count=60)
    learned = Shaped(steps=800).fit(demos, no_environment, np.random.default_rng(0))
    rng = np.random.default_rng(9)
    obs = rng.uniform(-0.9, 0.9, (500, 3))
    assert np.abs(learned.policy(obs) - expert(obs)).mean() < 0.03
    loss = learned.curves["loss"]
    assert loss[-1] < 0.01 < loss[0]

    reward = learned.reward
    assert reward is not None
    best = reward(obs, expert(obs), obs)
    assert best.mean() > -0.01
    for other in (rng.uniform(-1, 1, (500, 2)), -expert(obs), np.zeros((500, 2))):
        far = np.linalg.norm(other - expert(obs), axis=1) > 0.3
        assert (best > reward(obs, other, obs))[far].all()


def test_absorption_pays_what_uniform_actions_earn(
    no_environment: Any, demonstrate: Callable[..., Episodes]
) -> None:
    demos = demonstrate(expert, count=60)
    reward = Shaped(steps=300).fit(demos, no_environment, np.random.default_rng(0)).reward
    assert reward is not None
    obs = np.tile(demos.pairs()[0], (20, 1))
    uniform = reward(obs, np.random.default_rng(1).uniform(-1, 1, (len(obs), 2)), obs)
    tolerance = 4 * uniform.std() / np.sqrt(len(demos.pairs()[0]))
    assert abs(reward.absorbing - uniform.mean()) < tolerance < 0.5 * abs(uniform.mean())


def test_the_reward_far_from_the_demonstrations_is_no_cliff(
    demonstrate: Callable[..., Episodes], no_environment: Any
) -> None:
    demos = demonstrate(lambda obs: 0.5 * obs[:, :2], count=20)
    narrow = Episodes(tuple(1e-2 * obs for obs in demos.obs), demos.act, demos.terminated)
    reward = Shaped(steps=300).fit(narrow, no_environment, np.random.default_rng(0)).reward
    assert isinstance(reward, ShapedReward)
    # Even a hundred of the demonstrations' spreads away L is smaller than the identity beside it.
    assert np.abs(reward.chol(100 * narrow.pairs()[0])).max() < 1
