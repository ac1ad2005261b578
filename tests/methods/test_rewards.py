"""What ends pay where nobody shows one."""

import numpy as np
import pytest
import torch

from methods.base import Episodes
from methods.maxent import MaxEnt
from methods.network import mlp
from methods.rewards import NetworkReward, deterred, paid

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
