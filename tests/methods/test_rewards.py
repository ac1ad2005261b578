"""What ends pay where nobody shows one."""

import numpy as np
import pytest
import torch

from methods.base import Array, Episodes
from methods.maxent import MaxEnt
from methods.network import mlp
from methods.rewards import NetworkReward, deterred

STILL = np.zeros((2, 1))


def episodes(*terminated: bool) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.normal(size=(3, 3)) for _ in terminated), (STILL,) * len(terminated), terminated
    )


def reward(seed: int) -> NetworkReward:
    layers = mlp(3 + 1 + 1, 16, 1, generator=torch.Generator().manual_seed(seed))
    return NetworkReward.of(layers, np.zeros(3), np.ones(3))


def paid(reward: NetworkReward, seen: Episodes) -> Array:
    obs, act = seen.pairs()
    return reward(obs, act, obs)


@pytest.mark.parametrize("seed", range(6))
def test_where_others_end_more_often_an_end_pays_no_more_than_any_of_their_steps(seed: int) -> None:
    shown, others = episodes(False, True), [episodes(False, False), episodes(True, True)]
    before = reward(seed)
    after = deterred(before, shown, others)
    least = min(paid(before, seen).min() for seen in others)
    assert after.absorbing == min(before.absorbing, least)
    for seen in others:
        np.testing.assert_array_equal(paid(after, seen), paid(before, seen))


@pytest.mark.parametrize("others", [(False, False), (True, False)])
def test_elsewhere_it_pays_what_it_did(others: tuple[bool, ...]) -> None:
    before = reward(0)
    assert deterred(before, episodes(True, False), [episodes(*others)]) is before


def test_maxent_pays_an_end_that_is_forgotten_the_least(mortal_world, demonstrate) -> None:
    """After one step on the reward an end pays what chance says."""
    demos = demonstrate(lambda obs: 0 * obs[:, :2])
    obs = np.random.default_rng(1).uniform(-1, 1, (200, 3))
    act = np.random.default_rng(2).uniform(-1, 1, (200, 2))
    for seed in range(5):
        method = MaxEnt(iterations=1, averaged=1, reward_steps=1)
        learned = method.fit(demos, mortal_world, np.random.default_rng(seed)).reward
        assert learned.absorbing < learned(obs, act, obs).mean()
