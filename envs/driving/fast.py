"""highway-env's `HighwayEnvFast`, bit-identical and several times faster.

Scenes are built wholly by highway-env. Then every object whose type is exactly the one expected is given
a subclass of that type: the same attributes, the same arithmetic in the same order, less overhead.
Whatever does not fit (another observation, curved lanes, connected lanes, obstacles, other drivers)
keeps highway-env's own methods.

What is kept from numpy, such as cosines, powers and dot products, is kept on purpose: `math` may round
the last bit differently.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import Any

import numpy as np
from highway_env.envs.common.observation import KinematicObservation
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.utils import not_zero, wrap_to_pi
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

FEATURES = {"presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "long_off", "lat_off", "ang_off"}
"""The observation features that the fast observation knows."""


class FastHighwayEnv(HighwayEnvFast):  # type: ignore[misc]
    """`HighwayEnvFast` with the same configuration, results and random streams, only faster."""

    def _reset(self) -> None:
        super()._reset()
        _speed_up(self.road)

    def define_spaces(self) -> None:
        super().define_spaces()
        view = self.observation_type
        known = type(view) is KinematicObservation and view.vehicles_count > 1 and view.features_range
        if known and FEATURES.issuperset(view.features):
            view.__class__ = _FastKinematics


def _speed_up(road: Any) -> None:
    """Give the road, its lanes and its vehicles their faster classes, where the assumptions hold."""
    lanes = road.network.lanes_dict()
    straight = all(
        type(lane) is StraightLane and lane.direction.tolist() == [1, 0] for lane in lanes.values()
    )
    if not straight or road.objects or type(road) is not Road or type(road.network) is not RoadNetwork:
        return
    for lane in lanes.values():
        lane.__class__ = _AlignedLane
        lane.x0, lane.y0 = lane.start.tolist()
    road.network.__class__ = _AlignedNetwork
    road.network.lane_of = lanes
    road.__class__ = FastRoad
    road.scene = None
    for vehicle in road.vehicles:
        speed_up_vehicle(vehicle)


def speed_up_vehicle(vehicle: Any) -> None:
    """Give one vehicle on a fast road its faster class, if there is one."""
    fast = {Vehicle: FastVehicle, MDPVehicle: _FastMDP, IDMVehicle: FastIDM}
    if type(vehicle.road) is FastRoad and type(vehicle) in fast:
        vehicle.__class__ = fast[type(vehicle)]
        # What highway-env drew are numpy's scalars, several times slower than floats.
        for name in {"heading", "speed", "target_speed", "timer", "DELTA"} & vars(vehicle).keys():
            setattr(vehicle, name, float(getattr(vehicle, name)))


class _AlignedLane(StraightLane):  # type: ignore[misc]
    """A straight lane along the x axis from (x0, y0)."""

    x0: float
    y0: float

    def local_coordinates(self, position: NDArray[np.float64]) -> tuple[float, float]:
        x, y = position.tolist()
        return x - self.x0, y - self.y0


class _AlignedNetwork(RoadNetwork):  # type: ignore[misc]
    """Aligned lanes only, listed once."""

    lane_of: dict[tuple[str, str, int], _AlignedLane]

    def get_closest_lane_index(
        self, position: NDArray[np.float64], heading: float | None = None
    ) -> tuple[str, str, int]:
        if heading is None:
            return super().get_closest_lane_index(position)  # type: ignore[no-any-return]
        x, y = position.tolist()
        turn = abs(wrap_to_pi(heading))
        best, least = None, math.inf
        for key, lane in self.lane_of.items():
            # Added in highway-env's order: a sum rounded otherwise could pick another lane.
            distance = abs(y - lane.y0)
            if not 0 <= x - lane.x0 <= lane.length:
                distance += max(x - lane.x0 - lane.length, 0) + max(lane.x0 - x, 0)
            distance += turn
            if distance < least:
                best, least = key, distance
        return best if best is not None else super().get_closest_lane_index(position, heading)


class _Scene:
    """What does not change while the vehicles of a road decide: who is where, and how fast."""

    def __init__(self, vehicles: list[Any]) -> None:
        self.vehicles = vehicles
        self.positions = [vehicle.position.tolist() for vehicle in vehicles]
        for place, vehicle in enumerate(vehicles):
            vehicle.place = place
        headings = np.array([vehicle.heading for vehicle in vehicles])
        self.straight = (headings == 0).tolist()
        self.directions = np.stack([np.cos(headings), np.sin(headings)], axis=1)
        self.velocities = np.array([[vehicle.speed] for vehicle in vehicles]) * self.directions
        self.forward = self.velocities[:, 0].tolist()
        self.lanes: dict[_AlignedLane, tuple[list[float], list[Any]]] = {}

    def on_lane(self, lane: _AlignedLane) -> tuple[list[float], list[Any]]:
        """Distances along the lane [m] of everyone within 1 m of it, ascending, and who they are."""
        found = self.lanes.get(lane)
        if found is None:
            reach = lane.width / 2 + 1
            first, last = -lane.VEHICLE_LENGTH, lane.length + lane.VEHICLE_LENGTH
            there = [
                (x - lane.x0, place)
                for place, (x, y) in enumerate(self.positions)
                if abs(y - lane.y0) <= reach and first <= x - lane.x0 < last
            ]
            there.sort()
            found = [along for along, _ in there], [self.vehicles[place] for _, place in there]
            self.lanes[lane] = found
        return found

    def closing_speed(self, vehicle: Any, front: Any) -> float:
        """By how much `vehicle` is faster than the one in front [m/s], in its own direction."""
        i, j = vehicle.place, front.place
        if self.straight[i]:
            return self.forward[i] - self.forward[j]  # type: ignore[no-any-return]
        return float(np.dot(self.velocities[i] - self.velocities[j], self.directions[i]))


class FastRoad(Road):  # type: ignore[misc]
    """A road of aligned lanes without obstacles."""

    scene: _Scene | None
    """Set while the vehicles decide, for positions change in `step`."""

    def act(self) -> None:
        self.scene = None if self.objects else _Scene(self.vehicles)
        try:
            super().act()
        finally:
            self.scene = None

    def step(self, dt: float) -> None:
        if self.objects:
            super().step(dt)
            return
        for vehicle in self.vehicles:
            vehicle.step(dt)
        checking = [i for i, vehicle in enumerate(self.vehicles) if vehicle.check_collisions]
        everyone = range(len(self.vehicles))
        along = [vehicle.position.item(0) for vehicle in self.vehicles]
        for i, vehicle in enumerate(self.vehicles):
            for j in everyone[i + 1 :] if vehicle.check_collisions else [j for j in checking if j > i]:
                other = self.vehicles[j]
                near = (vehicle.diagonal + other.diagonal) / 2 + vehicle.speed * dt
                # The margin covers the rounding of highway-env's own distance, which is at least this one.
                if not abs(along[j] - along[i]) > near + 1e-6:
                    vehicle.handle_collisions(other, dt)

    def neighbour_vehicles(
        self, vehicle: Any, lane_index: tuple[str, str, int] | None = None
    ) -> tuple[Any, Any]:
        lane_index = lane_index or vehicle.lane_index
        if self.scene is None or self.neighbour_vehicles_connected_lanes or not lane_index:
            return super().neighbour_vehicles(vehicle, lane_index)  # type: ignore[no-any-return]
        lane = self.network.lane_of[lane_index]
        here = self.scene.positions[vehicle.place][0] - lane.x0
        distances, vehicles = self.scene.on_lane(lane)
        # Of several at the same place highway-env takes the last in front and the first behind.
        split = bisect_left(distances, here)
        front, nearest, rear = None, math.inf, None
        for i in range(split, len(distances)):
            if vehicles[i] is vehicle:
                continue
            if distances[i] > nearest:
                break
            front, nearest = vehicles[i], distances[i]
        if split:
            rear = vehicles[bisect_left(distances, distances[split - 1])]
        return front, rear


class _FastStep(Vehicle):  # type: ignore[misc]
    """The bicycle model of `Vehicle` in scalars."""

    impact: NDArray[np.float64] | None
    speed: float
    place: int
    """In the road's scene."""

    def step(self, dt: float) -> None:
        self.clip_actions()
        steering, speed = self.action["steering"], self.speed
        if steering == 0 == self.heading:
            slip, cos, sin = 0.0, 1.0, 0.0
        else:
            slip = float(np.arctan(1 / 2 * np.tan(steering)))
            cos, sin = float(np.cos(self.heading + slip)), float(np.sin(self.heading + slip))
        self.position[0] += speed * cos * dt
        self.position[1] += speed * sin * dt
        if self.impact is not None:
            self.position += self.impact
            self.crashed = True
            self.impact = None
        self.heading += speed * (float(np.sin(slip)) if slip else slip) / (self.LENGTH / 2) * dt
        self.speed = speed + self.action["acceleration"] * dt
        self.on_state_update()


class FastVehicle(_FastStep):
    """`Vehicle`: driven from outside."""


class _FastMDP(MDPVehicle, _FastStep):  # type: ignore[misc]
    """`MDPVehicle`: driven by meta-actions."""


class FastIDM(IDMVehicle, _FastStep):  # type: ignore[misc]
    """`IDMVehicle` in scalars. Lane changes are decided by highway-env's own method."""

    def act(self, action: Any = None) -> None:
        if self.crashed:
            return
        lane = self.road.network.lane_of[self.target_lane_index]
        if self.position.item(0) - lane.x0 > lane.length - lane.VEHICLE_LENGTH / 2:
            self.follow_road()
        # When neither holds, highway-env's method does nothing.
        due = self.lane_index != self.target_lane_index or self.timer > self.LANE_CHANGE_DELAY
        if self.enable_lane_change and due:
            self.change_lane_policy()
        steering = self.steering_control(self.target_lane_index)
        front, _ = self.road.neighbour_vehicles(self, self.lane_index)
        acceleration = self.acceleration(self, front)
        if self.lane_index != self.target_lane_index:
            front, _ = self.road.neighbour_vehicles(self, self.target_lane_index)
            acceleration = min(acceleration, self.acceleration(self, front))
        acceleration = _clip(acceleration, -self.ACC_MAX, self.ACC_MAX)
        self.action = {"steering": steering, "acceleration": acceleration}

    def steering_control(self, target_lane_index: tuple[str, str, int]) -> float:
        lane = self.road.network.lane_of[target_lane_index]
        lateral = self.position.item(1) - lane.y0
        if lateral == 0 == self.heading:
            return 0.0
        speed = not_zero(self.speed)
        aim = float(np.arcsin(_clip(-self.KP_LATERAL * lateral / speed, -1, 1)))
        turn = self.KP_HEADING * wrap_to_pi(_clip(aim, -np.pi / 4, np.pi / 4) - self.heading)
        slip = float(np.arcsin(_clip(self.LENGTH / 2 / speed * turn, -1, 1)))
        return _clip(float(np.arctan(2 * np.tan(slip))), -self.MAX_STEERING_ANGLE, self.MAX_STEERING_ANGLE)

    def acceleration(self, ego_vehicle: Any, front_vehicle: Any = None, rear_vehicle: Any = None) -> float:
        if ego_vehicle is None:
            return 0.0
        scene, lane, speed = self.road.scene, ego_vehicle.lane, ego_vehicle.speed
        if scene is None:
            return float(super().acceleration(ego_vehicle, front_vehicle, rear_vehicle))
        target = getattr(ego_vehicle, "target_speed", 0)
        if lane.speed_limit is not None:
            target = _clip(target, 0, lane.speed_limit)
        ratio = max(speed, 0) / abs(not_zero(target))
        acceleration = self.COMFORT_ACC_MAX * (1 - float(np.power(ratio, self.DELTA)))
        if front_vehicle is not None:
            positions = scene.positions
            here = positions[ego_vehicle.place][0] - lane.x0
            there = positions[front_vehicle.place][0] - lane.x0
            closing = scene.closing_speed(ego_vehicle, front_vehicle)
            braking = math.sqrt(-self.COMFORT_ACC_MAX * self.COMFORT_ACC_MIN)  # exact, as every square root
            gap = self.DISTANCE_WANTED + speed * self.TIME_WANTED + speed * closing / (2 * braking)
            ratio = gap / not_zero(there - here)
            acceleration -= self.COMFORT_ACC_MAX * (ratio * ratio)  # as numpy squares
        return float(acceleration)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


class _FastKinematics(KinematicObservation):  # type: ignore[misc]
    """`KinematicObservation` of the known `FEATURES`, without data frames."""

    def observe(self) -> NDArray[np.float32]:
        road, ego = self.env.road, self.observer_vehicle
        if type(road) is not FastRoad or road.objects:
            return super().observe()  # type: ignore[no-any-return]
        origin = self._values(ego)
        rows = [origin]
        for other in self._others(ego):
            values = self._values(other)
            if not self.absolute:
                for name in ("x", "y", "vx", "vy"):
                    values[name] -= origin[name]
            rows.append(values)
        obs = np.zeros((self.vehicles_count, len(self.features)))
        for row, values in zip(obs, rows, strict=False):
            row[:] = [self._scaled(name, values[name]) for name in self.features]
        if self.order == "shuffled":
            self.env.np_random.shuffle(obs[1:])
        return obs.astype(np.float32)

    def _others(self, ego: Any) -> list[Any]:
        """The vehicles shown besides the ego, in the order of the rows."""
        x, y = ego.position.tolist()
        reach = self.env.PERCEPTION_DISTANCE
        ahead = []
        for vehicle in self.env.road.vehicles:
            along = vehicle.position.item(0) - x
            if vehicle is ego or not (self.see_behind or along > -2 * ego.LENGTH):
                continue
            square = along**2 + (vehicle.position.item(1) - y) ** 2
            near = square < (reach - 1e-6) ** 2
            # Only where rounding could matter is highway-env's own norm worth its cost.
            if near or (
                square < (reach + 1e-6) ** 2 and np.linalg.norm(vehicle.position - ego.position) < reach
            ):
                ahead.append((abs(along), vehicle))
        if self.order == "sorted":
            ahead.sort(key=lambda pair: pair[0])
        return [vehicle for _, vehicle in ahead[: self.vehicles_count - 1]]

    def _values(self, vehicle: Any) -> dict[str, float]:
        x, y = vehicle.position.tolist()
        cos, sin = float(np.cos(vehicle.heading)), float(np.sin(vehicle.heading))
        values = {"presence": 1.0, "x": x, "y": y, "cos_h": cos, "sin_h": sin, "heading": vehicle.heading}
        values["vx"], values["vy"] = vehicle.speed * cos, vehicle.speed * sin
        lane = vehicle.lane
        values["long_off"], values["lat_off"] = x - lane.x0, y - lane.y0
        values["ang_off"] = wrap_to_pi(vehicle.heading - lane.heading)
        return values

    def _scaled(self, name: str, value: float) -> float:
        if not self.normalize or name not in self.features_range:
            return value
        low, high = self.features_range[name]
        scaled = -1 + (value - low) * 2 / (high - low)
        return _clip(scaled, -1, 1) if self.clip else scaled
