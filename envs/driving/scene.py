"""Scenes of highway-env's highway: vehicles on straight parallel lanes from x = 0, the ego first."""

import math
from typing import Any, NamedTuple

import numpy as np

from envs.dynamics import namespace
from envs.spec import Array

DT, FRAMES = 0.2, 2  # s, and frames of a step
LANES, LANE_WIDTH = 3, 4.0  # m
LENGTH, WIDTH = 5.0, 2.0  # m, of a vehicle
SPEED_LIMIT = 30.0  # m/s
EGO_SPEED, EGO_SPACING = 25.0, 1.5  # m/s at first, and usual distances ahead of the next vehicle
EGO_SPEEDS = (10.0, 25.0)  # m/s, lowest and highest
PEDAL = 8.0  # m/s^2 at an action of 1
# One degree turns 25 m/s at 2.2 m/s^2: a brisk lane change, not an emergency.
WHEEL = math.pi / 180
CRASH = -25.0  # reward
REACH = 60.0  # m, how far the ego sees
CORRIDOR = 2.5  # m, half the width of a lane's corridor; two vehicles touch at 2 m
ELBOW_ROOM = 2.0  # m, ahead and behind, within which a vehicle is beside
SIDE_REACH = 8.0  # m, how far it sees to its sides
CRUISE = 25.0  # m/s, the speed that is observed as 0
LONG, FAST, WIDE, DRIFT = 20.0, 5.0, 4.0, 1.0  # m, m/s, m, m/s: units of observations


class Scene(NamedTuple):
    """A scene's rows, with an entry for each vehicle. Whole numbers and flags are floats too."""

    x: Any
    """[m]"""
    y: Any
    """[m]"""
    heading: Any
    """[rad]"""
    cos: Any
    """Cosine of the heading."""
    sin: Any
    """Sine of the heading."""
    speed: Any
    """[m/s]"""
    timer: Any
    """Time since the driver last considered a change of lanes [s]."""
    delta: Any
    """Exponent of IDM."""
    target_speed: Any
    """[m/s]; 0 for an ego that actions drive."""
    lane: Any
    """Number of the closest lane."""
    target: Any
    """Number of the lane that the driver wants to be in."""
    crashed: Any


SPEEDS, SPREADS, DELTAS = (0.7 * SPEED_LIMIT, 0.8 * SPEED_LIMIT), (0.9, 1.1), (3.5, 4.5)
"""Bounds of the others' first speeds, of distances as shares of the usual ones, and of IDM's exponents."""


def first_scene(rng: np.random.Generator, vehicles: int, density: float) -> Array:
    """Return highway-env's first scene (12, 1 + vehicles), bit for bit. `density`: relative to
    highway-env's."""

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * rng.random()  # equals `rng.uniform`, and is five times faster

    rows = []
    for ego in (True, *[False] * vehicles):
        lane, speed = int(rng.integers(LANES)), EGO_SPEED if ego else uniform(*SPEEDS)
        rows.append((lane, speed, uniform(*SPREADS), 0.0 if ego else uniform(*DELTAS)))
    lane, speed, spread, delta = np.array(rows).T
    return np.array(in_line(lane, speed, spread, delta, density))


def in_line(lane: Any, speed: Any, spread: Any, delta: Any, density: float) -> Any:
    """Return a scene (12, N) of vehicles in line, of arrays (N,) of NumPy or JAX. `spread`: relative
    distances."""
    xp = namespace(speed)
    ego = xp.arange(len(speed)) == 0
    usual = xp.where(ego, EGO_SPACING, 1 / density) * (12 + speed) * math.exp(-5 / 40 * LANES)
    x = xp.cumsum(xp.where(ego, 3 * usual, 0.0) + usual * spread)
    y = lane * LANE_WIDTH
    timer, target_speed = (xp.where(ego, 0.0, row) for row in ((x + y) * math.pi % 1.0, speed))
    zero = 0 * x
    return xp.stack([x, y, zero, 1 + zero, zero, speed, timer, delta, target_speed, lane, lane, zero])
