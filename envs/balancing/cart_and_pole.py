"""Shared parts of tasks of a cart that balances a pole: observations, features and the drawing."""

import math
from collections.abc import Sequence

import numpy as np

from envs.spec import Array, Quantity, Shape

NO_NUMBERS = {"draw_cart_and_pole": "It draws pictures."}

POSITION, VELOCITY = Quantity("cart position", "m"), Quantity("cart velocity", "m/s")
ANGLE, RATE = Quantity("pole angle", "rad"), Quantity("pole rate", "rad/s")


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
