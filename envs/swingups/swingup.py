"""Gymnasium's `Pendulum-v1`: swing a pendulum up with a weak motor, and hold it upright."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from envs.dynamics import Draws, DynamicsBatch, namespace, never
from envs.learners import DDPG, SMALL_PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 200


@dataclass(frozen=True)
class Physics:
    """Physics of a rod on a motor (`envs.dynamics.Dynamics`). A state is its angle from upright [rad] and its
    rate [rad/s]. A step pays -(angle^2 + 0.1 rate^2 + 0.001 torque^2) of the state and the torque before it,
    as in Gymnasium. Units: `gravity` m/s^2, `mass` kg, `length` m, `time_step` s."""

    gravity: float = 10.0
    mass: float = 1.0
    length: float = 1.0
    max_torque: float = 2.0
    """Torque at an action of 1 [N m]."""
    max_rate: float = 8.0
    """Largest rate [rad/s]."""
    time_step: float = 0.05
    act_size = 1

    @property
    def bounds(self) -> Sequence[float]:
        return 1.0, 1.0, self.max_rate

    def start(self, draws: Draws) -> Any:
        return draws.uniform((-np.pi, -1.0), (np.pi, 1.0))

    def advance(self, state: Any, act: Any) -> Any:
        xp = namespace(state)
        angle, rate = state
        pull = 3 * self.gravity / (2 * self.length) * xp.sin(angle)
        push = 3.0 / (self.mass * self.length**2) * self._torque(act)
        rate = xp.clip(rate + (pull + push) * self.time_step, -self.max_rate, self.max_rate)
        return xp.stack([angle + rate * self.time_step, rate])

    def observe(self, state: Any) -> Any:
        xp = namespace(state)
        angle, rate = state
        return xp.stack([xp.cos(angle), xp.sin(angle), rate])

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        angle, rate = state
        off, torque = ((angle + np.pi) % (2 * np.pi)) - np.pi, self._torque(act)
        return namespace(state).asarray(-(off * off + 0.1 * (rate * rate) + 0.001 * (torque * torque)))

    def _torque(self, act: Any) -> Any:
        """Return the torque in 32 bits, as in Gymnasium."""
        return self.max_torque * act[0].astype(np.float32)

    def fails(self, state: Any) -> Any:
        return never(state)

    def failure(self, state: Array) -> str:
        return "never"


NOMINAL = Physics()


def phi(obs: Array, act: Array) -> Array:
    """Return uprightness, stillness, their product, and a constant, (B, 4)."""
    upright, still = np.clip(obs[:, 0], -1, 1), 1 - np.clip(obs[:, 2] / NOMINAL.max_rate, -1, 1) ** 2
    return np.stack([upright, still, upright * still, np.ones(len(obs))], axis=1)


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the rod as a line, and the point that it turns about."""
    inner: Any = env.unwrapped
    angle, length = float(inner.state[0]), inner.physics.length
    tip = [-length * np.sin(angle), length * np.cos(angle)]
    return {
        "motor": Shape(np.array([[-0.05, 0.0], [0.05, 0.0]]), (140, 140, 140)),
        "rod": Shape(np.array([[0.0, 0.0], tip]), (234, 134, 51)),
    }


SPEC = EnvSpec(
    name="swingup",
    summary="Gymnasium's Pendulum-v1: swing a pendulum up with a weak motor, and hold it for 10 s",
    env_id="irl_bench_bare/Swingup-v0",
    obs_size=3,
    act_size=1,
    obs_names=(Quantity("cosine of the angle"), Quantity("sine of the angle"), Quantity("rate", "rad/s")),
    act_names=(Quantity("motor", "2 N m"),),
    public_bounds=(-2.0, 2.0),
    obs_scale=(0.7, 0.7, 3.0),
    horizon=HORIZON,
    gamma=0.98,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: -180.0,
    rl_steps={"smoke": 4096, "quick": 122_880, "full": 163_840},
    rl=replace(SMALL_PPO, epochs=6),
    ddpg_steps={"smoke": 600, "quick": 15_000, "full": 30_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    kwargs={"physics": NOMINAL},
    batch=partial(DynamicsBatch, physics=NOMINAL),
    shipped=Shipped(steps=20_000, bar=-150.0, checkpoint_every=20, rl=DDPG()),
    variants={
        "long": {"physics": Physics(length=1.5)},
        "heavy": {"physics": Physics(mass=2.0)},
        "gravity": {"physics": Physics(gravity=14.0)},
        "light": {"physics": Physics(mass=0.5)},
        "flipped": {"physics": Physics(max_torque=-NOMINAL.max_torque)},
    },
)
"""The motor is too weak to lift the pendulum at once, so it must swing to and fro first. It starts anywhere.
No episode ends before 10 s. A step pays for the angle from upright [rad], the rate [rad/s] and the torque [N
m]

    r = -(angle^2 + 0.1 rate^2 + 0.001 torque^2)
"""

register(SPEC, "envs.dynamics:DynamicsEnv")
