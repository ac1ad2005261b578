"""Highway driving (highway-env, Leurent 2018) with steering and acceleration.

The scene, the drivers and the reward are highway-env's own. What is chosen here is its configuration:
an action every 0.4 s, an observation of the ego and the five vehicles nearest along the road, and a
reward of speed only, with crashing and leaving the road worth less than anything else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from envs.highway_fast import FastHighwayEnv, speed_up_vehicle
from envs.spec import Array, EnvSpec, Shape

HORIZON = 75  # 30 s
TIME_STEP = 0.4  # s
LANES, LANE_WIDTH = 3, 4.0  # m
SEEN = 6  # the ego and five others
FEATURES = ("presence", "x", "y", "vx", "vy")
RANGES = {"x": 60.0, "y": 12.0, "vx": 40.0, "vy": 10.0}  # m and m/s, beyond which values are clipped
UNITS = {"x": 20.0, "y": 4.0, "vx": 5.0, "vy": 2.0}  # m and m/s: what an observation of 1 means
EGO_CENTRE = {"y": 4.0, "vx": 20.0}  # m and m/s: what is subtracted from the ego's own values
TARGET_SPEED = 30.0  # m/s, of the reference driver
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
        # Half a degree turns 25 m/s at 1.1 m/s^2: a comfortable lane change, not an emergency.
        "steering_range": [-math.pi / 360, math.pi / 360],
        "speed_range": [10.0, 25.0],  # stopping is no option
    },
    "lanes_count": LANES,
    "vehicles_count": 15,
    "vehicles_density": 1.1,
    "simulation_frequency": 5,
    "policy_frequency": 1 / TIME_STEP,
    # highway-env sums up time in floats; Gymnasium's time limit counts steps.
    "duration": 10 * HORIZON,
    "offroad_terminal": True,
    "normalize_reward": False,
    "high_speed_reward": 1.0,
    "reward_speed_range": [5.0, 20.0],
    "right_lane_reward": 0.0,
    "collision_reward": -5.0,
}


_SCALE = np.array([1.0] + [RANGES[name] / UNITS[name] for name in FEATURES[1:]], np.float32)
_CENTRE = np.array([EGO_CENTRE.get(name, 0.0) / UNITS.get(name, 1.0) for name in FEATURES], np.float32)


def _flat(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """(28,) from highway-env's (6, 5): in our units, without the ego's presence and x, which are constant."""
    rows = rows * _SCALE
    rows[0] -= _CENTRE
    return rows.ravel()[2:]


class Highway(FastHighwayEnv):
    """Observation (28,): of the ego y, vx, vy, then of each of the five vehicles nearest along the road,
    from 10 m behind, presence, x, y, vx, vy relative to the ego, in `UNITS`, the ego's
    less `EGO_CENTRE`; absent vehicles are zeros.

    Action (2,) in [-1, 1]: acceleration and steering. Terminates on a crash or off the road.
    Reward: forward speed from 5 to 20 m/s mapped to [0, 1], less 5 on crashing, 0 off the road.
    """

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        ones = np.ones((SEEN, len(FEATURES)), np.float32)
        space = spaces.Box(_flat(-ones), _flat(ones), dtype=np.float32)
        self.fixed_spaces = space, spaces.Box(-1.0, 1.0, (2,), np.float32)
        super().__init__({**CONFIG, **(config or {})})

    def define_spaces(self) -> None:
        super().define_spaces()
        # highway-env makes new spaces, with new generators, at every reset.
        self.observation_space, self.action_space = self.fixed_spaces

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        obs, _ = super().reset(seed=seed, options=options)
        return _flat(obs), {}

    def step(
        self, action: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        obs, reward, terminated, truncated, info = super().step(action)
        return _flat(obs), float(reward), bool(terminated), truncated, {"crashed": bool(info["crashed"])}


def idm_return(seeds: Sequence[int]) -> tuple[Array, NDArray[np.bool_]]:
    """Undiscounted true returns and whether it crashed, for highway-env's own driver (IDM and MOBIL,
    target speed 30 m/s) in the ego's place: the reference that an expert must reach."""
    scene = Highway()
    returns, crashes = [], []
    for seed in seeds:
        scene.reset(seed=seed)
        ego = scene.vehicle
        driver = IDMVehicle(ego.road, ego.position, ego.heading, ego.speed, target_speed=TARGET_SPEED)
        scene.road.vehicles[scene.road.vehicles.index(ego)] = scene.vehicle = driver
        speed_up_vehicle(driver)
        total, ended, steps = 0.0, False, 0
        while not ended and steps < HORIZON:
            _, reward, ended, _, _ = scene.step(None)
            total, steps = total + reward, steps + 1
        returns.append(total)
        crashes.append(bool(driver.crashed))
    return np.array(returns), np.array(crashes)


def phi(obs: Array, act: Array) -> Array:
    """(B, 8) in [-1, 1], larger mostly better: forward speed, lane centring, straight heading, distance
    to the road's edge, gap ahead in the own lane, speed of whoever is there, distance to the nearest
    vehicle, and a constant."""
    others = obs[:, 3:].reshape(len(obs), SEEN - 1, len(FEATURES))
    present = others[:, :, 0] > 0.5
    x, y, vx = (others[:, :, i + 1] * UNITS[name] for i, name in enumerate(("x", "y", "vx")))
    side = obs[:, 0] * UNITS["y"] + EGO_CENTRE["y"]
    speed, drift = obs[:, 1] * UNITS["vx"] + EGO_CENTRE["vx"], obs[:, 2] * UNITS["vy"]
    off_centre = np.abs(side - LANE_WIDTH * np.clip(np.round(side / LANE_WIDTH), 0, LANES - 1))
    edge = np.minimum(side + LANE_WIDTH / 2, (LANES - 0.5) * LANE_WIDTH - side)
    in_front = present & (x > 0) & (np.abs(y) < LANE_WIDTH / 2)
    gaps = np.where(in_front, x, RANGES["x"])
    first = np.argmin(gaps, axis=1)[:, None]
    pull = np.take_along_axis(np.where(in_front, vx, 5.0), first, 1)[:, 0]
    apart = np.where(present, np.hypot(x / 10, y / 3), np.inf).min(axis=1)
    features = [
        (speed - 20) / 10,
        1 - off_centre,
        1 - np.abs(np.arctan2(drift, speed)) / 0.1,
        edge / LANE_WIDTH - 0.5,
        2 * gaps.min(axis=1) / RANGES["x"] - 1,
        pull / 5,
        apart - 1,
        np.ones(len(obs)),
    ]
    clipped: Array = np.clip(np.stack(features, axis=1), -1, 1)
    return clipped


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """The road from above, the ego at x = 0 driving to the right: lines, then vehicles as rectangles."""
    scene = env.unwrapped
    assert isinstance(scene, Highway)
    ego = scene.vehicle
    shapes = {}
    for i in range(LANES + 1):
        side = (0.5 - i) * LANE_WIDTH  # highway-env's y points to the right of the road, ours to the left
        grey = (140, 140, 140) if i in (0, LANES) else (200, 200, 200)
        shapes[f"lane_{i}"] = Shape(np.array([[-60.0, side], [120.0, side]]), grey)
    others = [vehicle for vehicle in scene.road.vehicles if vehicle is not ego]
    names = [f"vehicle_{i:02d}" for i in range(1, len(others) + 1)]
    for name, vehicle in [*zip(names, others, strict=True), ("ego", ego)]:
        outline = (vehicle.polygon() - [ego.position[0], 0.0]) * [1.0, -1.0]
        shapes[name] = Shape(outline, (234, 134, 51) if vehicle is ego else (66, 133, 244))
    return shapes


def why_ended(env: gym.Env[Any, Any]) -> str:
    """'crashed' or 'left the road'."""
    scene = env.unwrapped
    assert isinstance(scene, Highway)
    return "crashed" if scene.vehicle.crashed else "left the road"


SPEC = EnvSpec(
    name="highway",
    summary="highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
    env_id="irl_bench/Highway-v0",
    obs_size=SEEN * len(FEATURES) - 2,
    act_size=2,
    obs_scale=(1.0,) * (SEEN * len(FEATURES) - 2),
    horizon=HORIZON,
    gamma=0.95,
    time_step=TIME_STEP,
    bar=lambda seeds: float(idm_return(seeds)[0].mean()),
    max_terminated={"smoke": 1.0, "quick": 0.05, "full": 0.05},
    rl_steps={"smoke": 600, "quick": 20_000, "full": 40_000},
    eval_episodes={"smoke": 5, "quick": 50, "full": 100},
    demo_episodes={"smoke": 5, "quick": 50, "full": 50},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
)

gym.register(
    SPEC.env_id, entry_point="envs.highway:Highway", max_episode_steps=HORIZON, disable_env_checker=True
)
