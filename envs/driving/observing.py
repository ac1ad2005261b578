"""Observations, rewards and ends of many highway scenes at once, compiled by JAX like `traffic`."""

import jax.numpy as jnp
from jax import Array

from envs.driving import scene as road
from envs.driving.scene import Scene


def scene_of(state: Array) -> Scene:
    """Return states (R, 12, N) as a scene of rows (N, R)."""
    return Scene(*jnp.moveaxis(state, 0, -1))


def judge(state: Array) -> tuple[Array, Array]:
    """Return rewards (R,) of steps to states (R, 12, N), and flags of termination there (R,)."""
    scene = scene_of(state)
    crashed = scene.crashed[0] != 0
    on_road = jnp.abs(scene.y[0] - road.LANE_WIDTH * scene.lane[0]) <= road.LANE_WIDTH / 2
    slow, fast = road.EGO_SPEEDS
    forward = jnp.clip((scene.speed[0] * scene.cos[0] - slow) / (fast - slow), 0, 1)
    return jnp.where(on_road, road.CRASH * crashed + forward, 0.0), crashed | ~on_road


def observe(state: Array) -> Array:
    """Return the observations (R, 18) of states (R, 12, N), in 32 bits."""
    scene = scene_of(state)
    x, y, speed = scene.x, scene.y, scene.speed
    ahead = speed * scene.cos
    side = road.LANE_WIDTH * jnp.array([-1.0, 0.0, 1.0], x.dtype)[:, None, None]
    way = jnp.array([1.0, -1.0], x.dtype)[:, None]
    left, right = y[0] + road.LANE_WIDTH / 2, (road.LANES - 0.5) * road.LANE_WIDTH - y[0]
    distance = change = jnp.full((3, 2, len(state)), jnp.inf, x.dtype)
    for j in range(1, len(x)):
        dx, dy, dv = x[j] - x[0], y[j] - y[0], ahead[j] - ahead[0]
        gap = jnp.maximum(jnp.abs(dx) - road.LENGTH, 0.0)
        closing = jnp.maximum(jnp.where(dx > 0, -dv, dv), 0.0)  # m in a second
        beside = jnp.abs(dx) < jnp.minimum(road.LENGTH + road.ELBOW_ROOM + closing, road.LENGTH + road.REACH)
        left = jnp.where(beside & (dy <= 0), jnp.minimum(left, -dy), left)
        right = jnp.where(beside & (dy > 0), jnp.minimum(right, dy), right)
        # A vehicle beside the ego counts as ahead and behind.
        there = (gap < road.REACH) & (jnp.abs(dy - side) < road.CORRIDOR) & ((dx * way > 0) | (gap == 0))
        nearer = jnp.where(gap < distance, dv, jnp.minimum(dv, change))
        change = jnp.where(there & (gap <= distance), nearer, change)
        distance = jnp.where(there, jnp.minimum(gap, distance), distance)
    change = jnp.where(distance < road.REACH, change, 0.0)
    middle = y[0] + side
    exists = (middle > -road.LANE_WIDTH / 2) & (middle < (road.LANES - 0.5) * road.LANE_WIDTH)
    gaps = jnp.stack([jnp.minimum(distance, road.REACH) / road.LONG, change / road.FAST], axis=2)
    own = [
        (y[0] - (road.LANES - 1) / 2 * road.LANE_WIDTH) / road.WIDE,
        y[0] - road.LANE_WIDTH * jnp.clip(jnp.round(y[0] / road.LANE_WIDTH), 0, road.LANES - 1),
        speed[0] * scene.sin[0] / road.DRIFT,
        (ahead[0] - road.CRUISE) / road.FAST,
        jnp.minimum(left, road.SIDE_REACH) / road.WIDE,
        jnp.minimum(right, road.SIDE_REACH) / road.WIDE,
    ]
    lanes = jnp.where(exists[:, :, None], gaps, 0.0).reshape(12, len(state))
    return jnp.concatenate([jnp.stack(own), lanes]).T.astype(jnp.float32)
