"""The traffic of highway-env, many scenes at once, compiled by JAX.

Others drive by IDM (Treiber et al. 2000) and change lanes by MOBIL (Kesting et al. 2007). Only the ego
collides. The lanes' ends are out of reach. In 64 bits the arithmetic equals highway-env's up to the last
bits. Events are the same, and positions differ by less than 1e-9 m over an episode.

All functions are pure, work in the precision of the state (R, 12, N), and may be part of larger programs.
Inside, arrays are (N, R) or (lane, N, R), because XLA's loops run along the last axis. Loops over vehicles
are unrolled. 13 and 19 vehicles compile in seconds, `observe` with 31 in minutes.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from envs.driving import scene as road
from envs.driving.observing import scene_of
from envs.driving.scene import Scene

SPEEDS = (-40.0, 40.0)  # m/s, of drivers
MARGIN = 1e-6  # m, more than any rounding of a distance
MOST, COMFORTABLE, BRAKING = 6.0, 3.0, 5.0  # m/s^2, of IDM
DISTANCE, TIME_GAP = 10.0, 1.5  # m, s, that IDM maintains
DELAY, GAIN, IMPOSED = 1.0, 0.2, 2.0  # s, m/s^2, m/s^2, of MOBIL
NEAR_LANE = road.LANE_WIDTH / 2 + 1  # m beside a lane's middle where a vehicle still counts as on it
TAU_LATERAL, TAU_HEADING = 0.6, 0.2  # s, of a driver's steering
MOST_SLIP = math.sin(math.atan(math.tan(math.pi / 3) / 2))  # its sine, at the largest steering angle


def step(
    state: Array, act: Array, lanes: int = road.LANES, dt: float = road.DT, frames: int = road.FRAMES
) -> Array:
    """Return states (R, 12, N) after actions (R, 2)."""
    scene = scene_of(state)
    pedal, wheel = _controls(act, state.dtype)
    slope = jnp.tan(wheel) / 2
    slip = slope / jnp.sqrt(1 + slope * slope)

    def frame(_: int, carry: Any) -> Any:
        scene, pedal, view = carry
        scene, pedal = _move(scene, pedal, slip, view, lanes, dt)
        return scene, pedal, _view(scene, lanes)

    scene, *_ = lax.fori_loop(0, frames, frame, (scene, pedal, _view(scene, lanes)))
    scene = scene._replace(crashed=_collide(scene, dt)[0])
    return jnp.moveaxis(jnp.stack(scene), -1, 0)


def _view(scene: Scene, lanes: int) -> tuple[Array, Array]:
    """Return log ratios of speeds to desired ones (N, R), and positions on each lane, else NaN, (L, N, R)."""
    limit = jnp.abs(_not_zero(jnp.clip(scene.target_speed, 0, road.SPEED_LIMIT)))
    number = jnp.arange(lanes, dtype=scene.x.dtype)[:, None, None]
    places = jnp.where(jnp.abs(scene.y - road.LANE_WIDTH * number) <= NEAR_LANE, scene.x, jnp.nan)
    return jnp.log(jnp.maximum(scene.speed, 0) / limit), places


def _controls(act: Array, dtype: Any) -> list[Array]:
    """Return accelerations (R,) and steering angles, in 32 bits like highway-env's actions."""
    share = jnp.clip(act.astype(jnp.float32), -1, 1).T + 1
    # The minimum changes no value. It keeps XLA from fusing product and sum, whose rounding would differ.
    return [
        (jnp.minimum(part * np.float32(2 * size) / 2, np.float32(2 * size)) - np.float32(size)).astype(dtype)
        for part, size in zip(share, (road.PEDAL, road.WHEEL), strict=True)
    ]


def _move(
    scene: Scene, pedal: Array, ego_slip: Array, view: Any, lanes: int, dt: float
) -> tuple[Scene, Array]:
    """Return the scene `dt` later, by the bicycle model, and the ego's acceleration for the next frames,
    within its limits of speed. `ego_slip`: sine of its slip angle. `view`: `_view` of the scene."""
    hit, push_x, push_y = _collide(scene, dt)
    scene = scene._replace(crashed=hit)
    cos, sin = scene.cos, scene.sin
    outside = (jnp.arange(len(scene.x))[:, None] == 0) & (scene.target_speed == 0)
    timer, target, acceleration, slip = _decide(scene, view, outside, lanes)
    slip = jnp.where(outside, ego_slip, slip)
    acceleration = jnp.where(outside, pedal, acceleration)
    crashed, speed = scene.crashed != 0, scene.speed
    slip = jnp.where(crashed, 0.0, slip)
    acceleration = jnp.where(crashed, -speed, acceleration)
    slowest, fastest = (
        jnp.where(outside, own, other) for own, other in zip(road.EGO_SPEEDS, SPEEDS, strict=True)
    )
    acceleration = jnp.where(speed > fastest, jnp.minimum(acceleration, fastest - speed), acceleration)
    acceleration = jnp.where(speed < slowest, jnp.maximum(acceleration, slowest - speed), acceleration)
    along = jnp.sqrt(1 - slip * slip)
    pushed = ~jnp.isnan(push_x)
    x = scene.x + speed * (cos * along - sin * slip) * dt + jnp.where(pushed, push_x, 0.0)
    y = scene.y + speed * (sin * along + cos * slip) * dt + jnp.where(pushed, push_y, 0.0)
    heading = scene.heading + speed * slip / (road.LENGTH / 2) * dt
    moved = scene._replace(
        x=x,
        y=y,
        heading=heading,
        cos=jnp.cos(heading),
        sin=jnp.sin(heading),
        speed=speed + acceleration * dt,
        timer=timer + dt,
        lane=jnp.clip(jnp.ceil(y / road.LANE_WIDTH - 0.5), 0, lanes - 1),
        target=target,
        crashed=jnp.where(pushed, 1.0, hit),
    )
    return moved, acceleration[0]


def _decide(scene: Scene, view: Any, outside: Array, lanes: int) -> tuple[Array, Array, Array, Array]:
    """Return the drivers' timers, target lanes, accelerations, and sines of slip angles, (N, R) each."""
    x, y, speed, lane = scene.x, scene.y, scene.speed, scene.lane
    cos, sin = scene.cos, scene.sin
    hurry, places = view
    index = jnp.arange(len(x))[:, None]
    driving = ~outside & (scene.crashed == 0)
    along, aside = speed * cos, speed * sin
    free = COMFORTABLE * (1 - jnp.exp(scene.delta * hurry))

    # The vehicle ahead in each lane (L, N, R), and the one behind in the next ones (2, N, R). XLA fuses them.
    number, side = (jnp.array(each, x.dtype)[:, None, None] for each in (range(lanes), (-1, 1)))
    ahead = [number + jnp.inf * jnp.ones_like(x), *[jnp.zeros((lanes, *x.shape), x.dtype)] * 2]
    behind = [side - jnp.inf * jnp.ones_like(x), *[jnp.zeros((2, *x.shape), x.dtype)] * 4]
    for j in range(len(x)):
        away = x[j] - x
        in_lane = places[:, j, None] - x
        closer = (in_lane >= 0) & (in_lane <= ahead[0]) & (index != j)
        ahead = _put(closer, (away, along[j], aside[j]), ahead)
        closer = jnp.abs(y[j] - road.LANE_WIDTH * (lane + side)) <= NEAR_LANE
        closer &= (away < 0) & (away > behind[0])
        behind = _put(closer, (away, speed[j], cos[j], sin[j], hurry[j]), behind)
    away, other_along, other_aside = ahead
    closing = (along - other_along) * cos + (aside - other_aside) * sin
    braking = _square(_gap(speed, closing) / _not_zero(away))
    away, rear_speed, rear_cos, rear_sin, rear_hurry = behind
    closing = (rear_speed * rear_cos - along) * rear_cos + (rear_speed * rear_sin - aside) * rear_sin
    imposed = 1 - jnp.exp(scene.delta * rear_hurry) - _square(_gap(rear_speed, closing) / _not_zero(away))

    # MOBIL, without regard for the vehicle behind in the driver's own lane.
    def follow(target: Array) -> Array:
        """Return accelerations behind the vehicles ahead in target lanes."""
        slower = [jnp.where(target == k, braking[k], 0.0) for k in range(lanes)]
        return free - COMFORTABLE * sum(slower[1:], slower[0])

    changing = driving & (lane != scene.target)
    due = driving & ~changing & (scene.timer > DELAY)
    better = (
        (due & (jnp.abs(speed) >= 1))
        & (lane + side >= 0)
        & (lane + side < lanes)
        & (jnp.abs(y - road.LANE_WIDTH * (lane + side)) <= 2 * road.LANE_WIDTH)
        & ((COMFORTABLE * imposed >= -IMPOSED) | (away == -jnp.inf))
        & (follow(lane + side) - follow(lane) >= GAIN)
    )

    # A change of lanes ends where a vehicle close ahead changes into the same lane. A driver sees the new
    # decisions of drivers before it, and the old ones of drivers after it. So the loop ends, mostly at once.
    claimed = jnp.where(outside | (scene.target == lane), -1.0, scene.target)

    def decide(last: Any) -> Any:
        give_up, _, _ = last
        target = jnp.where(give_up, lane, scene.target)
        for k in (0, 1):
            target = jnp.where(better[k], lane + side[k], target)
        claim = jnp.where(outside | (target == lane), -1.0, target)
        rivals = jnp.zeros(x.shape, bool)
        for j in range(len(x)):
            closing = (along - along[j]) * cos + (aside - aside[j]) * sin
            close = (x[j] > x) & (x[j] - x < _gap(speed, closing))
            rivals |= close & (jnp.where(index > j, claim[j], claimed[j]) == scene.target)
        rivals &= changing
        return rivals, target, (rivals != give_up).any()

    nobody = jnp.zeros(x.shape, bool)
    _, target, _ = lax.while_loop(lambda last: last[2], decide, (nobody, scene.target, jnp.array(True)))

    acceleration = jnp.clip(jnp.minimum(follow(lane), follow(target)), -MOST, MOST)
    pace = _not_zero(speed)
    aim = jnp.arcsin(jnp.clip((road.LANE_WIDTH * target - y) / TAU_LATERAL / pace, -1, 1))
    turn = jnp.clip(aim, -math.pi / 4, math.pi / 4) - scene.heading
    turn = (turn - 2 * math.pi * jnp.round(turn / (2 * math.pi))) / TAU_HEADING
    slip = jnp.clip(road.LENGTH / 2 / pace * turn, -MOST_SLIP, MOST_SLIP)
    return jnp.where(due, 0.0, scene.timer), target, acceleration, slip


def _collide(scene: Scene, dt: float) -> tuple[Array, Array, Array]:
    """Return flags of crashed vehicles, and the push of collisions in x and y, NaN for none, (N, R) each."""
    index = jnp.arange(len(scene.x))[:, None]
    cos, sin = scene.cos, scene.sin
    x, y, speed = scene.x - scene.x[0], scene.y - scene.y[0], scene.speed
    along, across = cos * cos[0] + sin * sin[0], sin * cos[0] - cos * sin[0]
    length, width = (
        jnp.abs(one) * road.LENGTH / 2 + jnp.abs(other) * road.WIDTH / 2
        for one, other in ((along, across), (across, along))
    )
    # Seldom a vehicle is near enough in both of the ego's directions for the full computation.
    ahead, aside = x * cos[0] + y * sin[0], y * cos[0] - x * sin[0]
    touchable = (index > 0) & (
        jnp.abs(aside) - jnp.abs(dt * speed * across) <= width + road.WIDTH / 2 + MARGIN
    )
    touchable &= (
        jnp.abs(ahead) - jnp.abs(dt * (speed[0] - speed * along)) <= length + road.LENGTH / 2 + MARGIN
    )

    def rectangles(crashed: Array) -> tuple[Array, Array, Array]:
        """Test the separating axes of rectangles, now and moved for `dt`."""
        swept_x, swept_y = (dt * (speed[0] * part[0] - speed * part) for part in (cos, sin))
        near = (index > 0) & (jnp.sqrt(x * x + y * y) <= math.hypot(road.LENGTH, road.WIDTH) + speed[0] * dt)
        touching = colliding = near
        least, push = x + jnp.inf, [x, y]
        for normal, own, other in (
            ((cos[0], sin[0]), road.LENGTH / 2, length),
            ((-sin[0], cos[0]), road.WIDTH / 2, width),
            ((cos, sin), length, road.LENGTH / 2),
            ((-sin, cos), width, road.WIDTH / 2),
        ):
            middle = x * normal[0] + y * normal[1]
            swept = swept_x * normal[0] + swept_y * normal[1]

            def depths(low: Any, high: Any, middle: Array = middle, other: Any = other) -> list[Array]:
                """Return highway-env's two distances between intervals: along the axis and against it."""
                left, right = middle - other - high, low - middle - other
                return [
                    jnp.where(low < middle - other, left, right),
                    jnp.where(high > middle + other, right, left),
                ]

            touching &= jnp.maximum(*depths(-own, own)) <= 0
            deep = depths(jnp.minimum(swept, 0) - own, jnp.maximum(swept, 0) + own)
            colliding &= jnp.maximum(*deep) <= 0
            size = jnp.minimum(*(jnp.abs(depth) for depth in deep))
            less, sign = size < least, jnp.where(middle < 0, -1.0, 1.0)
            least, *push = _put(less, (size, sign * normal[0], sign * normal[1]), (least, *push))
        push_x, push_y = (jnp.where(colliding, least * part / 2, jnp.nan) for part in push)
        return jnp.where(touching, 1.0, crashed), push_x, push_y

    def nobody(crashed: Array) -> tuple[Array, Array, Array]:
        return crashed, x * jnp.nan, x * jnp.nan

    crashed, push_x, push_y = lax.cond(touchable.any(), rectangles, nobody, scene.crashed)
    # The ego crashes with each touching vehicle, and the last one pushes it.
    own = crashed[0], push_x[0], push_y[0]
    for j in range(1, len(x)):
        pushes = ~jnp.isnan(push_x[j])
        own = (
            jnp.maximum(own[0], crashed[j]),
            jnp.where(pushes, -push_x[j], own[1]),
            jnp.where(pushes, -push_y[j], own[2]),
        )
    crashed, push_x, push_y = _put(index == 0, own, (crashed, push_x, push_y))
    return crashed, push_x, push_y


def _gap(speed: Array, closing: Array) -> Array:
    """Return IDM's desired distances to vehicles ahead."""
    return DISTANCE + speed * TIME_GAP + speed * closing / (2 * math.sqrt(COMFORTABLE * BRAKING))


def _put(where: Array, new: Any, old: Any) -> list[Array]:
    return [jnp.where(where, one, other) for one, other in zip(new, old, strict=True)]


def _square(values: Array) -> Array:
    return values * values


def _not_zero(values: Array) -> Array:
    return jnp.where(jnp.abs(values) > 1e-2, values, jnp.where(values >= 0, 1e-2, -1e-2))
