"""Gymnasium's racing car without its pictures, seen in states. It needs Box2D."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.box2d.car_racing import TRACK_DETAIL_STEP, TRACK_WIDTH, CarRacing

from envs.racing.driver import AHEAD
from envs.scaled import scaled
from envs.spec import Array, Floats, Shape

NO_NUMBERS = {"Racing.scene": "It draws pictures."}

FRAMES = 4
"""Frames of Gymnasium's, 0.02 s each, that an action lasts."""
OBS_SIZE = 5 + 2 * len(AHEAD)
OUTLINE = np.array([(-1.2, -2.4), (-1.2, 1.6), (0.0, 2.6), (1.2, 1.6), (1.2, -2.4), (-1.2, -2.4)])
"""Corners of the car as it is drawn, to the left and ahead of its middle [m]."""


class Car(CarRacing):
    """Gymnasium's task without its observation, which is a picture. Physics, tracks and rewards are its own.

    turn: angle [rad] to the left by which the car starts askew. friction: of the road, 1 in Gymnasium's
    task, whose grass has 0.6.
    """

    def __init__(self, turn: float = 0.0, friction: float = 1.0) -> None:
        super().__init__()
        self._turn, self._friction = turn, friction

    def _render(self, mode: str) -> None:
        """Draw nothing."""

    def _create_track(self) -> bool:
        if not super()._create_track():  # type: ignore[no-untyped-call]
            return False
        alpha, angle, x, y = self.track[0]  # the car is put there next
        self.track[0] = (alpha, angle + self._turn, x, y)
        tiles: Any = self.road
        for tile in tiles:
            tile.road_friction = self._friction
        return True


class Racing(gym.Env[Floats, Floats]):
    """The car in states.

    Observation (17,): `envs.racing.carracing.OBS_NAMES`. Action (3,) in [-1, 1]: steering to the right, and
    gas and brake, which are 0 at -1. It lasts `FRAMES` of Gymnasium's frames, whose rewards are summed. An
    episode terminates as Gymnasium's does.
    """

    def __init__(self, turn: float = 0.0, friction: float = 1.0) -> None:
        self.car: Any = Car(turn, friction)
        self._native = scaled(self.car).action
        self.observation_space = spaces.Box(-np.inf, np.inf, (OBS_SIZE,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.centre = np.zeros((0, 2))
        self.ending = ""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed)
        self.car.reset(seed=int(self.np_random.integers(1 << 31)) if seed is None else seed)
        self.centre = np.array([place[2:] for place in self.car.track])
        return self.states(), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        reward, ended = self.advance(action)
        return self.states(), reward, ended, False, {}

    def advance(self, action: Floats) -> tuple[float, bool]:
        """Return the summed reward of an action's frames, and whether they terminated the episode."""
        act, total = self._native(action), 0.0
        for _ in range(FRAMES):
            _, reward, ended, _, info = self.car.step(act)
            total += float(reward)
            if ended:
                self.ending = "lap complete" if info["lap_finished"] else "left the field"
                return total, True
        return total, False

    def states(self) -> Floats:
        """Return what is observed, (17,)."""
        place, ahead, left = self.pose()
        hull, wheel, count = self.car.car.hull, self.car.car.wheels[0], len(self.centre)
        nearest = int(np.square(self.centre - place).sum(axis=1).argmin())
        along = self.centre[(nearest + 1) % count] - self.centre[nearest - 1]
        along /= math.hypot(*along)
        away = place - self.centre[nearest]
        number = nearest + (away @ along + np.array(AHEAD)) / TRACK_DETAIL_STEP
        whole = np.floor(number)
        share, first = (number - whole)[:, None], whole.astype(np.int64) % count
        road = (1 - share) * self.centre[first] + share * self.centre[(first + 1) % count] - place
        speed = np.array(hull.linearVelocity)
        own = speed @ ahead, speed @ left, hull.angularVelocity, wheel.joint.angle
        offset = along[0] * away[1] - along[1] * away[0]
        return np.array([*own, offset, *np.column_stack([road @ ahead, road @ left]).ravel()], np.float32)

    def numbers(self) -> Array:
        """Return what the bar in Gymnasium's picture shows, except the score, (7,).

        They are speed [m/s], the wheels' rates [rad/s], the front wheels' angle [rad] and the yaw rate
        [rad/s], both to the left.
        """
        car = self.car.car
        rates = [float(wheel.omega) for wheel in car.wheels]
        turning = car.wheels[0].joint.angle, car.hull.angularVelocity
        numbers = np.array([math.hypot(*car.hull.linearVelocity), *rates, *turning], np.float32)
        return numbers.astype(np.float64)

    def pose(self) -> tuple[Array, Array, Array]:
        """Return the car's place [m], and its directions ahead and to the left, (2,) each."""
        hull = self.car.car.hull
        x, y = hull.GetWorldVector((0, 1))
        return np.array(hull.position, np.float64), np.array([x, y]), np.array([-y, x])

    def scene(self) -> dict[str, Shape]:
        """Return a view from above, with the road's edges and the car, whose nose is a wedge."""
        ring = np.concatenate([self.centre, self.centre[:1]])
        ways = np.gradient(np.concatenate([self.centre[-1:], ring, self.centre[1:2]]), axis=0)[1:-1]
        out = TRACK_WIDTH * np.column_stack([-ways[:, 1], ways[:, 0]]) / np.hypot(*ways.T)[:, None]
        place, ahead, left = self.pose()
        return {
            "left_edge": Shape(ring + out, (140, 140, 140)),
            "right_edge": Shape(ring - out, (140, 140, 140)),
            "car": Shape(place + OUTLINE @ [left, ahead], (234, 134, 51)),
        }
