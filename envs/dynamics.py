"""Environments whose dynamics are written once, for NumPy and JAX. NumPy runs one of them, or many in
lockstep. JAX runs them inside compiled reinforcement learning."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs.spec import Array, Flags, Floats


class Draws(Protocol):
    """A random source of first states, used once: NumPy's generator, or another with its methods."""

    def uniform(self, low: Any, high: Any) -> Any:
        """Return uniform numbers between bounds (S,), (S,)."""

    def standard_normal(self, size: int) -> Any:
        """Return standard normal numbers, (size,)."""


@runtime_checkable
class Dynamics(Hashable, Protocol):
    """Transitions and rewards of states under actions in [-1, 1]^A, of 32 bits.

    One copy has state (S,), obs (O,) and act (A,). B copies in lockstep have (S, B), (O, B), (A, B) and (B,)
    for numbers. Results are arrays of NumPy or JAX, like the arguments.
    """

    @property
    def act_size(self) -> int: ...

    @property
    def bounds(self) -> Sequence[float]:
        """Largest size of each observation, (O,)."""

    def start(self, draws: Draws) -> Any:
        """Return the first state of an episode, (S,)."""

    def advance(self, state: Any, act: Any) -> Any:
        """Return the state a step later."""

    def observe(self, state: Any) -> Any:
        """Return the observation of a state."""

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        """Return the true reward of a step, that of failing included."""

    def fails(self, state: Any) -> Any:
        """Return True where the episode terminates."""

    def failure(self, state: Array) -> str:
        """Return why an episode of one copy terminated in a state, in a few words."""


class DynamicsEnv(gym.Env[Floats, Floats]):
    """One copy of dynamics as an environment."""

    def __init__(self, physics: Dynamics) -> None:
        self.physics = physics
        bounds = np.array(physics.bounds, np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (physics.act_size,), np.float32)
        self.observation_space = spaces.Box(-bounds, bounds, dtype=np.float32)
        self.state: Array = np.zeros(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed)
        self.state = self.physics.start(self.np_random)
        return self.physics.observe(self.state).astype(np.float32), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        physics, before = self.physics, self.state
        act = np.clip(action, -1, 1).astype(np.float64)
        self.state = physics.advance(before, act)
        reward = float(physics.pay(before, act, self.state))
        obs = physics.observe(self.state).astype(np.float32)
        return obs, reward, bool(physics.fails(self.state)), False, {}


class DynamicsBatch:
    """Many copies of dynamics in lockstep (`envs.spec.Batch`)."""

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

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags]:
        assert self._states is not None
        physics, before = self._env.physics, self._states[:, places]
        if act.shape != (len(places), physics.act_size):
            raise ValueError(f"actions of {len(places)} copies have shape {act.shape}")
        clipped = np.clip(act.T.astype(np.float32), -1, 1).astype(np.float64)
        after = physics.advance(before, clipped)
        self._states[:, places] = after
        obs = physics.observe(after).astype(np.float32).astype(np.float64).T
        return obs, physics.pay(before, clipped, after), physics.fails(after)

    def why_ended(self, place: int) -> str:
        assert self._states is not None
        return self._env.physics.failure(self._states[:, place])


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return why the episode terminated."""
    inner: Any = env.unwrapped
    failure: str = inner.physics.failure(inner.state)
    return failure


def namespace(state: Any) -> Any:
    """Return the module whose functions take such an array, NumPy or JAX's."""
    return state.__array_namespace__()


def never(state: Any) -> Any:
    """Return False for each state, for dynamics that never fail."""
    return namespace(state).zeros(state.shape[1:], dtype=bool)


def runge_kutta(rates: Callable[[Any], Any], state: Any, seconds: float, parts: int) -> Any:
    """Return the state after `seconds`, by the classical fourth-order method. `rates`: a state's
    derivative."""
    dt = seconds / parts
    for _ in range(parts):
        first = rates(state)
        second = rates(state + dt / 2 * first)
        third = rates(state + dt / 2 * second)
        fourth = rates(state + dt * third)
        state = state + dt / 6 * (first + 2 * second + 2 * third + fourth)
    return state
