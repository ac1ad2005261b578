"""The inverted pendulum of Gymnasium's MuJoCo suite (`InvertedPendulum-v5`), actions scaled to [-1, 1]."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from envs.balancing.cartpole import ANGLE, POSITION, RATE, VELOCITY, centred, draw_cart_and_pole
from envs.learners import DDPG, FEW_JOINTS
from envs.mujoco_batch import MujocoBatch
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 1000
MAX_ANGLE = 0.2  # rad, beyond which the environment terminates
RAIL = 1.0  # m, half of the rail's length
TIME_STEP = 0.04  # s


@dataclass(frozen=True)
class Physics:
    """Parameters of Gymnasium's model that variants change."""

    pole_length: float = 0.6
    """[m]"""
    pole_density: float = 1000.0
    """[kg/m^3]"""
    gear: float = 100.0
    """Strength of the motor [N], whose control is in [-3, 3]."""

    def compile(self, xml: str) -> mujoco.MjModel:
        """Return the file's model with these parameters."""
        spec = mujoco.MjSpec.from_file(xml)
        pole = spec.geom("cpole")
        pole.fromto[-1], pole.density = self.pole_length, self.pole_density
        spec.actuator("slide").gear[0] = self.gear
        return spec.compile()


NOMINAL = Physics()


class Pendulum(InvertedPendulumEnv):
    """Observation (4,): cart position [m], pole angle [rad], and their rates. Action (1,) in [-1, 1]: a third
    of Gymnasium's. The episode terminates where |angle| > 0.2 rad."""

    def __init__(self, physics: Physics = NOMINAL) -> None:
        self.physics = physics
        super().__init__()
        EzPickle.__init__(self, physics)

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        model = self.physics.compile(self.fullpath)
        return model, mujoco.MjData(model)

    def _set_action_space(self) -> Any:
        super()._set_action_space()  # type: ignore[no-untyped-call]
        self.full_action = self.model.actuator_ctrlrange[:, 1].astype(np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, self.full_action.shape, np.float32)
        return self.action_space

    def step(self, action: NDArray[np.float32]) -> Any:
        return super().step(action * self.full_action)  # type: ignore[no-untyped-call]


def phi(obs: Array, act: Array) -> Array:
    """Return the centredness of each observation, and a constant, (B, 5)."""
    return centred(obs, (RAIL, MAX_ANGLE, 2.0, 2.0))


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the rail, the cart as a box and the pole as a line."""
    inner: Any = env.unwrapped
    x, angle = inner.data.qpos
    return draw_cart_and_pole(float(x), float(angle), RAIL, inner.physics.pole_length)


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return 'pole fell': the cart cannot leave its rail."""
    return "pole fell"


THESIS = DDPG(checkpoint_every=2000, check_episodes=5)
"""Learner of the thesis. Episodes are long, and begin alike."""

SPEC = EnvSpec(
    name="pendulum",
    summary="MuJoCo InvertedPendulum-v5: balance the pole for 1000 steps",
    env_id="irl_bench_bare/Pendulum-v0",
    obs_size=4,
    act_size=1,
    obs_names=(POSITION, ANGLE, VELOCITY, RATE),
    act_names=(Quantity("motor", "300 N"),),
    public_bounds=(-3.0, 3.0),
    obs_scale=(0.3, 0.05, 0.5, 0.5),
    horizon=HORIZON,
    time_step=TIME_STEP,
    bar=lambda seeds: 1000.0,
    rl_steps={"smoke": 4096, "quick": 30_720, "full": 40_960},
    ddpg_steps={"smoke": 600, "quick": 20_000, "full": 40_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=80_000, bar=1000.0, checkpoint_every=500, rl=THESIS),
    rl=replace(FEW_JOINTS, std=0.3),
    ddpg=THESIS,
    batch=partial(MujocoBatch, "irl_bench_bare/Pendulum-v0", why_ended),
    variants={
        "long_pole": {"physics": Physics(pole_length=1.5 * NOMINAL.pole_length)},
        "heavy": {"physics": Physics(pole_density=2 * NOMINAL.pole_density)},
        "flipped": {"physics": Physics(gear=-NOMINAL.gear)},
    },
)
"""A cart on a rail of 1 m to either side carries a pole of 0.6 m. A step pays 1 while |angle| is at most 0.2
rad; an episode ends beyond. The cart cannot leave its rail."""

register(SPEC, "envs.balancing.pendulum:Pendulum")
