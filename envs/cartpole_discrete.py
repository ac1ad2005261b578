"""Gymnasium's own `CartPole-v1` (Barto, Sutton & Anderson 1983): push the cart left or right."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from envs import cartpole
from envs.learners import DQN
from envs.spec import EnvSpec, Shape, Shipped


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """As in the continuous cart-pole."""
    x, _, angle, _ = _state(env)
    return cartpole.draw_cart_and_pole(x, angle, cartpole.MAX_X, 2 * cartpole.HALF_LENGTH)


def why_ended(env: gym.Env[Any, Any]) -> str:
    """'cart left the track' or 'pole fell'."""
    return cartpole.failure(_state(env)[0])


def _state(env: gym.Env[Any, Any]) -> list[float]:
    """Position [m] and velocity [m/s] of the cart, angle [rad] of the pole and its rate [rad/s]."""
    inner = env.unwrapped
    assert isinstance(inner, CartPoleEnv)
    assert inner.state is not None
    return [float(value) for value in inner.state]


SPEC = EnvSpec(
    name="cartpole_discrete",
    summary="Gymnasium's CartPole-v1, two actions: keep the pole upright for 500 steps",
    env_id="CartPole-v1",
    obs_size=4,
    act_size=2,
    obs_scale=(1.0, 0.5, 0.05, 0.5),
    horizon=cartpole.HORIZON,
    gamma=0.99,
    time_step=cartpole.TIME_STEP,
    bar=lambda seeds: 495.0,
    max_terminated={"smoke": 1.0, "quick": 1.0, "full": 1.0},
    rl_steps={"smoke": 600, "quick": 10_000, "full": 30_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    demo_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=cartpole.phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=60_000, bar=500.0),
    discrete=True,
    rl=DQN(),
)
