"""The traffic of highway-env, many scenes at once, compiled by JAX.

Others drive by IDM (Treiber et al. 2000) and change lanes by MOBIL (Kesting et al. 2007). Only the ego
collides. The lanes' ends are out of reach. In 64 bits the arithmetic is highway-env's but for the last bits:
events are the same, and positions differ by less than 1e-9 m over an episode.

All functions are pure, work in the precision of the state (R, 12, N), and may be part of larger programs.
Inside, arrays are (N, R) or (lane, N, R), as XLA's loops run along the last axis. Loops over vehicles are
unrolled: 13 and 19 compile in seconds, `observe` with 31 in minutes.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from envs.driving.scene import (
    CORRIDOR,
    CRASH,
    CRUISE,
    DRIFT,
    DT,
    EGO_SPEEDS,
    ELBOW_ROOM,
    FAST,
    FRAMES,
    LANE_WIDTH,
    LANES,
    LENGTH,
    LONG,
    PEDAL,
    REACH,
    SIDE_REACH,
    SPEED_LIMIT,
    WHEEL,
    WIDE,
    WIDTH,
    Scene,
)

SPEEDS = (-40.0, 40.0)  # m/s, of drivers
MARGIN = 1e-6  # m, more than any rounding of a distance
MOST, COMFORTABLE, BRAKING = 6.0, 3.0, 5.0  # m/s^2, of IDM
DISTANCE, TIME_GAP = 10.0, 1.5  # m, s, that IDM keeps
DELAY, GAIN, IMPOSED = 1.0, 0.2, 2.0  # s, m/s^2, m/s^2, of MOBIL
NEAR_LANE = LANE_WIDTH / 2 + 1  # m beside a lane's middle where a vehicle still counts as on it
TAU_LATERAL, TAU_HEADING = 0.6, 0.2  # s, of a driver's steering
MOST_SLIP = math.sin(math.atan(math.tan(math.pi / 3) / 2))  # its sine, at the largest steering angle


def step(state: Array, act: Array, lanes: int = LANES, dt: float = DT, frames: int = FRAMES) -> Array:
    """Return states (R, 12, N) after actions (R, 2)."""
    scene = _scene(state)
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


def judge(state: Array) -> tuple[Array, Array]:
    """Return rewards (R,) of steps to states (R, 12, N), and whether episodes terminate there."""
    scene = _scene(state)
    crashed = scene.crashed[0] != 0
    on_road = jnp.abs(scene.y[0] - LANE_WIDTH * scene.lane[0]) <= LANE_WIDTH / 2
    slow, fast = EGO_SPEEDS
    forward = jnp.clip((scene.speed[0] * scene.cos[0] - slow) / (fast - slow), 0, 1)
    return jnp.where(on_road, CRASH * crashed + forward, 0.0), crashed | ~on_road


def _scene(state: Array) -> Scene:
    return Scene(*jnp.moveaxis(state, 0, -1))


def _view(scene: Scene, lanes: int) -> tuple[Array, Array]:
    """Return logarithms of speeds over desired ones, and positions of who is on which lane (L, N, R)."""
    limit = jnp.abs(_not_zero(jnp.clip(scene.target_speed, 0, SPEED_LIMIT)))
    number = jnp.arange(lanes, dtype=scene.x.dtype)[:, None, None]
    places = jnp.where(jnp.abs(scene.y - LANE_WIDTH * number) <= NEAR_LANE, scene.x, jnp.nan)
    return jnp.log(jnp.maximum(scene.speed, 0) / limit), places


def _controls(act: Array, dtype: Any) -> list[Array]:
    """Return accelerations (R,) and steering angles, in 32 bits like highway-env's actions."""
    share = jnp.clip(act.astype(jnp.float32), -1, 1).T + 1
    # The minimum changes nothing but keeps XLA from fusing product and sum, whose rounding would differ.
    return [
        (jnp.minimum(part * np.float32(2 * size) / 2, np.float32(2 * size)) - np.float32(size)).astype(dtype)
        for part, size in zip(share, (PEDAL, WHEEL), strict=True)
    ]


def _move(
    scene: Scene, pedal: Array, ego_slip: Array, view: Any, lanes: int, dt: float
) -> tuple[Scene, Array]:
    """Return the scene `dt` later, by the bicycle model, and the ego's acceleration, which its limits of
    speed change for the frames to come. ego_slip: sine of its slip angle. view: `_view` of the scene."""
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
    slowest, fastest = (jnp.where(outside, own, other) for own, other in zip(EGO_SPEEDS, SPEEDS, strict=True))
    acceleration = jnp.where(speed > fastest, jnp.minimum(acceleration, fastest - speed), acceleration)
    acceleration = jnp.where(speed < slowest, jnp.maximum(acceleration, slowest - speed), acceleration)
    along = jnp.sqrt(1 - slip * slip)
    pushed = ~jnp.isnan(push_x)
    x = scene.x + speed * (cos * along - sin * slip) * dt + jnp.where(pushed, push_x, 0.0)
    y = scene.y + speed * (sin * along + cos * slip) * dt + jnp.where(pushed, push_y, 0.0)
    heading = scene.heading + speed * slip / (LENGTH / 2) * dt
    moved = scene._replace(
        x=x,
        y=y,
        heading=heading,
        cos=jnp.cos(heading),
        sin=jnp.sin(heading),
        speed=speed + acceleration * dt,
        timer=timer + dt,
        lane=jnp.clip(jnp.ceil(y / LANE_WIDTH - 0.5), 0, lanes - 1),
        target=target,
        crashed=jnp.where(pushed, 1.0, hit),
    )
    return moved, acceleration[0]


def _decide(scene: Scene, view: Any, outside: Array, lanes: int) -> tuple[Array, Array, Array, Array]:
    """Return the drivers' timers, target lanes, accelerations, and sines of slip angles."""
    x, y, speed, lane = scene.x, scene.y, scene.speed, scene.lane
    cos, sin = scene.cos, scene.sin
    hurry, places = view
    index = jnp.arange(len(x))[:, None]
    driving = ~outside & (scene.crashed == 0)
    along, aside = speed * cos, speed * sin
    free = COMFORTABLE * (1 - jnp.exp(scene.delta * hurry))

    # Who is ahead in each lane (L, N, R), and who is behind in the next ones (2, N, R). XLA makes one loop of
    # each of these unrolled ones.
    number, side = (jnp.array(each, x.dtype)[:, None, None] for each in (range(lanes), (-1, 1)))
    ahead = [number + jnp.inf * jnp.ones_like(x), *[jnp.zeros((lanes, *x.shape), x.dtype)] * 2]
    behind = [side - jnp.inf * jnp.ones_like(x), *[jnp.zeros((2, *x.shape), x.dtype)] * 4]
    for j in range(len(x)):
        away = x[j] - x
        in_lane = places[:, j, None] - x
        closer = (in_lane >= 0) & (in_lane <= ahead[0]) & (index != j)
        ahead = _put(closer, (away, along[j], aside[j]), ahead)
        closer = jnp.abs(y[j] - LANE_WIDTH * (lane + side)) <= NEAR_LANE
        closer &= (away < 0) & (away > behind[0])
        behind = _put(closer, (away, speed[j], cos[j], sin[j], hurry[j]), behind)
    away, its_along, its_aside = ahead
    closing = (along - its_along) * cos + (aside - its_aside) * sin
    braking = _square(_gap(speed, closing) / _not_zero(away))
    away, its_speed, its_cos, its_sin, its_hurry = behind
    closing = (its_speed * its_cos - along) * its_cos + (its_speed * its_sin - aside) * its_sin
    imposed = 1 - jnp.exp(scene.delta * its_hurry) - _square(_gap(its_speed, closing) / _not_zero(away))

    # MOBIL, of drivers who do not care for those behind them in their own lane.
    def follow(target: Array) -> Array:
        """Return the accelerations of drivers behind those ahead in lanes."""
        slower = [jnp.where(target == k, braking[k], 0.0) for k in range(lanes)]
        return free - COMFORTABLE * sum(slower[1:], slower[0])

    changing = driving & (lane != scene.target)
    due = driving & ~changing & (scene.timer > DELAY)
    better = (
        (due & (jnp.abs(speed) >= 1))
        & (lane + side >= 0)
        & (lane + side < lanes)
        & (jnp.abs(y - LANE_WIDTH * (lane + side)) <= 2 * LANE_WIDTH)
        & ((COMFORTABLE * imposed >= -IMPOSED) | (away == -jnp.inf))
        & (follow(lane + side) - follow(lane) >= GAIN)
    )

    # Who changes lanes gives up where somebody close ahead changes into the same lane. Each sees what those
    # before it decided now, and those after it before. So the loop ends, mostly after one round.
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
    aim = jnp.arcsin(jnp.clip((LANE_WIDTH * target - y) / TAU_LATERAL / pace, -1, 1))
    turn = jnp.clip(aim, -math.pi / 4, math.pi / 4) - scene.heading
    turn = (turn - 2 * math.pi * jnp.round(turn / (2 * math.pi))) / TAU_HEADING
    slip = jnp.clip(LENGTH / 2 / pace * turn, -MOST_SLIP, MOST_SLIP)
    return jnp.where(due, 0.0, scene.timer), target, acceleration, slip


def _collide(scene: Scene, dt: float) -> tuple[Array, Array, Array]:
    """Return who has crashed, and by how much collisions push vehicles, NaN for not at all (N, R)."""
    index = jnp.arange(len(scene.x))[:, None]
    cos, sin = scene.cos, scene.sin
    x, y, speed = scene.x - scene.x[0], scene.y - scene.y[0], scene.speed
    along, across = cos * cos[0] + sin * sin[0], sin * cos[0] - cos * sin[0]
    length, width = (
        jnp.abs(one) * LENGTH / 2 + jnp.abs(other) * WIDTH / 2
        for one, other in ((along, across), (across, along))
    )
    # Seldom anybody is so near in both of the ego's directions that all has to be computed.
    ahead, aside = x * cos[0] + y * sin[0], y * cos[0] - x * sin[0]
    touchable = (index > 0) & (jnp.abs(aside) - jnp.abs(dt * speed * across) <= width + WIDTH / 2 + MARGIN)
    touchable &= jnp.abs(ahead) - jnp.abs(dt * (speed[0] - speed * along)) <= length + LENGTH / 2 + MARGIN

    def rectangles(crashed: Array) -> tuple[Array, Array, Array]:
        """Tell by the separating axes of rectangles, as they are and as they move on for `dt`."""
        swept_x, swept_y = (dt * (speed[0] * part[0] - speed * part) for part in (cos, sin))
        near = (index > 0) & (jnp.sqrt(x * x + y * y) <= math.hypot(LENGTH, WIDTH) + speed[0] * dt)
        touching = colliding = near
        least, push = x + jnp.inf, [x, y]
        for normal, own, its in (
            ((cos[0], sin[0]), LENGTH / 2, length),
            ((-sin[0], cos[0]), WIDTH / 2, width),
            ((cos, sin), length, LENGTH / 2),
            ((-sin, cos), width, WIDTH / 2),
        ):
            middle = x * normal[0] + y * normal[1]
            swept = swept_x * normal[0] + swept_y * normal[1]

            def depths(low: Any, high: Any, middle: Array = middle, its: Any = its) -> list[Array]:
                """Return highway-env's two distances between intervals: along the axis and against it."""
                left, right = middle - its - high, low - middle - its
                return [
                    jnp.where(low < middle - its, left, right),
                    jnp.where(high > middle + its, right, left),
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
    # The ego crashes with each of them, and the last one pushes it.
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


def observe(state: Array) -> Array:
    """Return what the egos of states (R, 12, N) see (R, 18), in 32 bits."""
    scene = _scene(state)
    x, y, speed = scene.x, scene.y, scene.speed
    ahead = speed * scene.cos
    side = LANE_WIDTH * jnp.array([-1.0, 0.0, 1.0], x.dtype)[:, None, None]
    way = jnp.array([1.0, -1.0], x.dtype)[:, None]
    left, right = y[0] + LANE_WIDTH / 2, (LANES - 0.5) * LANE_WIDTH - y[0]
    distance = change = jnp.full((3, 2, len(state)), jnp.inf, x.dtype)
    for j in range(1, len(x)):
        dx, dy, dv = x[j] - x[0], y[j] - y[0], ahead[j] - ahead[0]
        gap = jnp.maximum(jnp.abs(dx) - LENGTH, 0.0)
        closing = jnp.maximum(jnp.where(dx > 0, -dv, dv), 0.0)  # m in a second
        beside = jnp.abs(dx) < jnp.minimum(LENGTH + ELBOW_ROOM + closing, LENGTH + REACH)
        left = jnp.where(beside & (dy <= 0), jnp.minimum(left, -dy), left)
        right = jnp.where(beside & (dy > 0), jnp.minimum(right, dy), right)
        # Who is beside is in front and behind.
        there = (gap < REACH) & (jnp.abs(dy - side) < CORRIDOR) & ((dx * way > 0) | (gap == 0))
        nearer = jnp.where(gap < distance, dv, jnp.minimum(dv, change))
        change = jnp.where(there & (gap <= distance), nearer, change)
        distance = jnp.where(there, jnp.minimum(gap, distance), distance)
    change = jnp.where(distance < REACH, change, 0.0)
    middle = y[0] + side
    road = (middle > -LANE_WIDTH / 2) & (middle < (LANES - 0.5) * LANE_WIDTH)
    gaps = jnp.stack([jnp.minimum(distance, REACH) / LONG, change / FAST], axis=2)
    own = [
        (y[0] - (LANES - 1) / 2 * LANE_WIDTH) / WIDE,
        y[0] - LANE_WIDTH * jnp.clip(jnp.round(y[0] / LANE_WIDTH), 0, LANES - 1),
        speed[0] * scene.sin[0] / DRIFT,
        (ahead[0] - CRUISE) / FAST,
        jnp.minimum(left, SIDE_REACH) / WIDE,
        jnp.minimum(right, SIDE_REACH) / WIDE,
    ]
    lanes = jnp.where(road[:, :, None], gaps, 0.0).reshape(12, len(state))
    return jnp.concatenate([jnp.stack(own), lanes]).T.astype(jnp.float32)


def _gap(speed: Array, closing: Array) -> Array:
    """Return the distances that IDM wants to those ahead."""
    return DISTANCE + speed * TIME_GAP + speed * closing / (2 * math.sqrt(COMFORTABLE * BRAKING))


def _put(where: Array, new: Any, old: Any) -> list[Array]:
    return [jnp.where(where, its, other) for its, other in zip(new, old, strict=True)]


def _square(values: Array) -> Array:
    return values * values


def _not_zero(values: Array) -> Array:
    return jnp.where(jnp.abs(values) > 1e-2, values, jnp.where(values >= 0, 1e-2, -1e-2))
