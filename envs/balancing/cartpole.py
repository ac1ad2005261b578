"""Continuous cart-pole: Gymnasium's CartPole physics (Barto, Sutton & Anderson 1983), a force in
proportion to the action, and the reward of RLLab (Duan et al. 2016), as in the thesis.

For actions of -1 and +1 the dynamics equal those of Gymnasium's `CartPole-v1`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.balancing.cart_and_pole import ANGLE, POSITION, RATE, VELOCITY, centred, draw_cart_and_pole
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped

HORIZON = 500


@dataclass(frozen=True)
class Physics:
    """Of a cart with a pole."""

    gravity: float = 9.8
    """[m/s^2]"""
    cart_mass: float = 1.0
    """[kg]"""
    pole_mass: float = 0.1
    """[kg]"""
    half_length: float = 0.5
    """Half of the pole's [m]."""
    max_force: float = 10.0
    """At an action of 1 [N]."""
    time_step: float = 0.02
    """[s]"""
    max_x: float = 2.4
    """How far from the middle the track ends [m]."""
    max_angle: float = 12 * 2 * math.pi / 360
    """How far from upright the pole counts as fallen [rad]."""

    def advance(self, state: Any, force: Any) -> tuple[Any, Any, Any, Any]:
        """The state after one step of one cart-pole or, of arrays, of many."""
        x, x_dot, angle, angle_dot = state
        cos, sin = np.cos(angle), np.sin(angle)
        pole_mass, half_length, dt = self.pole_mass, self.half_length, self.time_step
        total_mass = self.cart_mass + pole_mass
        push = (force + pole_mass * half_length * (angle_dot * angle_dot) * sin) / total_mass
        angle_acc = (self.gravity * sin - cos * push) / (
            half_length * (4 / 3 - pole_mass * (cos * cos) / total_mass)
        )
        x_acc = push - pole_mass * half_length * angle_acc * cos / total_mass
        x, x_dot = x + dt * x_dot, x_dot + dt * x_acc
        angle, angle_dot = angle + dt * angle_dot, angle_dot + dt * angle_acc
        return x, x_dot, angle, angle_dot

    def fails(self, x: Any, angle: Any) -> Any:
        """Whether the cart is off the track or the pole has fallen."""
        return (abs(x) > self.max_x) | (abs(angle) > self.max_angle)

    def failure(self, x: float) -> str:
        """What ended an episode with the cart at x [m]."""
        return "cart left the track" if abs(x) > self.max_x else "pole fell"

    def observations(self) -> spaces.Space[NDArray[np.float32]]:
        """What can be observed."""
        bound = np.array([2 * self.max_x, np.inf, 2 * self.max_angle, np.inf], np.float32)
        return spaces.Box(-bound, bound, dtype=np.float32)


NOMINAL = Physics()


class CartPole(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Observation (4,): cart position [m] and velocity [m/s], pole angle [rad] and its rate [rad/s].

    Action (1,) in [-1, 1], times 10 N. The episode terminates where |position| > 2.4 m or
    |angle| > 12 degrees. Reward: (10 - (1 - cos angle) - 1e-5 force^2) / 10 while alive, 0 on failing.
    """

    def __init__(self, physics: Physics = NOMINAL) -> None:
        self.physics = physics
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = physics.observations()
        self.state: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self.state = tuple(self.np_random.uniform(-0.05, 0.05, 4).tolist())
        return np.array(self.state, np.float32), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        force = self.physics.max_force * min(1.0, max(-1.0, float(action[0])))
        self.state = tuple(float(value) for value in self.physics.advance(self.state, force))
        failed = self.physics.fails(self.state[0], self.state[2])
        reward = 0.0 if failed else float(pay(self.state[2], force))
        return np.array(self.state, np.float32), reward, bool(failed), False, {}


def pay(angle: Any, force: Any) -> Any:
    """RLLab's reward of a step that did not fail."""
    return (10 - (1 - np.cos(angle)) - 1e-5 * (force * force)) / 10


class CartPoleBatch:
    """Cart-poles in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, physics: Physics = NOMINAL) -> None:
        self._env = CartPole(physics)
        self._states = np.zeros((count, 4))

    def reset(self, place: int, seed: int) -> Array:
        obs, _ = self._env.reset(seed=seed)
        self._states[place] = self._env.state
        return obs.astype(np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        physics = self._env.physics
        force = physics.max_force * np.clip(act[:, 0].astype(np.float32).astype(np.float64), -1, 1)
        states = np.stack(physics.advance(self._states[places].T, force), axis=1)
        self._states[places] = states
        failed: NDArray[np.bool_] = physics.fails(states[:, 0], states[:, 2])
        rewards = np.where(failed, 0.0, pay(states[:, 2], force))
        return states.astype(np.float32).astype(np.float64), rewards, failed

    def why_ended(self, place: int) -> str:
        return self._env.physics.failure(float(self._states[place, 0]))


def phi(obs: Array, act: Array) -> Array:
    """(B, 5): how centred each observation is, and a constant."""
    return centred(obs, (NOMINAL.max_x, 3.0, NOMINAL.max_angle, 3.5))


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """The track, the cart as a box and the pole as a line."""
    inner: Any = env.unwrapped
    x, _, angle, _ = (float(value) for value in inner.state)
    return draw_cart_and_pole(x, angle, inner.physics.max_x, 2 * inner.physics.half_length)


def why_ended(env: gym.Env[Any, Any]) -> str:
    """'cart left the track' or 'pole fell'."""
    inner: Any = env.unwrapped
    failure: str = inner.physics.failure(inner.state[0])
    return failure


SPEC = EnvSpec(
    name="cartpole",
    summary="continuous cart-pole: keep the pole upright for 500 steps (RLLab's reward)",
    env_id="irl_bench/CartPole-v0",
    obs_size=4,
    act_size=1,
    obs_names=(POSITION, VELOCITY, ANGLE, RATE),
    act_names=(Quantity("motor", "10 N"),),
    obs_scale=(1.0, 0.5, 0.05, 0.5),
    horizon=HORIZON,
    gamma=0.99,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: 495.0,
    max_terminated={"smoke": 1.0, "quick": 1.0, "full": 1.0},
    rl_steps={"smoke": 600, "quick": 16_000, "full": 30_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    demo_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=60_000, bar=499.5),
    batch=CartPoleBatch,
    variants={
        "long_pole": {"physics": Physics(half_length=0.75)},
        "heavy": {"physics": Physics(pole_mass=0.5)},
        "flipped": {"physics": Physics(max_force=-NOMINAL.max_force)},
    },
)

gym.register(
    SPEC.env_id,
    entry_point="envs.balancing.cartpole:CartPole",
    max_episode_steps=HORIZON,
    disable_env_checker=True,
)
