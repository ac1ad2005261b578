"""Many scenes of highway-env stepped together, bit for bit as highway-env steps them one by one.

Scenes are built by highway-env. From then on each is a row of arrays, the ego first, then the others in
highway-env's order: IDM drivers (Treiber et al. 2000) that change lanes by MOBIL (Kesting et al. 2007).
The arithmetic is highway-env's, in its order, for all vehicles at once. What it decides for one vehicle
after another, because each sees what those before it decided, is decided so here too.

It holds for straight parallel lanes from x = 0 whose end nobody reaches, without obstacles, where only the
ego checks for collisions. `Scenes.of` raises ValueError for anything else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any

import numpy as np
from highway_env.utils import are_polygons_intersecting
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from envs.driving.fast import FastIDM, FastRoad, FastVehicle
from envs.spec import Array

Ints = NDArray[np.int64]

NOBODY = -1
LANE_MARGIN = 1.0  # m beside its lane where a vehicle still counts as on it
ROUNDING = 1e-6  # m, more than any rounding of a distance
LENGTH, WIDTH = Vehicle.LENGTH, Vehicle.WIDTH


@dataclass(frozen=True)
class Road:
    """What scenes of N vehicles have in common."""

    lanes: Array
    """(L,): their y [m]."""
    width: float
    """Of a lane [m]."""
    limit: float
    """Speed limit [m/s]."""
    slowest: Array
    """(N,) [m/s]; what is slower has to speed up."""
    fastest: Array
    """(N,) [m/s]."""

    @classmethod
    def of(cls, road: Any, ego_speeds: tuple[float, float]) -> Road:
        """highway-env's road, with the ego's lowest and highest speed."""
        lanes = list(road.network.lanes_dict().values())
        slowest, fastest = (
            [bound, *[other] * (len(road.vehicles) - 1)]
            for bound, other in zip(ego_speeds, (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED), strict=True)
        )
        return cls(
            np.array([lane.start[1] for lane in lanes]),
            lanes[0].width,
            lanes[0].speed_limit,
            np.array(slowest),
            np.array(fastest),
        )


@dataclass
class Scenes:
    """R scenes of N vehicles, each array (R, N) unless it says otherwise."""

    x: Array
    """[m]"""
    y: Array
    """[m]"""
    heading: Array
    """[rad]"""
    speed: Array
    """[m/s]"""
    timer: Array
    """Since the last thought of changing lanes [s]."""
    delta: Array
    """Exponent of IDM."""
    target_speed: Array
    """[m/s]"""
    steering: Array
    """[rad]"""
    acceleration: Array
    """[m/s^2]"""
    lane: Ints
    """The closest one, by number."""
    target: Ints
    """The lane to be in, by number."""
    crashed: NDArray[np.bool_]
    impact: Array
    """(R, N, 2): by how much a collision will move it [m], NaN for not at all."""

    @classmethod
    def of(cls, road: Any) -> Scenes:
        """One scene of `FastHighwayEnv`, as it starts."""
        ego, *others = road.vehicles
        if (
            type(road) is not FastRoad
            or road.neighbour_vehicles_connected_lanes
            or any(lane.x0 != 0 for lane in road.network.lanes_dict().values())
            or type(ego) is not FastVehicle
            or any(type(v) is not FastIDM or v.check_collisions for v in others)
        ):
            raise ValueError("not a scene that can be stepped beside others")

        def column(get: Any) -> Any:
            return np.array([[get(vehicle) for vehicle in road.vehicles]])

        return cls(
            x=column(lambda v: v.position[0]),
            y=column(lambda v: v.position[1]),
            heading=column(lambda v: float(v.heading)),
            speed=column(lambda v: float(v.speed)),
            timer=column(lambda v: float(getattr(v, "timer", 0))),
            delta=column(lambda v: float(getattr(v, "DELTA", 0))),
            # A driver without a desired speed has 0 of it, says highway-env.
            target_speed=column(lambda v: float(getattr(v, "target_speed", 0))),
            steering=column(lambda v: 0.0),
            acceleration=column(lambda v: 0.0),
            lane=column(lambda v: v.lane_index[2]),
            target=column(lambda v: getattr(v, "target_lane_index", v.lane_index)[2]),
            crashed=column(lambda v: False),
            impact=np.full((1, len(road.vehicles), 2), np.nan),
        )

    def __getitem__(self, rows: Ints) -> Scenes:
        return Scenes(*(getattr(self, field.name)[rows] for field in fields(self)))

    def __setitem__(self, rows: Ints, scenes: Scenes) -> None:
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(scenes, field.name)

    def step(self, road: Road, dt: float) -> None:
        """Everybody decides, then moves for `dt` seconds; the ego's steering [rad] and acceleration [m/s^2],
        `[:, 0]` of these arrays, are as they were set."""
        _Decisions(self, road).take()
        self._move(road, dt)
        for row, other in zip(*self._close(dt), strict=True):
            self._collide(row, other, dt)

    def on_road(self, road: Road) -> NDArray[np.bool_]:
        """(R, N): whether it is on its lane."""
        on_lane: NDArray[np.bool_] = np.abs(self.y - road.lanes[self.lane]) <= road.width / 2
        return on_lane

    def _move(self, road: Road, dt: float) -> None:
        """The bicycle model of `Vehicle.step`."""
        self.timer += dt
        self.steering[self.crashed] = 0.0
        self.acceleration[self.crashed] = -1.0 * self.speed[self.crashed]
        fast, slow = self.speed > road.fastest, self.speed < road.slowest
        acceleration = np.where(
            fast, np.minimum(self.acceleration, road.fastest - self.speed), self.acceleration
        )
        self.acceleration = np.where(slow, np.maximum(acceleration, road.slowest - self.speed), acceleration)
        slip = np.arctan(1 / 2 * np.tan(self.steering))
        self.x = self.x + self.speed * np.cos(self.heading + slip) * dt
        self.y = self.y + self.speed * np.sin(self.heading + slip) * dt
        pushed = ~np.isnan(self.impact[..., 0])
        if pushed.any():
            self.x[pushed] += self.impact[pushed, 0]
            self.y[pushed] += self.impact[pushed, 1]
            self.crashed = self.crashed | pushed
            self.impact[pushed] = np.nan
        self.heading = self.heading + self.speed * np.sin(slip) / (LENGTH / 2) * dt
        self.speed = self.speed + self.acceleration * dt
        turn = np.abs(_wrap_to_pi(self.heading))
        self.lane = (np.abs(self.y[..., None] - road.lanes) + turn[..., None]).argmin(axis=-1)

    def _close(self, dt: float) -> tuple[list[int], list[int]]:
        """Scenes, and vehicles in them that may touch the ego within `dt`: no side of either lies between."""
        away = np.stack([self.x[:, 1:] - self.x[:, :1], self.y[:, 1:] - self.y[:, :1]], axis=-1)
        reach = math.hypot(LENGTH, WIDTH) + np.abs(self.speed[:, :1]) * dt + ROUNDING
        rows, others = np.nonzero((np.abs(away) < reach[..., None]).all(axis=-1))
        away, others = away[rows, others], others + 1
        sides, swept = [], np.zeros_like(away)
        for sign, who in ((1, np.zeros_like(others)), (-1, others)):
            cos, sin = np.cos(self.heading[rows, who]), np.sin(self.heading[rows, who])
            ahead, left = np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)
            swept += sign * dt * self.speed[rows, who, None] * ahead
            sides += [(ahead, LENGTH / 2), (left, WIDTH / 2)]
        apart = np.zeros(len(rows), bool)
        for normal, _ in sides:
            extent = sum(half * np.abs((side * normal).sum(axis=-1)) for side, half in sides)
            gap = np.abs((away * normal).sum(axis=-1)) - extent - np.abs((swept * normal).sum(axis=-1))
            apart |= gap > ROUNDING
        return rows[~apart].tolist(), others[~apart].tolist()

    def _collide(self, row: int, other: int, dt: float) -> None:
        """`RoadObject.handle_collisions` of the ego with another."""
        ego, them = (
            SimpleNamespace(
                LENGTH=LENGTH,
                WIDTH=WIDTH,
                heading=self.heading[row, i],
                position=np.array([self.x[row, i], self.y[row, i]]),
                moved=self.speed[row, i]
                * np.array([np.cos(self.heading[row, i]), np.sin(self.heading[row, i])])
                * dt,
            )
            for i in (0, other)
        )
        reach = np.sqrt(LENGTH**2 + WIDTH**2) + self.speed[row, 0] * dt
        if np.linalg.norm(them.position - ego.position) > reach:
            return
        touching, will_touch, push = are_polygons_intersecting(
            Vehicle.polygon(ego), Vehicle.polygon(them), ego.moved, them.moved
        )
        if will_touch:
            self.impact[row, 0], self.impact[row, other] = push / 2, -push / 2
        if touching:
            self.crashed[row, [0, other]] = True


class _Decisions:
    """What the drivers of scenes decide, in place. Vehicles are named by arrays (M,) of rows and columns."""

    def __init__(self, scenes: Scenes, road: Road) -> None:
        self.scenes, self.road = scenes, road
        self.driving = ~scenes.crashed
        self.driving[:, 0] = False
        self.direction = np.stack([np.cos(scenes.heading), np.sin(scenes.heading)], axis=-1)
        self.velocity = scenes.speed[..., None] * self.direction
        aside = np.abs(scenes.y[..., None] - road.lanes)
        self.on_lane = aside <= road.width / 2 + LANE_MARGIN
        self.columns = np.arange(scenes.x.shape[1])

    def take(self) -> None:
        scenes, (rows, who) = self.scenes, np.nonzero(self.driving)
        self._change_lanes()
        steering = self._steering()
        scenes.steering[rows, who] = steering[rows, who]
        lane, target = scenes.lane[rows, who], scenes.target[rows, who]
        acceleration = self._idm(rows, who, who, self._neighbours(rows, who, lane)[0])
        both = np.flatnonzero(lane != target)
        r, w = rows[both], who[both]
        there = self._idm(r, w, w, self._neighbours(r, w, target[both])[0])
        acceleration[both] = np.minimum(acceleration[both], there)
        scenes.acceleration[rows, who] = np.clip(acceleration, -IDMVehicle.ACC_MAX, IDMVehicle.ACC_MAX)

    def _change_lanes(self) -> None:
        """`IDMVehicle.change_lane_policy`, in the order of the vehicles."""
        scenes = self.scenes
        changing = self.driving & (scenes.lane != scenes.target)
        due = self.driving & ~changing & (scenes.timer > IDMVehicle.LANE_CHANGE_DELAY)
        scenes.timer[due] = 0.0
        before, after = scenes.target, scenes.target.copy()
        rows, who = np.nonzero(due & (np.abs(scenes.speed) >= 1))
        for side in (-1, 1):
            lane = scenes.lane[rows, who] + side
            there = (lane >= 0) & (lane < len(self.road.lanes))
            r, w, lane = rows[there], who[there], lane[there]
            better = self._mobil(r, w, lane) & (
                np.abs(scenes.y[r, w] - self.road.lanes[lane]) <= 2 * self.road.width
            )
            after[r[better], w[better]] = lane[better]
        for i in np.flatnonzero(changing.any(axis=0)):
            # Abort where somebody else close ahead is changing into the same lane.
            rows = np.flatnonzero(changing[:, i])
            goal = before[rows, i, None]
            decided = np.where(self.columns < i, after[rows], before[rows])
            rival = (decided == goal) & (scenes.lane[rows] != goal) & (self.columns != i) & (self.columns > 0)
            ahead = scenes.x[rows] - scenes.x[rows, i, None]
            r, w = np.nonzero(rival & (ahead > 0))
            close = ahead[r, w] < self._desired_gap(rows[r], np.full_like(r, i), w)
            aborting = rows[r[close]]
            after[aborting, i] = scenes.lane[aborting, i]
        scenes.target = after

    def _mobil(self, rows: Ints, who: Ints, lane: Ints) -> NDArray[np.bool_]:
        """`IDMVehicle.mobil` of drivers who do not care for those behind them in their own lane."""
        ahead, behind = self._neighbours(rows, who, lane)
        imposed = np.where(behind == NOBODY, 0.0, self._idm(rows, who, behind, who))
        now_ahead, _ = self._neighbours(rows, who, self.scenes.lane[rows, who])
        gain = self._idm(rows, who, who, ahead) - self._idm(rows, who, who, now_ahead)
        safe = imposed >= -IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
        return np.asarray(safe & (gain >= IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN))

    def _steering(self) -> Array:
        """(R, N): `ControlledVehicle.steering_control` towards the target lane."""
        scenes = self.scenes
        speed = _not_zero(scenes.speed)
        lateral = scenes.y - self.road.lanes[scenes.target]
        aim = np.arcsin(np.clip(-IDMVehicle.KP_LATERAL * lateral / speed, -1, 1))
        turn = IDMVehicle.KP_HEADING * _wrap_to_pi(np.clip(aim, -np.pi / 4, np.pi / 4) - scenes.heading)
        slip = np.arcsin(np.clip(LENGTH / 2 / speed * turn, -1, 1))
        most = IDMVehicle.MAX_STEERING_ANGLE
        steering: Array = np.clip(np.arctan(2 * np.tan(slip)), -most, most)
        return steering

    def _neighbours(self, rows: Ints, who: Ints, lane: Ints) -> tuple[Ints, Ints]:
        """Who is ahead and who is behind in a lane; of several at one place the last and the first."""
        x = self.scenes.x[rows]
        here = self.scenes.x[rows, who, None]
        there = self.on_lane[rows, :, lane] & (self.columns != who[:, None])
        ahead = np.where(there & (x >= here), x, np.inf)[:, ::-1]
        behind = np.where(there & (x < here), x, -np.inf)
        front, rear = ahead.argmin(axis=1), behind.argmax(axis=1)
        each = np.arange(len(rows))
        return (
            np.where(ahead[each, front] < np.inf, self.columns[-1] - front, NOBODY),
            np.where(behind[each, rear] > -np.inf, rear, NOBODY),
        )

    def _idm(self, rows: Ints, judge: Ints, who: Ints, front: Ints) -> Array:
        """(M,): `judge`'s idea of the acceleration of `who` behind `front`."""
        scenes = self.scenes
        target = _not_zero(np.clip(scenes.target_speed[rows, who], 0, self.road.limit))
        ratio = np.maximum(scenes.speed[rows, who], 0) / np.abs(target)
        acceleration = IDMVehicle.COMFORT_ACC_MAX * (1 - np.power(ratio, scenes.delta[rows, judge]))
        distance = _not_zero(scenes.x[rows, front] - scenes.x[rows, who])
        ratio = self._desired_gap(rows, who, front) / distance
        braking = IDMVehicle.COMFORT_ACC_MAX * (ratio * ratio)  # as numpy squares
        behind: Array = np.where(front == NOBODY, acceleration, acceleration - braking)
        return behind

    def _desired_gap(self, rows: Ints, who: Ints, front: Ints) -> Array:
        speed = self.scenes.speed[rows, who]
        apart = self.velocity[rows, who] - self.velocity[rows, front]
        closing = np.vecdot(apart, self.direction[rows, who])
        braking = np.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
        gap: Array = (
            IDMVehicle.DISTANCE_WANTED + speed * IDMVehicle.TIME_WANTED + speed * closing / (2 * braking)
        )
        return gap


def _not_zero(values: Array) -> Array:
    return np.where(np.abs(values) > 1e-2, values, np.where(values >= 0, 1e-2, -1e-2))


def _wrap_to_pi(angles: Array) -> Array:
    wrapped: Array = ((angles + np.pi) % (2 * np.pi)) - np.pi
    return wrapped
