"""RLLab's Cart-Pole Swing Up (Duan et al. 2016): swing a pole up by moving its cart, and hold it there.

Sizes, masses, starts, reward and ending are RLLab's. The equations below replace its Box2D simulation. They
omit friction (RLLab's is 2e-6 to 5e-4), and correct no errors of a step by moving bodies. Angles are observed
as cosine and sine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from envs.balancing.cartpole import POSITION, RATE, VELOCITY, draw_cart_and_pole
from envs.dynamics import Draws, DynamicsBatch, namespace, runge_kutta, why_ended
from envs.learners import PPO, SMALL_PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures."}

HORIZON = 500


@dataclass(frozen=True)
class Physics:
    """Physics of a cart with a uniform rod on a hinge (`envs.dynamics.Dynamics`). A state is the cart's
    position [m] and velocity [m/s], the pole's angle from upright, clockwise [rad], and its rate [rad/s].
    Each step pays the angle's cosine after it, and leaving the track pays -100. Units: `gravity` m/s^2,
    `cart_mass` kg, `pole_mass` kg, `pole_length` m, `time_step` s."""

    gravity: float = 10.0
    cart_mass: float = 1.0
    pole_mass: float = 0.1
    pole_length: float = 1.0
    max_force: float = 10.0
    """Force at an action of 1 [N]."""
    max_x: float = 3.0
    """Distance of the track's ends from its middle [m]."""
    time_step: float = 0.05
    parts: int = 5
    """Parts of a time step in the integration."""
    act_size = 1

    @property
    def bounds(self) -> Sequence[float]:
        return np.inf, np.inf, 1.0, 1.0, np.inf

    def start(self, draws: Draws) -> Any:
        middle, off = np.array([0.0, 0.0, np.pi, 0.0]), np.array([1.0, 2.0, 1.0, 3.0])
        return draws.uniform(middle - off, middle + off)

    def advance(self, state: Any, act: Any) -> Any:
        force = self.max_force * act[0]
        return runge_kutta(partial(self.rates, force=force), state, self.time_step, self.parts)

    def rates(self, state: Any, force: Any) -> Any:
        """Return the state's derivative, by Lagrange, with the cart's mass M, and the pole's mass m, centre
        at c = length / 2 and inertia I about it.

            (M + m) x'' + m c (cos(angle) angle'' - sin(angle) angle'^2) = force
            m c cos(angle) x'' + (I + m c^2) angle'' = m g c sin(angle)
        """
        xp = namespace(state)
        _, velocity, angle, rate = state
        cos, sin = xp.cos(angle), xp.sin(angle)
        moment = self.pole_mass * self.pole_length / 2
        inertia = self.pole_mass * self.pole_length * self.pole_length / 3
        total = self.cart_mass + self.pole_mass
        push, fall = force + moment * sin * (rate * rate), moment * self.gravity * sin
        determinant = total * inertia - (moment * cos) * (moment * cos)
        acceleration = (inertia * push - moment * cos * fall) / determinant
        turning = (total * fall - moment * cos * push) / determinant
        return xp.stack([velocity, acceleration, rate, turning])

    def observe(self, state: Any) -> Any:
        xp = namespace(state)
        x, velocity, angle, rate = state
        return xp.stack([x, velocity, xp.cos(angle), xp.sin(angle), rate])

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        xp = namespace(after)
        return xp.where(self.fails(after), -100.0, xp.cos(after[2]))

    def fails(self, state: Any) -> Any:
        xp = namespace(state)
        return xp.asarray(xp.abs(state[0]) > self.max_x)

    def failure(self, state: Array) -> str:
        return "cart left the track"


NOMINAL = Physics()


def phi(obs: Array, act: Array) -> Array:
    """Return how upright the pole is, how centred the cart, how still both, and a constant, (B, 5)."""
    upright = np.clip(obs[:, 2], -1, 1)
    limits = (NOMINAL.max_x, 5.0, 10.0)
    inside = 1 - np.clip(obs[:, [0, 1, 4]] / np.array(limits), -1, 1) ** 2
    return np.column_stack([upright, inside, np.ones(len(obs))])


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the track, the cart as a box and the pole as a line."""
    inner: Any = env.unwrapped
    x, _, angle, _ = (float(value) for value in inner.state)
    return draw_cart_and_pole(x, angle, inner.physics.max_x, inner.physics.pole_length)


SPEC = EnvSpec(
    name="cartpole_swingup",
    summary="RLLab's Cart-Pole Swing Up: swing the pole up from hanging, and hold it, within 25 s",
    env_id="irl_bench_bare/CartPoleSwingup-v0",
    obs_size=5,
    act_size=1,
    obs_names=(
        POSITION,
        VELOCITY,
        Quantity("cosine of the pole's angle"),
        Quantity("sine of the pole's angle"),
        RATE,
    ),
    act_names=(Quantity("motor", "10 N"),),
    obs_scale=(1.0, 1.5, 0.7, 0.7, 3.0),
    horizon=HORIZON,
    gamma=0.98,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: 430.0,
    rl_steps={"smoke": 8192, "quick": 327_680, "full": 409_600},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    kwargs={"physics": NOMINAL},
    batch=partial(DynamicsBatch, physics=NOMINAL),
    shipped=Shipped(
        steps=1_000_000, bar=455.0, terminated=0.01, checkpoint_every=10_000, rl=PPO(final_learning_rate=5e-5)
    ),
    rl=replace(SMALL_PPO, copies=64, epochs=6, checkpoint_every=40_960),
    variants={
        "long_pole": {"physics": Physics(pole_length=1.5)},
        "heavy": {"physics": Physics(pole_mass=0.5)},
        "gravity": {"physics": Physics(gravity=14.0)},
        "flipped": {"physics": Physics(max_force=-NOMINAL.max_force)},
    },
)
"""The pole starts near hanging. Each step pays the cosine of its angle, 1 upright and -1 hanging; an episode
ends, at a price of 100, where the cart leaves the track."""

register(SPEC, "envs.dynamics:DynamicsEnv")
