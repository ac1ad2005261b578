"""Continuous cart-pole: Gymnasium's CartPole physics (Barto, Sutton & Anderson 1983), a force in
proportion to the action, and the reward of RLLab (Duan et al. 2016), as in the thesis.

For actions of -1 and +1 the dynamics equal those of Gymnasium's `CartPole-v1`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.spec import Array, EnvSpec, Shape, Shipped

GRAVITY = 9.8  # m/s^2
CART_MASS, POLE_MASS = 1.0, 0.1  # kg
HALF_LENGTH = 0.5  # m, half of the pole's length
MAX_FORCE = 10.0  # N, at an action of 1
TIME_STEP = 0.02  # s
MAX_X = 2.4  # m
MAX_ANGLE = 12 * 2 * math.pi / 360  # rad
HORIZON = 500


class CartPole(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Observation (4,): cart position [m] and velocity [m/s], pole angle [rad] and its rate [rad/s].

    Action (1,) in [-1, 1], times 10 N. The episode terminates where |position| > 2.4 m or
    |angle| > 12 degrees. Reward: (10 - (1 - cos angle) - 1e-5 force^2) / 10 while alive, 0 on failing.
    """

    def __init__(self) -> None:
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        bound = np.array([2 * MAX_X, np.inf, 2 * MAX_ANGLE, np.inf], np.float32)
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
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
        force = MAX_FORCE * min(1.0, max(-1.0, float(action[0])))
        self.state = tuple(float(value) for value in advance(self.state, force))
        failed = fails(self.state[0], self.state[2])
        reward = 0.0 if failed else float(pay(self.state[2], force))
        return np.array(self.state, np.float32), reward, bool(failed), False, {}


def advance(state: Any, force: Any) -> tuple[Any, Any, Any, Any]:
    """The state after one step of one cart-pole or, of arrays, of many."""
    x, x_dot, angle, angle_dot = state
    cos, sin = np.cos(angle), np.sin(angle)
    total_mass = CART_MASS + POLE_MASS
    push = (force + POLE_MASS * HALF_LENGTH * (angle_dot * angle_dot) * sin) / total_mass
    angle_acc = (GRAVITY * sin - cos * push) / (HALF_LENGTH * (4 / 3 - POLE_MASS * (cos * cos) / total_mass))
    x_acc = push - POLE_MASS * HALF_LENGTH * angle_acc * cos / total_mass
    x, x_dot = x + TIME_STEP * x_dot, x_dot + TIME_STEP * x_acc
    angle, angle_dot = angle + TIME_STEP * angle_dot, angle_dot + TIME_STEP * angle_acc
    return x, x_dot, angle, angle_dot


def fails(x: Any, angle: Any) -> Any:
    """Whether the cart is off the track or the pole has fallen."""
    return (abs(x) > MAX_X) | (abs(angle) > MAX_ANGLE)


def pay(angle: Any, force: Any) -> Any:
    """RLLab's reward of a step that did not fail."""
    return (10 - (1 - np.cos(angle)) - 1e-5 * (force * force)) / 10


class CartPoleBatch:
    """Cart-poles in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int) -> None:
        self._env = CartPole()
        self._states = np.zeros((count, 4))

    def reset(self, place: int, seed: int) -> Array:
        obs, _ = self._env.reset(seed=seed)
        self._states[place] = self._env.state
        return obs.astype(np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        force = MAX_FORCE * np.clip(act[:, 0].astype(np.float32).astype(np.float64), -1, 1)
        states = np.stack(advance(self._states[places].T, force), axis=1)
        self._states[places] = states
        failed: NDArray[np.bool_] = fails(states[:, 0], states[:, 2])
        rewards = np.where(failed, 0.0, pay(states[:, 2], force))
        return states.astype(np.float32).astype(np.float64), rewards, failed

    def why_ended(self, place: int) -> str:
        return failure(float(self._states[place, 0]))


def phi(obs: Array, act: Array) -> Array:
    """(B, 5): how centred each observation is, 1 - (value / limit)^2 clipped to [-1, 1], and a constant."""
    centred = 1 - (obs / np.array([MAX_X, 3.0, MAX_ANGLE, 3.5])) ** 2
    return np.concatenate([np.clip(centred, -1, 1), np.ones((len(obs), 1))], axis=1)


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """The track, the cart as a box and the pole as a line."""
    inner = env.unwrapped
    assert isinstance(inner, CartPole)
    return draw_cart_and_pole(inner.state[0], inner.state[2], MAX_X, pole_length=2 * HALF_LENGTH)


def draw_cart_and_pole(x: float, angle: float, track: float, pole_length: float) -> dict[str, Shape]:
    """Side view of a cart at x [m] on a track from -track to track [m], its pole at angle [rad] from
    upright, clockwise."""
    box = np.array([[x - 0.2, -0.1], [x + 0.2, -0.1], [x + 0.2, 0.1], [x - 0.2, 0.1], [x - 0.2, -0.1]])
    tip = [x + pole_length * math.sin(angle), pole_length * math.cos(angle)]
    return {
        "track": Shape(np.array([[-track, -0.1], [track, -0.1]]), (140, 140, 140)),
        "cart": Shape(box, (66, 133, 244)),
        "pole": Shape(np.array([[x, 0.0], tip]), (234, 134, 51)),
    }


def why_ended(env: gym.Env[Any, Any]) -> str:
    """'cart left the track' or 'pole fell'."""
    inner = env.unwrapped
    assert isinstance(inner, CartPole)
    return failure(inner.state[0])


def failure(x: float) -> str:
    """What ended an episode with the cart at x [m]."""
    return "cart left the track" if abs(x) > MAX_X else "pole fell"


SPEC = EnvSpec(
    name="cartpole",
    summary="continuous cart-pole: keep the pole upright for 500 steps (RLLab's reward)",
    env_id="irl_bench/CartPole-v0",
    obs_size=4,
    act_size=1,
    obs_scale=(1.0, 0.5, 0.05, 0.5),
    horizon=HORIZON,
    gamma=0.99,
    time_step=TIME_STEP,
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
)

gym.register(
    SPEC.env_id, entry_point="envs.cartpole:CartPole", max_episode_steps=HORIZON, disable_env_checker=True
)
