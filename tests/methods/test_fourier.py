"""Inner products of random Fourier features are nearly a Gaussian kernel's values."""

import numpy as np

from methods.base import Array
from methods.fourier import FourierFeatures

MEAN, STD = np.array([3.0, -1.0, 0.0]), np.array([2.0, 0.1, 1.0])
OBS = MEAN + STD * np.random.default_rng(0).normal(size=(200, 3))
ACT = np.random.default_rng(1).uniform(-1, 1, (200, 2))


def hand_made(obs: Array, act: Array) -> Array:
    return np.column_stack([obs[:, 0], act[:, 1]])


def drawn(count: int, width: float, seed: int = 2) -> FourierFeatures:
    return FourierFeatures.drawn(hand_made, OBS, 2, count, width, np.random.default_rng(seed))


def test_they_come_after_the_tasks_own() -> None:
    features = drawn(7, 1.0)(OBS, ACT)
    assert features.shape == (200, 2 + 7)
    np.testing.assert_array_equal(features[:, :2], hand_made(OBS, ACT))


def test_their_products_are_the_kernels() -> None:
    width = 1.7
    waves = drawn(40_000, width)(OBS, ACT)[:, 2:]
    x = np.column_stack([(OBS - OBS.mean(axis=0)) / OBS.std(axis=0), ACT])
    squares = np.square(x[:, None] - x).sum(axis=2)
    np.testing.assert_allclose(waves @ waves.T, np.exp(-squares / (2 * width**2)), atol=0.04)


def test_nothing_but_the_generator_decides() -> None:
    np.testing.assert_array_equal(drawn(9, 1.0)(OBS, ACT), drawn(9, 1.0)(OBS, ACT))
    assert (drawn(9, 1.0, seed=3)(OBS, ACT) != drawn(9, 1.0)(OBS, ACT)).any()
