"""The shaped reward is eq. 4.3, whatever its weights."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.base import Episodes
from methods.network import Network, mlp
from methods.shaped import Shaped, ShapedReward, shaped_reward
from tests.methods.worlds import FakeWorld, demonstrate

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
