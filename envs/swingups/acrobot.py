"""RLLab's Acrobot (Duan et al. 2016, its `double_pendulum_env`): lift the tip of two hanging links to its
upright place, with a motor between them.

Sizes, masses, torque, starts, reward and horizon are RLLab's. The equations below replace its Box2D
simulation. Its motor drives the joint towards an infinite speed by at most the action's torque. Here the
torque acts. RLLab's reward mirrors the tip from left to right, which is not done here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from envs.dynamics import Draws, DynamicsBatch, namespace, never, runge_kutta
from envs.learners import PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 500
BEYOND = 0.5  # m, half the width of the drawing's ground


@dataclass(frozen=True)
class Physics:
    """Physics of two uniform rods (`envs.dynamics.Dynamics`). A state is the angle of each from hanging,
    anticlockwise [rad], and both rates [rad/s]. Each step pays minus the tip's distance [m] to its upright
    place. It never terminates. Units: `gravity` m/s^2, `time_step` s."""

    gravity: float = 10.0
    mass: float = 0.5
    """Mass of each link [kg]."""
    length: float = 1.0
    """Length of each link [m]."""
    max_torque: float = 50.0
    """Torque on the second link, and against the first, at an action of 1 [N m]."""
    max_rate: float = 50 * np.pi
    """Largest rate [rad/s], as in Box2D: a quarter of a turn in one of its steps of 0.01 s."""
    time_step: float = 0.02
    parts: int = 4
    """Parts of a time step in the integration."""
    act_size = 1

    @property
    def bounds(self) -> Sequence[float]:
        return 1.0, 1.0, 1.0, 1.0, self.max_rate, self.max_rate

    def start(self, draws: Draws) -> Any:
        return draws.standard_normal(4) * np.array([0.1, 0.1, 0.01, 0.01])

    def advance(self, state: Any, act: Any) -> Any:
        torque = self.max_torque * act[0]
        after = runge_kutta(partial(self.rates, torque=torque), state, self.time_step, self.parts)
        xp = namespace(after)
        return xp.concatenate([after[:2], xp.clip(after[2:], -self.max_rate, self.max_rate)])

    def rates(self, state: Any, torque: Any) -> Any:
        """Return the state's derivative, by Lagrange. m is mass, l length, d = first - second.

        (4/3) m l^2 first'' + 0.5 m l^2 (cos(d) second'' + sin(d) second'^2) = -torque - 1.5 m g l sin(first).
        (1/3) m l^2 second'' + 0.5 m l^2 (cos(d) first'' - sin(d) first'^2) = torque - 0.5 m g l sin(second).
        """
        xp = namespace(state)
        first, second, rate, other = state
        size, weight = self.mass * self.length * self.length, self.mass * self.gravity * self.length
        cos, sin = xp.cos(first - second) / 2, xp.sin(first - second) / 2
        one = (-torque - 1.5 * weight * xp.sin(first)) / size - sin * (other * other)
        two = (torque - 0.5 * weight * xp.sin(second)) / size + sin * (rate * rate)
        determinant = 4 / 9 - cos * cos
        return xp.stack(
            [rate, other, (one / 3 - cos * two) / determinant, (4 / 3 * two - cos * one) / determinant]
        )

    def observe(self, state: Any) -> Any:
        xp = namespace(state)
        first, second, rate, other = state
        return xp.stack([xp.cos(first), xp.sin(first), xp.cos(second), xp.sin(second), rate, other])

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        xp = namespace(after)
        x, y = self.tip(after)
        above = y - 2 * self.length
        return xp.asarray(-xp.sqrt(x * x + above * above))

    def tip(self, state: Any) -> tuple[Any, Any]:
        """Return the tip's distance to the right of the hinge and above it [m]."""
        xp = namespace(state)
        first, second, _, _ = state
        return (
            self.length * (xp.sin(first) + xp.sin(second)),
            -self.length * (xp.cos(first) + xp.cos(second)),
        )

    def fails(self, state: Any) -> Any:
        return never(state)

    def failure(self, state: Array) -> str:
        return "never"


NOMINAL = Physics()


def phi(obs: Array, act: Array) -> Array:
    """Return the uprightness of each link, the stillness of each, and a constant, (B, 5)."""
    still = 1 - np.clip(obs[:, 4:] / 20.0, -1, 1) ** 2
    return np.column_stack([-np.clip(obs[:, [0, 2]], -1, 1), still, np.ones(len(obs))])


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the links as lines, and a line at the hinge's height."""
    inner: Any = env.unwrapped
    first, length = float(inner.state[0]), inner.physics.length
    elbow = [length * np.sin(first), -length * np.cos(first)]
    tip = [float(value) for value in inner.physics.tip(inner.state)]
    return {
        "hinge": Shape(np.array([[-BEYOND, 0.0], [BEYOND, 0.0]]), (140, 140, 140)),
        "first": Shape(np.array([[0.0, 0.0], elbow]), (66, 133, 244)),
        "second": Shape(np.array([elbow, tip]), (234, 134, 51)),
    }


SPEC = EnvSpec(
    name="acrobot",
    summary="RLLab's Acrobot: lift two links upright by a motor between them, and hold them, within 10 s",
    env_id="irl_bench_bare/Acrobot-v0",
    obs_size=6,
    act_size=1,
    obs_names=(
        Quantity("cosine of the first angle"),
        Quantity("sine of the first angle"),
        Quantity("cosine of the second angle"),
        Quantity("sine of the second angle"),
        Quantity("first rate", "rad/s"),
        Quantity("second rate", "rad/s"),
    ),
    act_names=(Quantity("motor", "50 N m"),),
    obs_scale=(0.7, 0.7, 0.7, 0.7, 15.0, 30.0),
    horizon=HORIZON,
    gamma=0.98,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: -250.0,
    rl_steps={"smoke": 20_000, "quick": 1_000_000, "full": 2_000_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    kwargs={"physics": NOMINAL},
    batch=partial(DynamicsBatch, physics=NOMINAL),
    shipped=Shipped(
        steps=3_000_000, bar=-223.6, rl=PPO(copies=100, steps=100, batch=1000, checkpoint_every=50_000)
    ),
    rl=PPO(
        copies=100,
        steps=100,
        batch=1000,
        epochs=8,
        learning_rate=1e-3,
        final_learning_rate=5e-5,
        checkpoint_every=50_000,
    ),
    variants={
        "long": {"physics": Physics(length=1.5)},
        "heavy": {"physics": Physics(mass=1.0)},
        "flipped": {"physics": Physics(max_torque=-NOMINAL.max_torque)},
    },
)
"""Two links hang from a fixed hinge; the motor sits between them. Each step pays minus the distance from the
tip to its upright place. No episode ends before 10 s."""

register(SPEC, "envs.dynamics:DynamicsEnv")
