"""What rewards pay, in float64 and float32, and for ends that nobody shows."""

import numpy as np
import pytest
import torch

from methods.base import Episodes
from methods.network import mlp
from methods.rewards import Constant, MeanReward, NetworkReward, deterred, fast, paid

MEAN, STD = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])


def test_the_reward_is_the_torch_network_on_standardised_observations_and_bounded() -> None:
    layers = mlp(3 + 2 + 1, 16, 1, generator=torch.Generator().manual_seed(0))
    reward = NetworkReward.of(layers, MEAN, STD, bound=1.5)
    rng = np.random.default_rng(0)
    obs, act = rng.normal(size=(20, 3)), rng.uniform(-1, 1, (20, 2))
    inputs = np.concatenate([(obs - MEAN) / STD, act, np.zeros((20, 1))], axis=1)
    absorbed = np.array([[0, 0, 0, 0, 0, 1.0]])
    with torch.no_grad():
        output = layers.double()(torch.as_tensor(np.concatenate([inputs, absorbed])))[:, 0]
    expected = 1.5 * np.tanh(output.numpy())
    np.testing.assert_allclose(reward(obs, act, obs), expected[:-1], rtol=1e-6)
    assert reward.absorbing == pytest.approx(expected[-1], rel=1e-6)


STILL = np.zeros((2, 1))


def episodes(*terminated: bool) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.normal(size=(3, 3)) for _ in terminated), (STILL,) * len(terminated), terminated
    )


def reward(seed: int) -> NetworkReward:
    layers = mlp(3 + 1 + 1, 16, 1, generator=torch.Generator().manual_seed(seed))
    return NetworkReward.of(layers, np.zeros(3), np.ones(3))


@pytest.mark.parametrize("most", [-100.0, 100.0])
def test_where_random_actions_end_more_often_an_end_pays_no_more_than_is_said(most: float) -> None:
    shown, random = episodes(False, True), episodes(True, True)
    before = reward(0)
    after = deterred(before, shown, random, most)
    assert after.absorbing == min(before.absorbing, most)
    for seen in (shown, random):
        np.testing.assert_array_equal(paid(after, seen), paid(before, seen))
    assert deterred(before, shown, shown, -100.0) is before


@pytest.mark.parametrize("bound", [None, 2.0])
@pytest.mark.parametrize("rows", [1, 300, 1100])
def test_a_mean_pays_in_float32_what_it_pays_in_float64(bound: float | None, rows: int) -> None:
    rng = np.random.default_rng(0)
    mean, std = np.array([100.0, 0.0, -3.0]), np.array([0.1, 1.0, 30.0])
    each = tuple(
        NetworkReward.of(mlp(5, 16, 8, 1, generator=torch.Generator().manual_seed(i)), mean, std, bound=bound)
        for i in range(4)
    )
    obs, act = mean + std * rng.normal(size=(rows, 3)), rng.uniform(-1, 1, (rows, 1))
    for reward in (each[0], MeanReward(each)):
        compiled = reward.compiled
        assert compiled is not reward
        assert compiled is reward.compiled
        assert compiled.absorbing == pytest.approx(reward.absorbing)
        expected = reward(obs, act, obs)
        np.testing.assert_allclose(compiled(obs, act, obs), expected, atol=1e-6 * np.abs(expected).max())


def test_a_subclass_and_a_mean_of_other_rewards_stay_as_they_are() -> None:
    class Own(NetworkReward):
        pass

    own = Own(**vars(reward(0)))
    for other in (own, MeanReward((own,)), MeanReward((reward(0), Constant(1.0, 0.0)))):
        assert fast(other) is other
