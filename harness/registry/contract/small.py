"""Two tasks so small that a method fits in seconds: one that is learned, and one whose model is known."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs import EnvSpec
from envs.gridworld import SPEC, objectworld
from envs.learners import DDPG
from methods.base import Array, Episodes

HORIZON = 10
ENV_ID = "irl_bench_contract/Noise-v0"


class Noise(gym.Env[Any, Any]):
    """An environment without dynamics: observations (3,) are uniform noise, and actions (2,) do nothing."""

    observation_space, action_space = spaces.Box(-1, 1, (3,)), spaces.Box(-1, 1, (2,))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        return self._seen(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        return self._seen(), 0.0, False, False, {}

    def _seen(self) -> Array:
        return self.np_random.uniform(-1, 1, 3).astype(np.float32)


def noise() -> EnvSpec:
    """Return a task whose model is not known, with a learner that takes little time."""
    if ENV_ID not in gym.registry:
        gym.register(
            ENV_ID, entry_point=f"{__name__}:Noise", max_episode_steps=HORIZON, disable_env_checker=True
        )
    learner = DDPG(net=(64, 64), batch=16, gradient_steps=1)
    return EnvSpec(
        "noise",
        ENV_ID,
        obs_size=3,
        act_size=2,
        obs_scale=(1.0,) * 3,
        horizon=HORIZON,
        gamma=0.9,
        rl=learner,
        phi=lambda obs, act: np.concatenate([act, np.ones((len(act), 1))], axis=1),
    )


def chosen(obs: Array) -> Array:
    """Return the actions (B, 2) of the policy that is demonstrated in `noise`."""
    return np.clip(obs[:, :2], -0.9, 0.9)


def shown(steps: int) -> Episodes:
    """Return demonstrations of `chosen`. They terminate where they have fewer steps than the horizon.
    Each is preferred to the one before."""
    rng = np.random.default_rng(0)
    obs = tuple(rng.uniform(-1, 1, (steps + 1, 3)) for _ in range(4))
    act, preferences = tuple(chosen(seen[:-1]) for seen in obs), np.array([[0, 1], [1, 2], [2, 3]])
    return Episodes(obs, act, (steps < HORIZON,) * 4, preferences=preferences)


def known() -> EnvSpec:
    """Return a task of 4 by 4 states and 5 choices whose model is known."""
    tabular = objectworld(4, 3, 2, 0.3, np.random.default_rng(0))
    return dataclasses.replace(
        SPEC,
        name="objectworld_4",
        kwargs={"tabular": tabular, "max_episode_steps": HORIZON},
        tabular=tabular,
        horizon=HORIZON,
        gamma=0.9,
        phi=lambda obs, act: tabular.features[tabular.states(obs)],
    )
