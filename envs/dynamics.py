"""Environments whose dynamics are written down once, over the array namespace of their arguments. NumPy runs
one of them, or many in lockstep; JAX runs them in the loop that reinforcement learning compiles."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.shapes import Array


class Draws(Protocol):
    """A source of first states: NumPy's generator, or one with the same methods, to be asked once."""

    def uniform(self, low: Any, high: Any) -> Any:
        """(S,): uniform between bounds (S,)."""

    def standard_normal(self, size: int) -> Any:
        """(size,)."""


@runtime_checkable
class Dynamics(Hashable, Protocol):
    """What becomes of a state under an action in [-1, 1]^A, of 32 bits. Of one, state (S,), obs (O,), act
    (A,); of B in lockstep, (S, B), (O, B), (A, B), and what is a number of one is (B,). Arrays are NumPy's or
    JAX's, as those given are."""

    @property
    def act_size(self) -> int: ...

    @property
    def bounds(self) -> Sequence[float]:
        """(O,): how far from 0 each observation may be."""

    def start(self, draws: Draws) -> Any:
        """(S,): the first state of an episode."""

    def advance(self, state: Any, act: Any) -> Any:
        """The state a step later."""

    def observe(self, state: Any) -> Any:
        """What is seen of it."""

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        """The true reward of a step, that of failing included."""

    def fails(self, state: Any) -> Any:
        """Whether the episode terminates there."""

    def failure(self, state: Array) -> str:
        """Of one: what ended an episode there, in a few words."""


class DynamicsEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One of them."""

    def __init__(self, physics: Dynamics) -> None:
        self.physics = physics
        bounds = np.array(physics.bounds, np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (physics.act_size,), np.float32)
        self.observation_space = spaces.Box(-bounds, bounds, dtype=np.float32)
        self.state: Array = np.zeros(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self.state = self.physics.start(self.np_random)
        return self.physics.observe(self.state).astype(np.float32), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        physics, before = self.physics, self.state
        act = np.clip(action, -1, 1).astype(np.float64)
        self.state = physics.advance(before, act)
        reward = float(physics.pay(before, act, self.state))
        obs = physics.observe(self.state).astype(np.float32)
        return obs, reward, bool(physics.fails(self.state)), False, {}


class DynamicsBatch:
    """Many in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, physics: Dynamics) -> None:
        self._env = DynamicsEnv(physics)
        self._states: Array | None = None
        self._count = count

    def reset(self, place: int, seed: int) -> Array:
        obs, _ = self._env.reset(seed=seed)
        if self._states is None:
            self._states = np.zeros((len(self._env.state), self._count))
        self._states[:, place] = self._env.state
        return obs.astype(np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        assert self._states is not None
        physics, before = self._env.physics, self._states[:, places]
        if act.shape != (len(places), physics.act_size):
            raise ValueError(f"actions of {len(places)} copies have shape {act.shape}")
        given = np.clip(act.T.astype(np.float32), -1, 1).astype(np.float64)
        after = physics.advance(before, given)
        self._states[:, places] = after
        obs = physics.observe(after).astype(np.float32).astype(np.float64).T
        return obs, physics.pay(before, given, after), physics.fails(after)

    def why_ended(self, place: int) -> str:
        assert self._states is not None
        return self._env.physics.failure(self._states[:, place])


def why_ended(env: gym.Env[Any, Any]) -> str:
    """What ended the episode."""
    inner: Any = env.unwrapped
    failure: str = inner.physics.failure(inner.state)
    return failure


def namespace(state: Any) -> Any:
    """Return the module whose functions take such an array: NumPy, or JAX's."""
    return state.__array_namespace__()


def never(state: Any) -> Any:
    """Return False for each state, for dynamics that never fail."""
    return namespace(state).zeros(state.shape[1:], dtype=bool)


def runge_kutta(rates: Callable[[Any], Any], state: Any, seconds: float, parts: int) -> Any:
    """The state after so many seconds, in equal parts of the classical fourth-order method. rates: the
    state's derivative."""
    dt = seconds / parts
    for _ in range(parts):
        first = rates(state)
        second = rates(state + dt / 2 * first)
        third = rates(state + dt / 2 * second)
        fourth = rates(state + dt * third)
        state = state + dt / 6 * (first + 2 * second + 2 * third + fourth)
    return state
