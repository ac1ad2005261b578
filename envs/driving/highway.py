"""Highway driving (highway-env, Leurent 2018) with steering and acceleration.

The scene, the drivers and the reward are highway-env's own. What is chosen here is its configuration:
an action every 0.4 s, an observation of the ego and of the gaps in its lane and the next ones, and a
reward of speed only, with crashing and leaving the road worth less than anything else.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from highway_env.utils import lmap
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from envs.driving.batch import Road, Scenes
from envs.driving.fast import FastHighwayEnv, speed_up_vehicle
from envs.learners import DDPG
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 75  # 30 s
TIME_STEP = 0.4  # s
LANES, LANE_WIDTH = 3, 4.0  # m
REACH = 60.0  # m, how far the ego sees
CORRIDOR = 2.5  # m, half the width of what counts as a lane; two vehicles touch at 2 m
ELBOW_ROOM = 2.0  # m, ahead and behind, within which a vehicle is beside
SIDE_REACH = 8.0  # m, how far the ego sees to its sides
CRUISE = 25.0  # m/s, the speed that is observed as 0
TARGET_SPEED = 30.0  # m/s, of the reference driver
OBS_SIZE = 18
MARGIN = 20.0  # m, of drawn road before the last and after the first vehicle
LONG, FAST, WIDE, DRIFT = 20.0, 5.0, 4.0, 1.0  # m, m/s, m, m/s: what an observation of 1 means
OBS_NAMES = (
    Quantity("offset from the middle of the road", f"{WIDE:g} m"),
    Quantity("offset from the middle of the lane", "m"),
    Quantity("lateral speed", f"{DRIFT:g} m/s"),
    Quantity(f"forward speed less {CRUISE:g} m/s", f"{FAST:g} m/s"),
    *(Quantity(f"free to the {side}", f"{WIDE:g} m") for side in ("left", "right")),
    *(
        quantity
        for lane in ("left", "own", "right")
        for where in ("ahead", "behind")
        for quantity in (
            Quantity(f"gap {where} in the {lane} lane", f"{LONG:g} m"),
            Quantity(f"relative speed {where} in the {lane} lane", f"{FAST:g} m/s"),
        )
    ),
)
CONFIG: dict[str, Any] = {
    # Not looked at, so as cheap as can be: the fast observation wants two vehicles and a range.
    "observation": {
        "type": "Kinematics",
        "vehicles_count": 2,
        "features": ["presence"],
        "features_range": {"presence": [0, 1]},
        "normalize": False,
    },
    "action": {
        "type": "ContinuousAction",
        "acceleration_range": [-8.0, 8.0],
        # One degree turns 25 m/s at 2.2 m/s^2: a brisk lane change, not an emergency.
        "steering_range": [-math.pi / 180, math.pi / 180],
        "speed_range": [10.0, 25.0],  # stopping is no option
    },
    "lanes_count": LANES,
    "vehicles_count": 12,
    "vehicles_density": 1.0,
    "simulation_frequency": 5,
    "policy_frequency": 1 / TIME_STEP,
    # highway-env sums up time in floats; Gymnasium's time limit counts steps.
    "duration": 10 * HORIZON,
    "offroad_terminal": True,
    "normalize_reward": False,
    "high_speed_reward": 1.0,
    "reward_speed_range": [10.0, 25.0],
    "right_lane_reward": 0.0,
    "collision_reward": -25.0,
}


class Highway(FastHighwayEnv):
    """Observation (18,): of the ego the offset from the road's middle and from its lane's (4 m, 1 m),
    lateral speed (1 m/s), forward speed less 25 m/s (5 m/s), and the distance to the left and to the right
    (4 m, up to 8 m) of the road's edge or of a vehicle that is beside the ego or would be in a second;
    then for the left, its own and the right lane, each centred on the ego, the free gap ahead, the relative
    speed of who is there, the free gap behind, the relative speed of who is there (20 m, up to 60 m;
    5 m/s). Zeros for a lane that is not there.

    Action (2,) in [-1, 1]: acceleration and steering. Terminates on a crash or off the road.
    Reward: forward speed from 10 to 25 m/s mapped to [0, 1], less 25 on crashing, 0 off the road.
    """

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        bound = np.full(OBS_SIZE, 50.0, np.float32)
        self.fixed_spaces = spaces.Box(-bound, bound), spaces.Box(-1.0, 1.0, (2,), np.float32)
        super().__init__({**CONFIG, **(config or {})})

    def define_spaces(self) -> None:
        super().define_spaces()
        # highway-env makes new spaces, with new generators, at every reset.
        self.observation_space, self.action_space = self.fixed_spaces

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self._observe(), {}

    def step(
        self, action: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        _, reward, terminated, truncated, info = super().step(action)
        return self._observe(), float(reward), bool(terminated), truncated, {"crashed": bool(info["crashed"])}

    def _observe(self) -> NDArray[np.float32]:
        cars = [self.vehicle, *(v for v in self.road.vehicles if v is not self.vehicle)]
        values = np.array([(*v.position, v.heading, v.speed) for v in cars])
        seen: NDArray[np.float32] = observe(*values.T[:, None])[0]
        return seen


def observe(x: Array, y: Array, heading: Array, speed: Array) -> NDArray[np.float32]:
    """(B, 18): what the egos see, which come first in B scenes of vehicles, each array (B, N)."""
    ahead = speed * np.cos(heading)
    drift = speed[:, 0] * np.sin(heading[:, 0])
    here = y[:, :1]
    dx, dy, dv = x[:, 1:] - x[:, :1], y[:, 1:] - here, ahead[:, 1:] - ahead[:, :1]
    gap = np.maximum(np.abs(dx) - Vehicle.LENGTH, 0.0)
    near = np.abs(dx) < REACH + Vehicle.LENGTH
    closing = np.maximum(np.where(dx > 0, -dv, dv), 0.0)  # m in a second
    beside = near & (np.abs(dx) < Vehicle.LENGTH + ELBOW_ROOM + closing)
    left, right = here[:, 0] + LANE_WIDTH / 2, (LANES - 0.5) * LANE_WIDTH - here[:, 0]
    left = np.minimum(left, np.where(beside & (dy <= 0), -dy, np.inf).min(axis=1))
    right = np.minimum(right, np.where(beside & (dy > 0), dy, np.inf).min(axis=1))
    lane = LANE_WIDTH * np.clip(np.round(here[:, 0] / LANE_WIDTH), 0, LANES - 1)
    seen = [
        (here[:, 0] - (LANES - 1) / 2 * LANE_WIDTH) / WIDE,
        here[:, 0] - lane,
        drift / DRIFT,
        (ahead[:, 0] - CRUISE) / FAST,
        np.minimum(left, SIDE_REACH) / WIDE,
        np.minimum(right, SIDE_REACH) / WIDE,
    ]
    for side in (-LANE_WIDTH, 0.0, LANE_WIDTH):
        middle = here[:, 0] + side
        there = (middle > -LANE_WIDTH / 2) & (middle < (LANES - 0.5) * LANE_WIDTH)
        on_it = near & (np.abs(dy - side) < CORRIDOR)
        for in_front in (dx > 0, dx < 0):
            among = on_it & (in_front | (gap == 0))  # who is beside is in front and behind
            distance = np.minimum(np.where(among, gap, np.inf).min(axis=1), REACH)
            nearest = np.where(among & (gap == distance[:, None]), dv, np.inf).min(axis=1)
            change = np.where(distance < REACH, nearest, np.minimum(nearest, 0.0))
            seen += [np.where(there, distance / LONG, 0.0), np.where(there, change / FAST, 0.0)]
    return np.stack(seen, axis=1).astype(np.float32)


class HighwayBatch:
    """Scenes of the task in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, config: dict[str, Any] | None = None) -> None:
        self._env = Highway(config)
        # The same seeds come again: every checkpoint is checked on the same episodes.
        self._first = functools.lru_cache(maxsize=1000)(self._build)
        self._scenes = self._first(0)[np.zeros(count, np.int64)]
        self._road = Road.of(self._env.road, self._env.config["action"]["speed_range"])

    def _build(self, seed: int) -> Scenes:
        self._env.reset(seed=seed)
        return Scenes.of(self._env.road)

    def reset(self, place: int, seed: int) -> Array:
        first = self._first(seed)
        self._scenes[np.array([place])] = first
        return np.asarray(_seen(first)[0], np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        config, rows = self._env.config, np.array(places)
        scenes = self._scenes[rows]
        # In 32 bits, like the actions that highway-env is given.
        push, turn = np.clip(act.astype(np.float32), -1, 1).T
        scenes.acceleration[:, 0] = lmap(push, [-1, 1], config["action"]["acceleration_range"])
        scenes.steering[:, 0] = lmap(turn, [-1, 1], config["action"]["steering_range"])
        for _ in range(round(config["simulation_frequency"] * TIME_STEP)):
            scenes.step(self._road, 1 / config["simulation_frequency"])
        self._scenes[rows] = scenes
        crashed = scenes.crashed[:, 0]
        speed = scenes.speed[:, 0] * np.cos(scenes.heading[:, 0])
        fast: Array = np.clip(lmap(speed, config["reward_speed_range"], [0, 1]), 0, 1)
        on_road = scenes.on_road(self._road)[:, 0]
        rewards = (config["collision_reward"] * crashed + fast) * on_road
        return np.asarray(_seen(scenes), np.float64), rewards, crashed | ~on_road

    def why_ended(self, place: int) -> str:
        return _why(bool(self._scenes.crashed[place, 0]))


def _seen(scenes: Scenes) -> NDArray[np.float32]:
    return observe(scenes.x, scenes.y, scenes.heading, scenes.speed)


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
    """(B, 8) in [-1, 1], larger mostly better: forward speed, lane centring, little drift, distance to the
    road's edge, free gap ahead and behind in the own lane, opening speed to whoever is ahead, a constant."""
    edge = LANES / 2 * LANE_WIDTH - np.abs(obs[:, 0]) * WIDE
    features = [
        obs[:, 3] * FAST / 10,
        1 - np.abs(obs[:, 1]),
        1 - np.abs(obs[:, 2]) * DRIFT,
        edge / LANE_WIDTH - 0.5,
        obs[:, 10] * LONG / 20 - 1,
        obs[:, 12] * LONG / 20 - 1,
        obs[:, 11],
        np.ones(len(obs)),
    ]
    clipped: Array = np.clip(np.stack(features, axis=1), -1, 1)
    return clipped


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """The road from above, the ego at x = 0 driving to the right: edges, dashes between lanes, and vehicles
    as rectangles, each with an arrow as long as its way until the next action."""
    scene = env.unwrapped
    assert isinstance(scene, Highway)
    ego = scene.vehicle
    shapes = {}
    along = [vehicle.position[0] - ego.position[0] for vehicle in scene.road.vehicles]
    start, end = min(*along, -2 * MARGIN) - MARGIN, max(along) + 4 * MARGIN
    for i in range(LANES + 1):
        side = (0.5 - i) * LANE_WIDTH  # highway-env's y points to the right of the road, ours to the left
        if i in (0, LANES):
            shapes[f"lane_{i}"] = Shape(np.array([[start, side], [end, side]]), (140, 140, 140))
            continue
        for dash in range(24):  # which move as the ego passes them
            x = 8.0 * (dash - 8) - ego.position[0] % 8.0
            shapes[f"dash_{i}_{dash:02d}"] = Shape(np.array([[x, side], [x + 3.0, side]]), (190, 190, 190))
    others = [vehicle for vehicle in scene.road.vehicles if vehicle is not ego]
    names = [f"vehicle_{i:02d}" for i in range(1, len(others) + 1)]
    for name, vehicle in [*zip(names, others, strict=True), ("ego", ego)]:
        outline = (vehicle.polygon() - [ego.position[0], 0.0]) * [1.0, -1.0]
        colour = (234, 134, 51) if vehicle is ego else (66, 133, 244)
        shapes[name] = Shape(outline, colour)
        ahead = np.array([math.cos(vehicle.heading), -math.sin(vehicle.heading)])
        nose = (vehicle.position - [ego.position[0], 0.0]) * [1.0, -1.0] + vehicle.LENGTH / 2 * ahead
        tip, across = nose + vehicle.speed * TIME_STEP * ahead, 0.5 * np.array([-ahead[1], ahead[0]])
        head = [tip - ahead + across, tip, tip - ahead - across]
        shapes[f"{name}_speed"] = Shape(np.array([nose, tip, *head]), colour)
    return shapes


def why_ended(env: gym.Env[Any, Any]) -> str:
    """'crashed' or 'left the road'."""
    scene = env.unwrapped
    assert isinstance(scene, Highway)
    return _why(scene.vehicle.crashed)


def _why(crashed: bool) -> str:
    return "crashed" if crashed else "left the road"


SPEC = EnvSpec(
    name="highway",
    summary="highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
    env_id="irl_bench/Highway-v0",
    obs_size=OBS_SIZE,
    act_size=2,
    obs_names=OBS_NAMES,
    act_names=(Quantity("acceleration", "8 m/s^2"), Quantity("steering", "deg")),
    obs_scale=(1.0,) * OBS_SIZE,
    horizon=HORIZON,
    gamma=0.95,
    time_step=TIME_STEP,
    bar=lambda seeds: float(idm_return(seeds)[0].mean()),
    max_terminated={"smoke": 1.0, "quick": 0.05, "full": 0.02},
    rl_steps={"smoke": 600, "quick": 40_000, "full": 60_000},
    eval_episodes={"smoke": 5, "quick": 50, "full": 100},
    demo_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=120_000, bar=67.0, terminated=0.01, checkpoint_every=1000),
    rl=DDPG(
        final_learning_rate=5e-5,
        tau=0.005,
        batch=256,
        critics=2,
        noise=0.15,
        copies=40,
        gradient_steps=20,
        checkpoint_every=4000,
        check_episodes=40,
    ),
    batch=HighwayBatch,
    # Half as many again on the same stretch of road.
    variants={"dense": {"config": {"vehicles_density": 1.5, "vehicles_count": 18}}},
)
"""Each step pays the forward speed, 0 at 10 m/s and 1 at 25 m/s; a crash costs 25, and off the road a step
pays 0. Either ends the episode. The reference driver is highway-env's IDM with MOBIL's lane changes at a
target speed of 30 m/s: its return on the same episodes is what an expert must reach."""

gym.register(
    SPEC.env_id,
    entry_point="envs.driving.highway:Highway",
    max_episode_steps=HORIZON,
    disable_env_checker=True,
)
