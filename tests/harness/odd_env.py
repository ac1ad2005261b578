"""A task that is odd where a test asks for it."""

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
    """It observes the steps taken and a start in [0, 1], pays 1, and keeps what it was told to do.

    `odd`: functions of itself, in the place of what it observes, pays, or says of its end.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)

    def __init__(self, act: spaces.Space = BOX, reuse: bool = False, **odd: Any) -> None:
        self.action_space, self.reuse, self.steps = act, reuse, 0
        self.odd = {"observe": observed, "pay": one, "end": never, "cut": never} | odd
        self.told: list[Any] = []
        self.buffer = np.zeros(2, np.float32)

    def seen(self) -> Any:
        self.buffer[:] = self.steps, self.start
        return self.odd["observe"](self)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps, self.start = 0, self.np_random.random()
        return self.seen(), {}

    def step(self, action: Any) -> tuple:
        assert self.action_space.contains(action), action
        self.told.append(action)
        self.steps += 1
        return self.seen(), *(self.odd[name](self) for name in ("pay", "end", "cut")), {}


def observed(env: Odd) -> Any:
    return env.buffer if env.reuse else env.buffer.copy()


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

    def register(entry: Any = None, limit: int | None = LIMIT, wrapped: tuple = (), **odd: Any) -> str:
        env_id = f"irl_bench_tests/Odd{next(numbers)}-v0"
        more: dict[str, Any] = {"disable_env_checker": True, "additional_wrappers": wrapped}
        spec = Registered(env_id, entry or partial(Odd, **odd), max_episode_steps=limit, **more)
        monkeypatch.setitem(gym.registry, env_id, spec)
        return env_id

    with np.errstate(over="ignore"):  # Gymnasium casts bounds.
        yield register


def lengths(spec: EnvSpec, count: int = 4) -> set[tuple[int, bool, str]]:
    episodes = Simulator(spec, lanes=3).run(lambda obs: np.zeros((len(obs), spec.act_size)), range(count))
    return {(len(episode.act), episode.terminated, episode.ending) for episode in episodes}


def inner(env: gym.Env) -> Odd:
    assert isinstance(env.unwrapped, Odd)
    return env.unwrapped
