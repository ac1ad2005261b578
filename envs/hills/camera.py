"""The car's camera: the distance and the road in 32 by 16 directions, without a renderer."""

import math

import numpy as np

from envs.encoders import Images
from envs.hills.environment import Drive, rotated
from envs.hills.tracks import HALF_WIDTH, height
from envs.spec import Array, Flags

ROWS, COLUMNS = 16, 32
WIDE, HIGH, DOWN = math.radians(90), math.radians(40), math.radians(12)  # fields of view, and pitch downwards
FARTHEST = 60.0  # m, the largest distance that is seen
OWN = 6  # first entries of an observation, which the car measures without a camera
DISTANCES = np.geomspace(0.5, FARTHEST, 40)
"""Distances [m] along a ray at which it is compared with the ground. Between them it is a line."""


def directions() -> Array:
    """Return the unit vectors of pixels (ROWS * COLUMNS, 3) ahead, to the left and up, the top left first."""
    left = math.tan(WIDE / 2) * (1 - (2 * np.arange(COLUMNS) + 1) / COLUMNS)
    up = math.tan(HIGH / 2) * (1 - (2 * np.arange(ROWS) + 1) / ROWS)
    z, y = (part.ravel() for part in np.meshgrid(up, left, indexing="ij"))
    cos, sin = math.cos(DOWN), math.sin(DOWN)
    rays = np.column_stack([cos + sin * z, y, cos * z - sin])
    return np.asarray(rays / np.sqrt(np.square(rays).sum(axis=1))[:, None])


RAYS = directions()


def seen(env: Drive) -> tuple[Array, Flags]:
    """Return distances (ROWS, COLUMNS) [m], `FARTHEST` where no ground is nearer, and whether the road is
    there."""
    (ahead,), (left,), (up,) = rotated(env.data.qpos[None, 3:7])
    eye = env.data.qpos[:3] + env.physics.camera * up
    rays = RAYS @ [ahead, left, up]
    x, y, z = (np.multiply.outer(DISTANCES, way) + start for start, way in zip(eye, rays.T, strict=True))
    above = z - height(env.track.terrain, x, y)
    first, pixels = (above <= 0).argmax(axis=0), np.arange(len(rays))
    high, low = above[first - 1, pixels], above[first, pixels]
    near, far = DISTANCES[first - 1], DISTANCES[first]
    hit = first > 0
    distance = np.where(hit, near + (far - near) * high / np.where(hit, high - low, 1.0), FARTHEST)
    places = eye[:2] + distance[:, None] * rays[:, :2]
    away, _ = env.track.tree.query(places, distance_upper_bound=HALF_WIDTH)
    shape = ROWS, COLUMNS
    return distance.reshape(shape), (np.isfinite(away) & hit).reshape(shape)


def picture(car: Drive) -> Images:
    """Return the camera's picture (ROWS, COLUMNS, 2): the distance [`FARTHEST` / 255], and 255 where the road
    is."""
    distance, road = seen(car)
    return np.stack([np.rint(distance * (255 / FARTHEST)), 255 * road], axis=-1).astype(np.uint8)
