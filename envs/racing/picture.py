"""Small pictures of the racing car: the green of Gymnasium's, without its drawing of every polygon.

The ground is painted once an episode. A picture looks at it in the car's frame. It shows what Gymnasium's
shows above the bar, after the first second, in which that zooms.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pygame
from gymnasium.envs.box2d.car_racing import GRASS_DIM, SCALE, WINDOW_H, WINDOW_W, ZOOM

from envs.encoders import Images
from envs.racing.environment import Car, Racing
from envs.spec import Array, Flags

SIDE = 48
"""Pixels of a side."""
HALF, CELL = 256.0, 0.5
"""Half a side of the ground, and a side of its cells [m]."""
BAR = WINDOW_H / 8
"""Height of the bar below Gymnasium's picture, in pixels of its window."""
CAR = 1.0, -2.4, 2.6
"""Half the width of a car that is a black rectangle, and its ends behind and ahead of its middle [m]."""


def ground(car: Car) -> Images:
    """Return the green (N, N) of Gymnasium's road, grass and kerbs by cells of x and y."""
    count = round(2 * HALF / CELL)
    surface = pygame.Surface((count, count), depth=8)
    surface.set_palette([(green, green, green) for green in range(256)])
    surface.fill([int(car.bg_color[1])] * 3)

    def fill(polygon: Any, colour: Any) -> None:
        corners = np.rint((np.array(polygon) + HALF) / CELL - 0.5)
        pygame.draw.polygon(surface, [int(colour[1])] * 3, corners.tolist())

    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    for x, y in np.ndindex(20, 20):
        fill(GRASS_DIM * (square + np.array([2 * x - 20, 2 * y - 20])), car.grass_color)
    for polygon, colour in car.road_poly:
        fill(polygon, colour)
    painted: Images = pygame.surfarray.array2d(surface).astype(np.uint8)
    return painted


def places(rows: int, columns: int) -> tuple[Array, Array]:
    """Return how far ahead rows (rows,) and to the left columns (columns,) of a picture are [m]."""
    down = (np.arange(rows) + 0.5) * (WINDOW_H - BAR) / rows
    right = (np.arange(columns) + 0.5) * WINDOW_W / columns
    return (0.75 * WINDOW_H - down) / (ZOOM * SCALE), (WINDOW_W / 2 - right) / (ZOOM * SCALE)


def look(painted: Images, pose: tuple[Array, Array, Array], rows: int, columns: int) -> Images:
    """Return a picture (rows, columns) of the ground from a pose (`Racing.pose`)."""
    ahead, left = places(rows, columns)
    x, y = (
        np.clip((here + HALF + ahead[:, None] * a + left * b) / CELL, 0, len(painted) - 1).astype(np.int32)
        for here, a, b in zip(*pose, strict=True)
    )
    seen: Images = painted[x, y]
    wide, back, front = CAR
    seen[np.ix_((ahead > back) & (ahead < front), np.abs(left) < wide)] = 0
    return seen


class View:
    """Copies of the car in pictures (48, 48, 1) (`envs.images.View`), with `Racing.numbers` beside. A pixel
    is the mean of four samples."""

    act_size = 3

    def __init__(self, count: int, turn: float = 0.0, friction: float = 1.0) -> None:
        self._racing = [Racing(turn, friction) for _ in range(count)]
        self._painted = [np.zeros((0, 0), np.uint8)] * count

    def reset(self, place: int, seed: int) -> tuple[Images, Array]:
        racing = self._racing[place]
        racing.reset(seed=seed)
        self._painted[place] = ground(racing.car)
        return self._image(place), racing.numbers()

    def step(self, places: Sequence[int], act: Array) -> tuple[Images, Array, Array, Flags]:
        racing = [self._racing[place] for place in places]
        paid = [one.advance(action.astype(np.float32)) for one, action in zip(racing, act, strict=True)]
        rewards, terminated = map(np.array, zip(*paid, strict=True))
        images = np.stack([self._image(place) for place in places])
        return images, np.stack([one.numbers() for one in racing]), rewards, terminated

    def why_ended(self, place: int) -> str:
        return self._racing[place].ending

    def _image(self, place: int) -> Images:
        fine = look(self._painted[place], self._racing[place].pose(), 2 * SIDE, 2 * SIDE).astype(np.uint16)
        high = fine[::2] + fine[1::2]
        return ((high[:, ::2] + high[:, 1::2]) // 4).astype(np.uint8)[..., None]
