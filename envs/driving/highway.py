"""Highway driving: three lanes, an ego that steers and accelerates, and highway-env's traffic.

The physics and the traffic, IDM drivers who change lanes, are highway-env's, compiled by JAX for many scenes
at once (`envs.driving.traffic`). The configuration is `CONFIG`. Actions come every 0.4 s. The ego observes
itself and the gaps in its lane and the next ones. Speed is rewarded. A crash or leaving the road pays less
than any other step.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs.driving import scene as road
from envs.driving.environment import NOMINAL, OBS_SIZE, VEHICLES, HighwayBatch, Traffic, drive, first_states
from envs.driving.scene import Scene
from envs.dynamics import why_ended
from envs.learners import DDPG, SMALL_PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures.", "CONFIG": "Tests compare with it."}

HORIZON = 75  # 30 s
TIME_STEP = road.DT * road.FRAMES  # s
TARGET_SPEED, IDM_DELTA = 30.0, 4.0  # m/s, and the exponent of the reference driver
MARGIN = 20.0  # m, of drawn road before the last and after the first vehicle
OBS_NAMES = (
    Quantity("offset from the middle of the road", f"{road.WIDE:g} m"),
    Quantity("offset from the middle of the lane", "m"),
    Quantity("lateral speed", f"{road.DRIFT:g} m/s"),
    Quantity(f"forward speed less {road.CRUISE:g} m/s", f"{road.FAST:g} m/s"),
    *(Quantity(f"free to the {side}", f"{road.WIDE:g} m") for side in ("left", "right")),
    *(
        quantity
        for lane in ("left", "own", "right")
        for where in ("ahead", "behind")
        for quantity in (
            Quantity(f"gap {where} in the {lane} lane", f"{road.LONG:g} m"),
            Quantity(f"relative speed {where} in the {lane} lane", f"{road.FAST:g} m/s"),
        )
    ),
)
CONFIG: dict[str, Any] = {
    "observation": {"type": "Kinematics"},  # not used
    "action": {
        "type": "ContinuousAction",
        "acceleration_range": [-road.PEDAL, road.PEDAL],
        "steering_range": [-road.WHEEL, road.WHEEL],
        "speed_range": [*road.EGO_SPEEDS],
    },
    "lanes_count": road.LANES,
    "vehicles_count": VEHICLES,
    "vehicles_density": 1.0,
    "ego_spacing": road.EGO_SPACING,
    "simulation_frequency": 1 / road.DT,
    "policy_frequency": 1 / TIME_STEP,
    # highway-env sums up time in floats; Gymnasium's time limit counts steps.
    "duration": 10 * HORIZON,
    "offroad_terminal": True,
    "normalize_reward": False,
    "high_speed_reward": 1.0,
    "reward_speed_range": [*road.EGO_SPEEDS],
    "right_lane_reward": 0.0,
    "collision_reward": road.CRASH,
}
"""Configuration of the same task in highway-env (`HighwayEnvFast`)."""


def idm_return(seeds: Sequence[int]) -> tuple[Array, NDArray[np.bool_]]:
    """Return undiscounted true returns (R,) and flags of crashes (R,) of highway-env's own driver in the
    ego's place: IDM and MOBIL, target speed 30 m/s. It is the reference that an expert must reach."""
    states = first_states(seeds)
    scene = Scene(*(states[:, i] for i in range(len(Scene._fields))))
    scene.target_speed[:, 0], scene.delta[:, 0] = TARGET_SPEED, IDM_DELTA
    scene.timer[:, 0] = (scene.x[:, 0] + scene.y[:, 0]) * math.pi % 1
    scene.target[:, 0] = scene.lane[:, 0]
    returns, driving = np.zeros(len(states)), np.arange(len(states))
    for _ in range(HORIZON):
        _, rewards, ended = drive(states, driving, np.zeros((len(driving), 2)))
        returns[driving] += rewards
        driving = driving[~ended]
        if not len(driving):
            break
    return returns, scene.crashed[:, 0] > 0


def phi(obs: Array, act: Array) -> Array:
    """Return features (B, 8) in [-1, 1], larger mostly better. They are forward speed, lane centring, little
    drift, distance to the road's edge, free gaps ahead and behind, opening speed ahead, and 1."""
    edge = road.LANES / 2 * road.LANE_WIDTH - np.abs(obs[:, 0]) * road.WIDE
    features = [
        obs[:, 3] * road.FAST / 10,
        1 - np.abs(obs[:, 1]),
        1 - np.abs(obs[:, 2]) * road.DRIFT,
        edge / road.LANE_WIDTH - 0.5,
        obs[:, 10] * road.LONG / 20 - 1,
        obs[:, 12] * road.LONG / 20 - 1,
        obs[:, 11],
        np.ones(len(obs)),
    ]
    clipped: Array = np.clip(np.stack(features, axis=1), -1, 1)
    return clipped


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the road from above, with the ego at x = 0 driving to the right. It has edges, dashes between
    lanes, and vehicles as rectangles, each with an arrow as long as its way until the next action."""
    inner: Any = env.unwrapped
    scene = inner.scene
    shapes = {}
    here = float(scene.x[0])
    along = scene.x - here
    start, end = min(along.min(), -2 * MARGIN) - MARGIN, along.max() + 4 * MARGIN
    for i in range(road.LANES + 1):
        side = (0.5 - i) * road.LANE_WIDTH  # y of highway-env points to the right, that of drawings left
        if i in (0, road.LANES):
            shapes[f"lane_{i}"] = Shape(np.array([[start, side], [end, side]]), (140, 140, 140))
            continue
        for dash in range(24):  # dashes move as the ego passes them
            x = 8.0 * (dash - 8) - here % 8.0
            shapes[f"dash_{i}_{dash:02d}"] = Shape(np.array([[x, side], [x + 3.0, side]]), (190, 190, 190))
    for i in (*range(1, len(scene.x)), 0):
        name, colour = (f"vehicle_{i:02d}", (66, 133, 244)) if i else ("ego", (234, 134, 51))
        ahead = np.array([scene.cos[i], -scene.sin[i]])
        left, middle = np.array([-ahead[1], ahead[0]]), np.array([along[i], -scene.y[i]])
        corners = [(-1, 1), (-1, -1), (1, -1), (1, 1), (-1, 1)]
        sides = [middle + a * road.LENGTH / 2 * ahead + b * road.WIDTH / 2 * left for a, b in corners]
        shapes[name] = Shape(np.array(sides), colour)
        nose = middle + road.LENGTH / 2 * ahead
        tip, across = nose + scene.speed[i] * TIME_STEP * ahead, 0.5 * left
        head = [tip - ahead + across, tip, tip - ahead - across]
        shapes[f"{name}_speed"] = Shape(np.array([nose, tip, *head]), colour)
    return shapes


THESIS = DDPG(
    final_learning_rate=5e-5,
    tau=0.005,
    batch=256,
    critics=2,
    noise=0.15,
    copies=40,
    gradient_steps=20,
    checkpoint_every=4000,
    check_episodes=40,
)
"""Learner of the thesis."""

SPEC = EnvSpec(
    name="highway",
    summary="highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
    env_id="irl_bench_bare/Highway-v0",
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
    rl_steps={"smoke": 8192, "quick": 122_880, "full": 245_760},
    solves={"smoke": 1, "quick": 1, "full": 5},
    ddpg_steps={"smoke": 600, "quick": 40_000, "full": 60_000},
    eval_episodes={"smoke": 5, "quick": 50, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=120_000, bar=67.0, terminated=0.01, checkpoint_every=1000, rl=THESIS),
    rl=replace(SMALL_PPO, copies=64, steps=32, batch=512, epochs=8, std=0.6, checkpoint_every=20_480),
    ddpg=THESIS,
    kwargs={"physics": NOMINAL},
    batch=partial(HighwayBatch, physics=NOMINAL),
    # 1.5 times as many vehicles on the same stretch of road.
    variants={"dense": {"physics": Traffic(vehicles=18, density=1.5)}},
)
"""Each step pays the forward speed, 0 at 10 m/s and 1 at 25 m/s. A crash costs 25, and off the road a step
pays 0. Either ends the episode. The reference driver is highway-env's IDM with MOBIL's lane changes at a
target speed of 30 m/s. An expert must reach its return on the same episodes."""

register(SPEC, "envs.driving.environment:Highway")
