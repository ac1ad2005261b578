"""What ends pay where nobody shows one."""

import numpy as np
import pytest
import torch

from methods.base import Episodes
from methods.maxent import MaxEnt
from methods.network import mlp
from methods.rewards import Constant, MeanReward, NetworkReward, deterred, paid

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


@pytest.mark.parametrize("random", [(False, False), (True, False)])
def test_elsewhere_it_pays_what_it_did(random: tuple[bool, ...]) -> None:
    before = reward(0)
    assert deterred(before, episodes(True, False), episodes(*random), -100.0) is before


def test_an_end_that_maxent_forgets_pays_no_more_than_random_steps(mortal_world, demonstrate) -> None:
    """After one step on the reward an end pays what chance says."""
    demos = demonstrate(lambda obs: 0 * obs[:, :2])
    obs = np.random.default_rng(1).uniform(-1, 1, (5000, 3))
    act = np.random.default_rng(2).uniform(-1, 1, (5000, 2))
    for seed in range(12):
        method = MaxEnt(iterations=1, averaged=1, reward_steps=1, rollouts=1000)
        learned = method.fit(demos, mortal_world, np.random.default_rng(seed)).reward
        assert learned.absorbing < learned(obs, act, obs).mean() + 0.01


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


def test_what_a_compiled_mean_pays_a_step_does_not_depend_on_the_others() -> None:
    rng = np.random.default_rng(0)
    compiled = MeanReward((reward(0), reward(1))).compiled
    obs, act = rng.normal(size=(700, 3)), rng.uniform(-1, 1, (700, 1))
    every = compiled(obs, act, obs)
    np.testing.assert_array_equal(compiled(obs[100:600], act[100:600], obs[100:600]), every[100:600])


def test_a_subclass_pays_what_it_says_itself() -> None:
    class Own(NetworkReward):
        pass

    own = Own(**vars(reward(0)))
    assert own.compiled is own
    assert isinstance(MeanReward((own,)).compiled, MeanReward)


def test_a_mean_of_other_rewards_stays_as_it_is() -> None:
    for others in ((reward(0), Constant(1.0, 0.0)), (Constant(1.0, 0.0),)):
        mean = MeanReward(others)
        assert mean.compiled is mean
