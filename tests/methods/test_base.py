"""Demonstrations, and what methods make of them: rows, features, rewards, and what ends pay."""

import numpy as np
import pytest
import torch

from methods.base import Array, Episodes, Transitions
from methods.fourier import FourierFeatures
from methods.network import mlp
from methods.rewards import MeanReward, NetworkReward, default_absorbing, deterred, paid
from methods.visits import visitations, visited


def episodes(lengths: list[int], terminated: bool = False) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.standard_normal((n + 1, 3)) for n in lengths),
        tuple(rng.uniform(-1, 1, (n, 2)) for n in lengths),
        tuple(terminated for _ in lengths),
    )


def test_transitions_are_of_steps_that_follow_each_other() -> None:
    obs = tuple(np.arange(n + 1.0)[:, None] + 100 * n for n in (4, 7))
    act = tuple(np.linspace(-1, 1, n)[:, None] for n in (4, 7))
    before, done, after = Episodes(obs, act, (False, False)).transitions()
    np.testing.assert_array_equal(done, np.concatenate(act))
    np.testing.assert_array_equal(after, before + 1)
    times = (np.array([0, 1, 3]), np.array([2, 5, 6]))
    some = [tuple(rows[at] for rows, at in zip(column, times, strict=True)) for column in (obs, act)]
    before, done, after = Episodes(*some, (False, False), times, (4, 7)).transitions()
    assert (before[:, 0].tolist(), after[:, 0].tolist()) == ([400, 705], [401, 706])
    np.testing.assert_array_equal(done, [act[0][0], act[1][5]])


@pytest.mark.parametrize(
    ("obs", "act"),
    [
        ([], []),
        ([np.zeros((4, 3))], [np.zeros((4, 2))]),
        ([np.full((4, 3), np.nan)], [np.zeros((3, 2))]),
        ([np.zeros((4, 3))], [np.full((3, 2), 1.5)]),
    ],
)
def test_bad_episodes_are_refused(obs: list[np.ndarray], act: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="episode"):
        Episodes(tuple(obs), tuple(act), tuple(False for _ in obs))


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 2))


MEAN, STD = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])


def test_steps_of_an_agent_are_described_as_those_of_episodes_are() -> None:
    rng = np.random.default_rng(0)
    episodes = Episodes((rng.normal(size=(5, 3)),), (rng.uniform(-1, 1, (4, 2)),), (True,))
    obs, act = episodes.pairs()
    absorbing = np.array([False] * 4 + [True] * 2)
    there = np.full((2, 3), 7.0), np.full((2, 2), 0.5)
    obs, act = np.concatenate([obs, there[0]]), np.concatenate([act, there[1]])
    steps = Transitions.own(obs, act, obs, absorbing, absorbing)
    for actions in (True, False):
        rows = visitations(episodes, 2, MEAN, STD, actions)
        np.testing.assert_array_equal(visited(steps, MEAN, STD, actions), rows)


def test_an_end_pays_the_mean_of_uniform_actions_unless_all_demonstrations_end() -> None:
    class Quadratic:
        absorbing = 0.0

        def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
            return np.asarray(-np.square(act).sum(1))

    lives, dies, rng = episodes([20_000]), episodes([50, 7], terminated=True), np.random.default_rng(1)
    assert default_absorbing(Quadratic(), lives, uniform, rng) == pytest.approx(-2 / 3, abs=0.02)
    shown = -np.square(dies.pairs()[1]).sum(1).mean()
    assert default_absorbing(Quadratic(), dies, uniform, rng) == pytest.approx(shown)


def test_products_of_random_waves_are_a_kernels_and_follow_the_tasks_own_features() -> None:
    rng, width = np.random.default_rng(0), 1.7
    obs, act = MEAN + STD * rng.normal(size=(200, 3)), rng.uniform(-1, 1, (200, 2))
    own = lambda obs, act: np.column_stack([obs[:, 0], act[:, 1]])  # noqa: E731
    features = FourierFeatures.drawn(own, obs, 2, 20_000, width, rng)(obs, act)
    np.testing.assert_array_equal(features[:, :2], own(obs, act))
    x = np.column_stack([(obs - obs.mean(axis=0)) / obs.std(axis=0), act])
    squares = np.square(x[:, None] - x).sum(axis=2)
    kernel = np.exp(-squares / (2 * width**2))
    np.testing.assert_allclose(features[:, 2:] @ features[:, 2:].T, kernel, atol=0.05)


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


def reward(seed: int) -> NetworkReward:
    layers = mlp(3 + 2 + 1, 16, 1, generator=torch.Generator().manual_seed(seed))
    return NetworkReward.of(layers, np.zeros(3), np.ones(3))


@pytest.mark.parametrize("most", [-100.0, 100.0])
def test_where_random_actions_end_more_often_an_end_pays_no_more_than_is_said(most: float) -> None:
    shown, random = episodes([2, 2]), episodes([2, 2], terminated=True)
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
