"""A task that is odd where a test asks for it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec as Registered

from envs import EnvSpec
from harness.rl.simulator import Simulator

LIMIT = 20
BOX = spaces.Box(-1.0, 1.0, (2,), np.float32)


class Odd(gym.Env):
    """It observes the steps taken and a start in [0, 1], pays 1, and keeps what it was told to do."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    told: list[Any]

    def __init__(self, act: spaces.Space = BOX, **odd: Any) -> None:
        self.action_space, self.odd, self.steps = act, odd, 0
        self.told = []
        self.buffer = np.zeros(2, np.float32)

    def seen(self) -> Any:
        self.buffer[:] = self.steps, self.start
        if "observe" in self.odd:
            return self.odd["observe"](self)
        return self.buffer if self.odd.get("reuse") else self.buffer.copy()

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps, self.start = 0, self.np_random.random()
        return self.seen(), {}

    def step(self, action: Any) -> tuple:
        assert self.action_space.contains(action), action
        self.told.append(action)
        self.steps += 1
        pay, end, cut = (
            self.odd.get(name, of) for name, of in (("pay", one), ("end", never), ("cut", never))
        )
        return self.seen(), pay(self), end(self), cut(self), {}


def one(env: Odd) -> Any:
    return 1.0


def never(env: Odd) -> Any:
    return False


def after(steps: int) -> Callable[[Odd], bool]:
    return lambda env: env.steps >= steps


@pytest.fixture
def task(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., str]]:
    """A function that registers an odd task for the test alone, and returns its id."""
    numbers = itertools.count()

    def register(
        entry: Callable[..., gym.Env] | None = None,
        limit: int | None = LIMIT,
        wrapped: tuple = (),
        **odd: Any,
    ) -> str:
        env_id = f"irl_bench_tests/Odd{next(numbers)}-v0"
        spec = Registered(
            env_id,
            entry or partial(Odd, **odd),
            max_episode_steps=limit,
            disable_env_checker=True,
            additional_wrappers=wrapped,
        )
        monkeypatch.setitem(gym.registry, env_id, spec)
        return env_id

    with np.errstate(over="ignore"):  # Gymnasium casts bounds.
        yield register


def lengths(spec: EnvSpec, count: int = 4) -> set[tuple[int, bool, str]]:
    episodes = Simulator(spec, lanes=3).run(lambda obs: np.zeros((len(obs), spec.act_size)), range(count))
    return {(len(episode.act), episode.terminated, episode.ending) for episode in episodes}


def inner(env: gym.Env) -> Odd:
    its = env.unwrapped
    assert isinstance(its, Odd)
    return its
