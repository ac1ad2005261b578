"""Roads over hills, drawn at random: a closed loop each, on a height field."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from envs.spec import Array

HALF = 84.0  # m, half of the side of the square of terrain, centred on 0
CELLS = 64  # rows and columns of the height field
RELIEF = 14.0  # m, height of the height field's box
HILLS, HILL = 8, 3.0  # number of waves, and m, sum of their heights in the root of squares
SHORT, LONG = 45.0, 150.0  # m, wavelengths
POINTS = 256  # of a road's centre line
RADIUS, WAVES = 48.0, (9.0, 7.0, 4.5, 3.0)  # m, mean radius, and largest waves of 2, 3, 4 and 5 a turn
TIGHTEST = 14.0  # m, smallest radius of a curve
HALF_WIDTH = 4.0  # m, of the road
REACH = 6  # points to both sides of the last one, among which the nearest one is looked for
_DRAWN = 512  # points of a loop before it is cut into equal lengths


@dataclass(frozen=True)
class Track:
    """A road and its terrain.

    `points`: (POINTS, 2), the centre line [m], at equal distances along it.
    `tangents`: (POINTS, 2), unit vectors along the road. `spacing`: distance of neighbours [m].
    `terrain`: (CELLS, CELLS), heights [m] in [0, RELIEF], rows along y. `rises`: (POINTS,), the road's
    heights [m].
    """

    points: Array
    tangents: Array
    spacing: float
    terrain: Array
    rises: Array

    @cached_property
    def tree(self) -> KDTree:
        """The points, to find the nearest one of any place."""
        return KDTree(self.points)


def draw_track(rng: np.random.Generator) -> Track:
    """Return a random track. Half of the loops turn left, half right."""
    angles = np.linspace(0.0, 2 * math.pi, _DRAWN + 1)
    while True:
        sizes, phases = rng.uniform(-1, 1, len(WAVES)) * WAVES, rng.uniform(0, 2 * math.pi, len(WAVES))
        turns = np.arange(2, 2 + len(WAVES))[:, None] * angles + phases[:, None]
        radius = RADIUS + sizes @ np.cos(turns)
        loop = radius[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        lengths = np.concatenate([[0.0], np.hypot(*np.diff(loop, axis=0).T).cumsum()])
        at = np.arange(POINTS) * (lengths[-1] / POINTS)
        points = np.column_stack([np.interp(at, lengths, column) for column in loop.T])
        ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
        tangents = ahead / np.hypot(*ahead.T)[:, None]
        bends = cross(np.roll(tangents, 1, axis=0), np.roll(tangents, -1, axis=0))
        spacing = float(lengths[-1] / POINTS)
        if np.abs(bends).max() * TIGHTEST <= 2 * spacing:
            break
    if rng.random() < 0.5:
        points, tangents = points * [1, -1], tangents * [1, -1]
    terrain = draw_terrain(rng)
    return Track(points, tangents, spacing, terrain, height(terrain, *points.T))


def draw_terrain(rng: np.random.Generator) -> Array:
    """Return random heights (CELLS, CELLS) [m]: a sum of waves of all directions."""
    line = np.linspace(-HALF, HALF, CELLS)
    number = 2 * math.pi / rng.uniform(SHORT, LONG, HILLS)
    way, phase = rng.uniform(0, 2 * math.pi, (2, HILLS))
    size = HILL * rng.dirichlet(np.ones(HILLS)) ** 0.5
    # cos(a + b) = cos a cos b - sin a sin b
    a, b = np.outer(line, number * np.cos(way)) + phase, np.outer(line, number * np.sin(way))
    waves = (size * np.cos(b)) @ np.cos(a).T - (size * np.sin(b)) @ np.sin(a).T
    return np.asarray(np.clip(waves + RELIEF / 2, 0.0, RELIEF))


def height(terrain: Array, x: Array, y: Array) -> Array:
    """Return the terrain's heights (...,) [m] at places (...,) [m], between grid points bilinearly. The
    heights of the edge go on outside."""
    scale, last = (CELLS - 1) / (2 * HALF), CELLS - 1.000001
    column, row = (np.clip((part + HALF) * scale, 0, last) for part in (x, y))
    left, below = column.astype(np.int32), row.astype(np.int32)
    first, grid = below * CELLS + left, terrain.ravel()
    right, above = column - left, row - below
    low = grid.take(first) * (1 - right) + grid.take(first + 1) * right
    high = grid.take(first + CELLS) * (1 - right) + grid.take(first + CELLS + 1) * right
    return np.asarray(low * (1 - above) + high * above)


def nearest(points: Array, last: NDArray[np.int64], at: Array) -> NDArray[np.int64]:
    """Return the number (B,) of the point of each centre line (B, POINTS, 2) that is nearest to a place
    (B, 2), within `REACH` of the last one (B,)."""
    near = (last[:, None] + np.arange(-REACH, REACH + 1)) % POINTS
    rows = np.arange(len(at))
    away = points[rows[:, None], near] - at[:, None]
    found: NDArray[np.int64] = near[rows, np.square(away).sum(axis=2).argmin(axis=1)]
    return found


def cross(one: Array, other: Array) -> Array:
    """Return the third component (...,) of cross products of vectors' first two, (..., 2 or 3)."""
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
