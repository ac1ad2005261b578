"""MuJoCo's tasks of Gymnasium (`-v5`), one call of `task` each. They equal Gymnasium's, bit for bit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv

from envs.learners import DDPG, FEW_JOINTS, PPO, SAC, Learner
from envs.mujoco_batch import MujocoBatch
from envs.spec import EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

WEAK = 0.3  # strength of a weak motor, as a share of the usual
SIDE, TOP = [0, 2], [0, 1]  # axes of a drawing
COLOURS = ((66, 133, 244), (234, 134, 51), (52, 168, 83), (171, 71, 188))
GREY = (140, 140, 140)


@dataclass(frozen=True)
class Physics:
    """Factors of quantities in Gymnasium's model."""

    mass: float = 1.0
    """Mass and inertia of every body."""
    gravity: float = 1.0
    gear: float = 1.0
    """Strength of every motor. -1 flips them."""
    weak: tuple[str, ...] = ()
    """Joints whose motors have `WEAK` of their strength."""

    def change(self, env: MujocoEnv) -> None:
        """Change the environment's model."""
        model = env.model
        model.body_mass *= self.mass
        model.body_inertia *= self.mass
        model.opt.gravity *= self.gravity
        model.actuator_gear *= self.gear
        for joint in self.weak:
            model.actuator_gear[model.actuator_trnid[:, 0] == model.joint(joint).id] *= WEAK
        mujoco.mj_setConst(model, env.data)


NOMINAL = Physics()


def make(env_id: str, physics: Physics = NOMINAL) -> MujocoEnv:
    """Return Gymnasium's environment with these physics."""
    before = mujoco.get_mju_user_warning()
    # It warns about one of Gymnasium's models, and would write a log file into the current folder.
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        env = gym.make(env_id, disable_env_checker=True).unwrapped
    finally:
        mujoco.set_mju_user_warning(before)
    assert isinstance(env, MujocoEnv)
    if physics != NOMINAL:
        physics.change(env)
    return env


def draw(env: gym.Env[Any, Any], axes: list[int], moves: bool) -> dict[str, Shape]:
    """Return each geometry along these two axes: a capsule as the line of its axis, a ball as a circle.
    `moves`: the scene follows the first body, over a scale of metres."""
    inner: Any = env.unwrapped
    model, data = inner.model, inner.data
    origin = float(data.qpos[0]) if moves else 0.0
    shapes = {}
    for i in range(model.ngeom):
        geom = model.geom(i)
        radius, half = float(geom.size[0]), float(geom.size[1])
        centre, along = data.geom_xpos[i], data.geom_xmat[i].reshape(3, 3)[:, 2]
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            points = np.array([centre - half * along, centre + half * along])[:, axes]
        elif geom.type[0] == mujoco.mjtGeom.mjGEOM_SPHERE:
            turns = np.linspace(0, 2 * math.pi, 13)
            points = centre[axes] + radius * np.column_stack([np.cos(turns), np.sin(turns)])
        else:
            continue
        colour = COLOURS[geom.bodyid[0] % 4] if geom.bodyid[0] else GREY
        shapes[geom.name] = Shape(points - [origin, 0], colour)
    if moves:
        ticks = np.floor(origin) + np.arange(-3, 5) - origin
        comb = [[[x, 0.0], [x, -0.05], [x, 0.0]] for x in ticks]
        shapes["ground"] = Shape(np.concatenate(comb), GREY)
    return shapes


def slides(joint: Any) -> bool:
    """Return True if a joint slides, False if it turns."""
    return bool(joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE)


def joints_of(model: mujoco.MjModel, skipped: int) -> tuple[Quantity, ...]:
    """Return the names of joint positions, without the first `skipped` ones, and then of their rates."""
    joints = [model.joint(i) for i in range(model.njnt)]
    units = ["m" if slides(joint) else "rad" for joint in joints]
    places = [Quantity(joint.name, unit) for joint, unit in zip(joints, units, strict=True)]
    rates = [Quantity(f"{joint.name} rate", f"{u}/s") for joint, u in zip(joints, units, strict=True)]
    return (*places[skipped:], *rates)


def task(
    name: str,
    gymnasium_id: str,
    summary: str,
    *,
    obs_scale: tuple[float, ...],
    bar: float,
    shipped: Shipped,
    rl: Learner,
    rl_steps: Mapping[str, int],
    variants: Mapping[str, Physics],
    ends: str = "never",
    obs_names: tuple[Quantity, ...] = (),
    axes: list[int] = SIDE,
    moves: bool = False,
    gamma: float = 0.99,
    **fields: Any,
) -> EnvSpec:
    """Return the spec of one task. `ends`: why its episodes terminate. `obs_names`: by default the joints'
    positions without the first, and their rates. `fields`: more fields of `EnvSpec`."""
    env = make(gymnasium_id)
    model = env.model
    env_id = f"irl_bench_bare/{gymnasium_id}"
    horizon = gym.spec(gymnasium_id).max_episode_steps
    assert horizon is not None
    motors = [model.joint(int(joint)) for joint in model.actuator_trnid[:, 0]]

    def why_ended(env: gym.Env[Any, Any]) -> str:
        return ends

    spec = EnvSpec(
        name=name,
        summary=summary,
        env_id=env_id,
        obs_size=len(obs_scale),
        act_size=model.nu,
        obs_names=obs_names or joints_of(model, 1),
        act_names=tuple(
            Quantity(f"motor {joint.name}", f"{gear:g} {'N' if slides(joint) else 'N m'}")
            for joint, gear in zip(motors, model.actuator_gear[:, 0], strict=True)
        ),
        obs_scale=obs_scale,
        horizon=horizon,
        gamma=gamma,
        time_step=env.dt,
        bar=lambda seeds: bar,
        rl_steps=rl_steps,
        eval_episodes={"smoke": 5, "quick": 20, "full": 50},
        draw=partial(draw, axes=axes, moves=moves),
        why_ended=why_ended,
        batch=partial(MujocoBatch, env_id, why_ended),
        shipped=shipped,
        rl=rl,
        variants={variant: {"physics": physics} for variant, physics in variants.items()},
        **fields,
    )
    register(spec, "envs.mujoco_tasks:make", env_id=gymnasium_id)
    return spec


MANY = PPO(copies=20, steps=200, checkpoint_every=20_000, check_episodes=5)
"""Learner of the experts of bodies that balance."""
ANGLES = ("first", "second")
DOUBLE_PENDULUM = task(
    "double_pendulum",
    "InvertedDoublePendulum-v5",
    "MuJoCo InvertedDoublePendulum-v5: balance two poles on a cart for 1000 steps",
    obs_names=(
        Quantity("cart position", "m"),
        *(Quantity(f"{of} of the {which} angle") for of in ("sine", "cosine") for which in ANGLES),
        Quantity("cart velocity", "m/s"),
        *(Quantity(f"{which} rate", "rad/s") for which in ANGLES),
        Quantity("force of the rail's ends", "N"),
    ),
    obs_scale=(0.3, 0.1, 0.1, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0),
    bar=9300.0,
    shipped=Shipped(steps=500_000, bar=9300.0, checkpoint_every=4000, rl=MANY),
    rl=replace(FEW_JOINTS, std=0.3),
    rl_steps={"smoke": 4096, "quick": 61_440, "full": 81_920},
    variants={"heavy": Physics(mass=1.5), "gravity": Physics(gravity=1.4), "flipped": Physics(gear=-1.0)},
    ends="tip fell below 1 m",
)
"""A cart on a rail carries two poles, one on the other. A step pays 10, less 0.01 x^2 + (y - 2)^2 of the
upper tip and less a little for speed. An episode ends where the tip falls below 1 m."""
REACHER = task(
    "reacher",
    "Reacher-v5",
    "MuJoCo Reacher-v5: reach a target with an arm of two links, 50 steps",
    obs_names=(
        *(Quantity(f"{of} of the {which} angle") for of in ("cosine", "sine") for which in ANGLES),
        *(Quantity(f"target {axis}", "m") for axis in "xy"),
        *(Quantity(f"{which} rate", "rad/s") for which in ANGLES),
        *(Quantity(f"from target to tip, {axis}", "m") for axis in "xy"),
    ),
    obs_scale=(0.7, 0.7, 0.7, 0.7, 0.1, 0.1, 3.0, 3.0, 0.1, 0.1),
    bar=-6.0,
    shipped=Shipped(steps=60_000, bar=-5.0, checkpoint_every=100, rl=SAC(n_steps=1, checkpoint_every=1000)),
    rl=replace(FEW_JOINTS, check_episodes=20),
    rl_steps={"smoke": 4096, "quick": 40_960, "full": 65_536},
    variants={"heavy": Physics(mass=2.0), "flipped": Physics(gear=-1.0)},
    axes=TOP,
    gamma=0.95,
)
"""An arm of two links in a plane, seen from above. A step pays minus the distance from its tip to the target,
less 0.1 of the action's square. The target is another one in each episode. None ends before 50 steps."""
RUNNING = replace(
    FEW_JOINTS, net=(128, 128), steps=128, learning_rate=4e-4, gae_lambda=0.97, checkpoint_every=40_960
)
"""Learner for bodies that run."""
RUNNING_DDPG = DDPG(net=RUNNING.net)
"""DDPG for bodies that run, and soft actor-critic for csil, whose clone has these networks."""
FEW = {"smoke": 1, "quick": 2, "full": 2}
"""Solves of a reward where each takes minutes."""
HALFCHEETAH = task(
    "halfcheetah",
    "HalfCheetah-v5",
    "MuJoCo HalfCheetah-v5: run, 1000 steps",
    obs_scale=(0.2, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 3.0, 1.0, 2.0, 8.0, 8.0, 8.0, 8.0, 8.0, 8.0),
    bar=8000.0,
    shipped=Shipped(
        steps=450_000,
        bar=8000.0,
        checkpoint_every=2500,
        experts=3,
        episodes=100,
        rl=SAC(
            net=(128, 128),
            batch=256,
            n_steps=1,
            tau=0.01,
            final_learning_rate=3e-4,
            check_episodes=5,
            buffer=450_000,
        ),
    ),
    rl=RUNNING,
    ddpg=RUNNING_DDPG,
    rl_steps={"smoke": 8192, "quick": 819_200, "full": 1_966_080},
    variants={
        "weak_leg": Physics(weak=("fthigh", "fshin", "ffoot")),
        "heavy": Physics(mass=1.5),
        "flipped": Physics(gear=-1.0),
    },
    moves=True,
    solves=FEW,
)
"""A body of seven links with two legs, in a vertical plane. A step pays the forward speed [m/s], less 0.1 of
the action's square. Nothing ends an episode."""
HOPPER = task(
    "hopper",
    "Hopper-v5",
    "MuJoCo Hopper-v5: hop without falling, up to 1000 steps",
    obs_scale=(1.0, 0.1, 0.3, 0.5, 0.5, 1.5, 1.0, 1.0, 2.0, 3.0, 4.0),
    gamma=0.995,
    bar=3000.0,
    shipped=Shipped(steps=1_500_000, bar=3000.0, checkpoint_every=8000, experts=3, episodes=100, rl=MANY),
    rl=replace(RUNNING, net=(64, 64), steps=64, learning_rate=5e-4),
    rl_steps={"smoke": 8192, "quick": 491_520, "full": 1_474_560},
    variants={
        "weak_foot": Physics(weak=("foot_joint",)),
        "heavy": Physics(mass=1.3),
        "flipped": Physics(gear=-1.0),
    },
    ends="fell",
    moves=True,
    solves=FEW,
)
"""A body on one leg, in a vertical plane. A step pays 1 and the forward speed [m/s], less 0.001 of the
action's square. An episode ends where it falls: the torso below 0.7 m, or tilted by more than 0.2 rad."""
WALKER2D = task(
    "walker2d",
    "Walker2d-v5",
    "MuJoCo Walker2d-v5: walk without falling, up to 1000 steps",
    obs_scale=(1.0, 0.2, 0.4, 0.5, 0.4, 0.4, 0.5, 0.4, 2.0, 1.0, 1.5, 3.0, 4.0, 4.0, 3.0, 4.0, 4.0),
    bar=3500.0,
    shipped=Shipped(steps=2_000_000, bar=3500.0, checkpoint_every=20_000, experts=3, episodes=100, rl=MANY),
    rl=RUNNING,
    ddpg=RUNNING_DDPG,
    rl_steps={"smoke": 8192, "quick": 614_400, "full": 1_228_800},
    variants={
        "weak_leg": Physics(weak=("thigh_left_joint", "leg_left_joint", "foot_left_joint")),
        "heavy": Physics(mass=1.3),
        "flipped": Physics(gear=-1.0),
    },
    ends="fell",
    moves=True,
    solves=FEW,
)
"""A body on two legs, in a vertical plane. A step pays 1 and the forward speed [m/s], less 0.001 of the
action's square. An episode ends where it falls: the torso below 0.8 m or above 2 m, or tilted by more than 1
rad."""
