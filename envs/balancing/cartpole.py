"""Continuous cart-pole: Gymnasium's CartPole physics (Barto, Sutton & Anderson 1983), a force in proportion
to the action, and the reward of RLLab (Duan et al. 2016), as in the thesis. For actions of -1 and +1 the
dynamics equal those of Gymnasium's `CartPole-v1`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from envs.dynamics import Draws, DynamicsBatch, namespace, why_ended
from envs.learners import DDPG, SMALL_PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped, register

NO_NUMBERS = {"draw": "It draws pictures.", "draw_cart_and_pole": "It draws pictures."}

HORIZON = 500
POSITION, VELOCITY = Quantity("cart position", "m"), Quantity("cart velocity", "m/s")
ANGLE, RATE = Quantity("pole angle", "rad"), Quantity("pole rate", "rad/s")


@dataclass(frozen=True)
class Physics:
    """Physics of a cart with a pole (`envs.dynamics.Dynamics`). A state is the cart's position [m] and
    velocity [m/s], the pole's angle [rad] and its rate [rad/s]. A step pays (10 - (1 - cos angle) - 1e-5
    force^2) / 10 while alive, and 0 on failing: where |position| > 2.4 m or |angle| > 12 degrees. Units:
    `gravity` m/s^2, `cart_mass` kg, `pole_mass` kg, `time_step` s."""

    gravity: float = 9.8
    cart_mass: float = 1.0
    pole_mass: float = 0.1
    half_length: float = 0.5
    """Half of the pole's length [m]."""
    max_force: float = 10.0
    """Force at an action of 1 [N]."""
    time_step: float = 0.02
    max_x: float = 2.4
    """Distance of the track's ends from its middle [m]."""
    max_angle: float = 12 * 2 * math.pi / 360
    """Angle from upright beyond which the pole has fallen [rad]."""
    act_size = 1

    @property
    def bounds(self) -> Sequence[float]:
        return 2 * self.max_x, np.inf, 2 * self.max_angle, np.inf

    def start(self, draws: Draws) -> Any:
        return draws.uniform(np.full(4, -0.05), np.full(4, 0.05))

    def advance(self, state: Any, act: Any) -> Any:
        xp = namespace(state)
        x, x_dot, angle, angle_dot = state
        force = self.max_force * act[0]
        cos, sin = xp.cos(angle), xp.sin(angle)
        pole_mass, half_length, dt = self.pole_mass, self.half_length, self.time_step
        total_mass = self.cart_mass + pole_mass
        push = (force + pole_mass * half_length * (angle_dot * angle_dot) * sin) / total_mass
        angle_acc = (self.gravity * sin - cos * push) / (
            half_length * (4 / 3 - pole_mass * (cos * cos) / total_mass)
        )
        x_acc = push - pole_mass * half_length * angle_acc * cos / total_mass
        x, x_dot = x + dt * x_dot, x_dot + dt * x_acc
        angle, angle_dot = angle + dt * angle_dot, angle_dot + dt * angle_acc
        return xp.stack([x, x_dot, angle, angle_dot])

    def observe(self, state: Any) -> Any:
        return state

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        xp = namespace(after)
        force, angle = self.max_force * act[0], after[2]
        alive = (10 - (1 - xp.cos(angle)) - 1e-5 * (force * force)) / 10
        return xp.where(self.fails(after), 0.0, alive)

    def fails(self, state: Any) -> Any:
        xp = namespace(state)
        return xp.asarray((xp.abs(state[0]) > self.max_x) | (xp.abs(state[2]) > self.max_angle))

    def failure(self, state: Array) -> str:
        return "cart left the track" if abs(state[0]) > self.max_x else "pole fell"


NOMINAL = Physics()


def centred(obs: Array, limits: Sequence[float]) -> Array:
    """Return 1 - (value / limit)^2 of observations (B, O), clipped to [-1, 1], and a constant, (B, O + 1)."""
    inside = 1 - (obs / np.array(limits)) ** 2
    return np.concatenate([np.clip(inside, -1, 1), np.ones((len(obs), 1))], axis=1)


def draw_cart_and_pole(x: float, angle: float, track: float, pole_length: float) -> dict[str, Shape]:
    """Return a side view of a cart at x [m] on a track from -track to track [m], with its pole at an angle
    [rad] from upright, clockwise."""
    box = np.array([[x - 0.2, -0.1], [x + 0.2, -0.1], [x + 0.2, 0.1], [x - 0.2, 0.1], [x - 0.2, -0.1]])
    tip = [x + pole_length * math.sin(angle), pole_length * math.cos(angle)]
    return {
        "track": Shape(np.array([[-track, -0.1], [track, -0.1]]), (140, 140, 140)),
        "cart": Shape(box, (66, 133, 244)),
        "pole": Shape(np.array([[x, 0.0], tip]), (234, 134, 51)),
    }


def phi(obs: Array, act: Array) -> Array:
    """Return the centredness of each observation, and a constant, (B, 5)."""
    return centred(obs, (NOMINAL.max_x, 3.0, NOMINAL.max_angle, 3.5))


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the track, the cart as a box and the pole as a line."""
    inner: Any = env.unwrapped
    x, _, angle, _ = (float(value) for value in inner.state)
    return draw_cart_and_pole(x, angle, inner.physics.max_x, 2 * inner.physics.half_length)


SPEC = EnvSpec(
    name="cartpole",
    summary="continuous cart-pole: keep the pole upright for 500 steps (RLLab's reward)",
    env_id="irl_bench_bare/CartPole-v0",
    obs_size=4,
    act_size=1,
    obs_names=(POSITION, VELOCITY, ANGLE, RATE),
    act_names=(Quantity("motor", "10 N"),),
    obs_scale=(1.0, 0.5, 0.05, 0.5),
    horizon=HORIZON,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: 495.0,
    rl_steps={"smoke": 4096, "quick": 65_536, "full": 98_304},
    rl=SMALL_PPO,
    ddpg_steps={"smoke": 600, "quick": 16_000, "full": 30_000},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=60_000, bar=499.5, rl=DDPG()),
    kwargs={"physics": NOMINAL},
    batch=partial(DynamicsBatch, physics=NOMINAL),
    variants={
        "long_pole": {"physics": Physics(half_length=0.75)},
        "heavy": {"physics": Physics(pole_mass=0.5)},
        "flipped": {"physics": Physics(max_force=-NOMINAL.max_force)},
    },
)
"""A cart on a track of 2.4 m to either side carries a pole of 1 m. The motor pushes the cart with up to 10 N.
An episode ends where the cart leaves the track or the pole leans by more than 12 degrees, and its last step
pays 0. Other steps pay nearly 1, so the return is the time that the pole stands.

    r = (10 - (1 - cos(angle)) - 0.00001 force^2) / 10
"""

register(SPEC, "envs.dynamics:DynamicsEnv")
