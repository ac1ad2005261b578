"""Drive a car along a hilly road that is another one in each episode.

MuJoCo moves the car: a chassis on four wheels with springs, four motors and brakes, and front wheels that
steer. The road is a closed loop over a height field, 8 m wide. Both are drawn from the episode's seed. A
step lasts 0.1 s.
"""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from envs.hills.car import FRAME, FRAMES, LENGTH, STEER, WIDTH, Physics
from envs.hills.environment import AHEAD, FAR, DriveBatch, rotated, why_ended
from envs.learners import SMALL_PPO
from envs.spec import EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

OBS_NAMES = (
    Quantity("forward speed", "m/s"),
    Quantity("leftward speed", "m/s"),
    Quantity("yaw rate", "rad/s"),
    Quantity("sine of the pitch upwards"),
    Quantity("sine of the roll to the right"),
    Quantity("angle of the front wheels", "rad"),
    Quantity("offset to the left of the road's centre", "m"),
    Quantity("heading to the left of the road's", "rad"),
    *(Quantity(f"road {ahead:g} m ahead, to the left", "m") for ahead in AHEAD),
    *(Quantity(f"road {ahead:g} m ahead, upwards", "m") for ahead in FAR),
)


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return a view from above, with the road's edges and the car, whose nose is a wedge."""
    inner: Any = env.unwrapped
    edges = inner.edges()[..., :2]
    (ahead,), (aside,), _ = rotated(inner.data.qpos[None, 3:7])
    corners = [(-1, 1), (-1, -1), (0.5, -1), (1, 0), (0.5, 1), (-1, 1)]
    sides = [a * LENGTH / 2 * ahead[:2] + b * WIDTH / 2 * aside[:2] for a, b in corners]
    return {
        "left_edge": Shape(edges[0], (140, 140, 140)),
        "right_edge": Shape(edges[1], (140, 140, 140)),
        "car": Shape(inner.data.qpos[:2] + np.array(sides), (234, 134, 51)),
    }


SPEC = EnvSpec(
    name="drive_state",
    summary="MuJoCo: drive a car along a new hilly road in each episode, 20 s",
    env_id="irl_bench_bare/DriveState-v0",
    obs_size=len(OBS_NAMES),
    act_size=2,
    obs_names=OBS_NAMES,
    act_names=(Quantity("steering to the left", f"{STEER:g} rad"), Quantity("throttle, or brake below 0")),
    obs_scale=(10.0, 1.0, 0.5, 0.2, 0.2, 0.3, 2.0, 0.3, 2.0, 4.0, 6.0, 8.0, 12.0, 1.0, 2.0),
    horizon=200,
    gamma=0.98,
    time_step=FRAME * FRAMES,
    max_terminated={"smoke": 1.0, "quick": 0.5, "full": 0.1},
    rl_steps={"smoke": 8192, "quick": 122_880, "full": 245_760},
    solves={"smoke": 1, "quick": 1, "full": 2},
    eval_episodes={"smoke": 5, "quick": 50, "full": 100},
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=491_520, bar=185.0, terminated=0.05, experts=1, episodes=1000),
    rl=replace(SMALL_PPO, copies=64, batch=512, std=0.5, checkpoint_every=20_480),
    batch=DriveBatch,
    variants={
        "weak_tyres": {"physics": Physics(tyres=0.6)},
        "heavy": {"physics": Physics(mass=2000.0)},
        "steering_flipped": {"physics": Physics(steering=-1.0)},
    },
)
"""Demonstrations and evaluations have other roads. An episode starts beside the road's centre, askew, and at
any speed up to 8 m/s. A step pays the progress along the road's centre line [m], up to 1 m: nothing pays
above 10 m/s. An episode ends where the car's centre is off the road, or the car upside down."""

register(SPEC, "envs.hills.environment:Drive")
