"""Highway driving (highway-env, Leurent 2018) with steering and acceleration.

The scene, the drivers and the reward are highway-env's own. What is chosen here is its configuration:
five decisions a second, an observation of the ego and the five vehicles nearest along the road, and a
reward of speed only, with crashing and leaving the road worth less than anything else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from envs.highway_fast import FastHighwayEnv, speed_up_vehicle
from envs.spec import Array, EnvSpec, Shape

HORIZON = 150  # 30 s
LANES, LANE_WIDTH = 3, 4.0  # m
SEEN = 6  # the ego and five others
FEATURES = ("presence", "x", "y", "vx", "vy")
RANGES = {"x": 60.0, "y": 12.0, "vx": 30.0, "vy": 6.0}  # m and m/s: each is divided by this, then clipped
MAX_SPEED = 30.0  # m/s
CONFIG = {
    "observation": {
        "type": "Kinematics",
        "vehicles_count": SEEN,
        "features": list(FEATURES),
        "features_range": {name: [-limit, limit] for name, limit in RANGES.items()},
    },
    "action": {
        "type": "ContinuousAction",
        "acceleration_range": [-5.0, 5.0],
        "steering_range": [-math.pi / 60, math.pi / 60],
        "speed_range": [10.0, MAX_SPEED],
    },
    "lanes_count": LANES,
    "vehicles_count": 15,
    "vehicles_density": 1.5,
    "simulation_frequency": 5,
    "policy_frequency": 5,
    # highway-env sums up time in floats; Gymnasium's time limit counts steps.
    "duration": 10 * HORIZON,
    "offroad_terminal": True,
    "normalize_reward": False,
    "high_speed_reward": 1.0,
    "reward_speed_range": [10.0, MAX_SPEED],
    "right_lane_reward": 0.0,
    "collision_reward": -5.0,
}


class Highway(gym.Wrapper[NDArray[np.float32], NDArray[np.float32], Any, Any]):
    """Observation (30,) in [-1, 1]: presence, x, y, vx, vy of the ego and of the five vehicles nearest
    along the road, from 10 m behind; the ego's x is constant, the others are relative to the ego.

    Action (2,) in [-1, 1]: acceleration and steering. Terminates on a crash or off the road.
    Reward: forward speed from 10 to 30 m/s mapped to [0, 1], less 5 on crashing, 0 off the road.
    """

    def __init__(self) -> None:
        super().__init__(FastHighwayEnv(CONFIG))
        # highway-env makes new spaces, with new generators, at every reset.
        self.observation_space = spaces.Box(-1.0, 1.0, (SEEN * len(FEATURES),), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        obs, _ = self.env.reset(seed=seed, options=options)
        return obs.ravel(), {}

    def step(
        self, action: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        obs, reward, terminated, truncated, info = self.env.step(action)
        return obs.ravel(), float(reward), bool(terminated), truncated, {"crashed": bool(info["crashed"])}
