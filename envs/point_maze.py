"""The maze of the transfer experiment of AIRL (Fu, Luo & Levine 2018): push a ball around the end of a wall.

Sizes, wall, ball, motors, start, reward and horizon are those of the authors' code. They observe the ball's
position. Here its velocity is observed too, so that the state is known.
"""

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from envs.learners import DDPG, FEW_JOINTS, PPO
from envs.mujoco_batch import MujocoBatch
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 100
LOW, HIGH = -0.1, 0.6  # m, where the outer walls are
HEIGHT = 0.3  # m, of the inner wall
START, TARGET = (0.3, 0.0), (0.3, 0.5)  # m
RADIUS, WALL = 0.03, 0.02  # m, of the ball; half of a wall's width
FRAME_SKIP, FRAME = 5, 0.01  # s
ENERGY = 0.001  # cost of the squared action


@dataclass(frozen=True)
class Physics:
    """Parameters that variants change."""

    wall: tuple[float, float] = (0.2, HIGH)
    """Ends of the inner wall [m]. The way around it is on the left."""
    gear: float = 1.0
    """Strength of the motors [N]."""

    def compile(self) -> mujoco.MjModel:
        """Return the model."""
        left, right = self.wall
        corners = ((LOW, LOW), (HIGH, LOW), (HIGH, HIGH), (LOW, HIGH), (LOW, LOW))
        ends = [*pairwise(corners), ((left, HEIGHT), (right, HEIGHT))]
        walls = "".join(
            f'<geom type="capsule" fromto="{x} {y} 0.01 {to_x} {to_y} 0.01" size="{WALL}"/>'
            for (x, y), (to_x, to_y) in ends
        )
        return mujoco.MjModel.from_xml_string(f"""
            <mujoco>
              <option timestep="{FRAME}" gravity="0 0 0" iterations="20" integrator="Euler"/>
              <default>
                <joint type="slide" damping="1"/>
                <geom friction=".5 .1 .1" density="1000" margin="0.002" condim="1" contype="2"/>
                <motor gear="{self.gear}" ctrllimited="true" ctrlrange="-1 1"/>
              </default>
              <worldbody>
                {walls}
                <body pos="{START[0]} {START[1]} 0">
                  <geom type="sphere" size="{RADIUS}" contype="1"/>
                  <joint name="x" axis="1 0 0"/>
                  <joint name="y" axis="0 1 0"/>
                </body>
              </worldbody>
              <actuator><motor joint="x"/><motor joint="y"/></actuator>
            </mujoco>""")


NOMINAL = Physics()


class PointMaze(MujocoEnv, EzPickle):
    """Observation (4,): position [m] and velocity [m/s]. Action (2,) in [-1, 1]: force [N]. Each step pays
    minus the distance to the target before it, less 0.001 of the action's square. It never terminates."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, physics: Physics = NOMINAL) -> None:
        self.physics = physics
        super().__init__(__file__, FRAME_SKIP, spaces.Box(-np.inf, np.inf, (4,), np.float64))
        EzPickle.__init__(self, physics)

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        model = self.physics.compile()
        return model, mujoco.MjData(model)

    def step(self, action: NDArray[np.float32]) -> Any:
        away, act = self.place() - TARGET, action.astype(np.float64)
        self.do_simulation(action, self.frame_skip)
        reward = -float(np.sqrt(away @ away)) - ENERGY * float(act @ act)
        return self._observe(), reward, False, False, {}

    def reset_model(self) -> NDArray[np.float64]:
        push = self.np_random.uniform(-0.01, 0.01, 2)
        self.set_state(self.init_qpos, self.init_qvel + push)  # type: ignore[no-untyped-call]
        return self._observe()

    def place(self) -> Array:
        """Return the ball's position [m], (2,)."""
        return np.asarray(self.data.qpos + START)

    def _observe(self) -> Array:
        return np.concatenate([self.place(), self.data.qvel])


def phi(obs: Array, act: Array) -> Array:
    """Return the nearness of the ball to nine places on a grid, and a constant, (B, 10)."""
    line = np.linspace(0.0, 0.5, 3)
    grid = np.array([(x, y) for x in line for y in line])
    squares = np.square(obs[:, None, :2] - grid).sum(axis=2)
    return np.column_stack([np.exp(-squares / (2 * 0.15**2)), np.ones(len(obs))])


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return a view from above: walls as lines, the ball and the target as circles."""
    inner: Any = env.unwrapped
    turns = np.linspace(0, 2 * math.pi, 17)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    outer = np.array([(LOW, LOW), (HIGH, LOW), (HIGH, HIGH), (LOW, HIGH), (LOW, LOW)])
    return {
        "walls": Shape(outer, (140, 140, 140)),
        "wall": Shape(np.array([(x, HEIGHT) for x in inner.physics.wall]), (140, 140, 140)),
        "target": Shape(TARGET + 0.02 * circle, (52, 168, 83)),
        "ball": Shape(inner.place() + RADIUS * circle, (66, 133, 244)),
    }


THESIS = DDPG(final_learning_rate=1e-4, batch=256, noise=1.0, checkpoint_every=2500, n_steps=5, critics=2)
"""Learner of the thesis."""

SPEC = EnvSpec(
    name="point_maze",
    summary="AIRL's maze: push a ball around the end of a wall to a target, 100 steps",
    env_id="irl_bench_bare/PointMaze-v0",
    obs_size=4,
    act_size=2,
    obs_names=(Quantity("x", "m"), Quantity("y", "m"), Quantity("x rate", "m/s"), Quantity("y rate", "m/s")),
    act_names=(Quantity("force along x", "N"), Quantity("force along y", "N")),
    obs_scale=(0.3, 0.3, 0.3, 0.3),
    horizon=HORIZON,
    time_step=FRAME_SKIP * FRAME,
    bar=lambda seeds: -6.0,
    rl_steps={"smoke": 4096, "quick": 51_200, "full": 102_400},
    ddpg_steps={"smoke": 600, "quick": 30_000, "full": 60_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    batch=partial(MujocoBatch, "irl_bench_bare/PointMaze-v0", EnvSpec.why_ended),
    shipped=Shipped(steps=750_000, bar=-5.0, checkpoint_every=2500, rl=PPO()),
    rl=FEW_JOINTS,
    ddpg=THESIS,
    variants={
        "wall_moved": {"physics": Physics(wall=(LOW, 0.4))},
        "flipped": {"physics": Physics(gear=-1.0)},
    },
)
"""The ball starts below the wall and the target lies above it. With the wall moved, the way around is on the
other side: what was learned must be worth something there as well."""

register(SPEC, "envs.point_maze:PointMaze")
