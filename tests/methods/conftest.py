"""A world without dynamics that answers at once: for what methods compute themselves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from methods.base import Array, Episodes, Policy, Reward


class FakeWorld:
    """Observations are uniform noise (3,), actions (2,); `solve` picks the best of some constant policies.

    Every episode lasts `lifetime` steps, and terminates if that is less than the horizon.
    """

    obs_size, act_size, horizon, gamma = 3, 2, 10, 0.9

    def __init__(self, lifetime: int = 10) -> None:
        self.lifetime = lifetime
        self.solves: list[tuple[Reward, int, bool]] = []

    def phi(self, obs: Array, act: Array) -> Array:
        return np.concatenate([act, np.ones((len(act), 1))], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs = tuple(rng.uniform(-1, 1, (self.lifetime + 1, 3)) for _ in range(episodes))
        return Episodes(obs, tuple(policy(o[:-1]) for o in obs), (self.lifetime < self.horizon,) * episodes)

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int, warm: bool = False) -> Policy:
        self.solves.append((reward, steps, warm))
        obs = rng.uniform(-1, 1, (64, 3))
        choices = rng.uniform(-1, 1, (500, 2))
        values = [reward(obs, np.tile(c, (64, 1)), obs).mean() for c in choices]
        best = choices[int(np.argmax(values))]
        return lambda o: np.tile(best, (len(o), 1))


class NoEnvironment:
    """The sizes of a world, and nothing in it that could be touched."""

    obs_size, act_size, horizon, gamma = 3, 2, 10, 0.9


@pytest.fixture
def world() -> FakeWorld:
    return FakeWorld()


@pytest.fixture
def mortal_world() -> FakeWorld:
    """Where every rollout terminates after two of its ten steps."""
    return FakeWorld(lifetime=2)


@pytest.fixture
def no_environment() -> NoEnvironment:
    return NoEnvironment()


@pytest.fixture
def demonstrate() -> Callable[..., Episodes]:
    """Demonstrations of a policy, (B, 3) to (B, 2), on uniform observations."""

    def episodes(policy: Policy, count: int = 20, lifetime: int = 10, seed: int = 0) -> Episodes:
        return FakeWorld(lifetime).rollout(policy, count, np.random.default_rng(seed))

    return episodes
