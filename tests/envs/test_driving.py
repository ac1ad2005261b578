"""The compiled traffic of the highway is highway-env's, and the task is what its spec says."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.vehicle.behavior import IDMVehicle

from envs.driving import observing, traffic
from envs.driving.environment import NOMINAL, first_states
from envs.driving.highway import CONFIG, HORIZON, SPEC, TARGET_SPEED, idm_return
from envs.driving.scene import CRUISE, FAST, LANE_WIDTH, LANES, LENGTH, LONG, REACH, WIDE, Scene
from envs.spec import Array

ROUNDING = 1e-9
"""How far a state may be from highway-env's, in metres, radians, m/s and s."""
CASES: dict[str, dict[str, Any]] = {
    "task": CONFIG,
    "dense": {**CONFIG, "vehicles_density": 2.5, "vehicles_count": 16, "lanes_count": 4},
}


def state_of(upstream: Any) -> Array:
    """Return the state (12, N) of highway-env's own scene."""
    rows = [
        Scene(
            *v.position,
            v.heading,
            np.cos(v.heading),
            np.sin(v.heading),
            v.speed,
            getattr(v, "timer", 0),
            getattr(v, "DELTA", 0),
            getattr(v, "target_speed", 0),
            v.lane_index[2],
            getattr(v, "target_lane_index", v.lane_index)[2],
            v.crashed,
        )
        for v in upstream.road.vehicles
    ]
    return np.array(rows, np.float64).T


def assert_same(state: Array, upstream: Any) -> None:
    """Same events, and the same numbers but for rounding."""
    mine, theirs = Scene(*state), Scene(*state_of(upstream))
    for name in Scene._fields:
        its, other = (getattr(scene, name) for scene in (mine, theirs))
        if name in ("timer", "target"):  # An ego that is driven from outside uses neither.
            its, other = its[1:], other[1:]
        if name in ("lane", "target", "crashed"):
            assert its.tolist() == other.tolist(), name
        else:
            np.testing.assert_allclose(its, other, rtol=0, atol=ROUNDING, err_msg=name)


def drive(kind: str, seed: int, time: int, env: Any) -> Any:
    """Return an action of a driver who wanders, who races down the lanes, or who changes lanes."""
    rng = np.random.default_rng([seed, time])
    aim = {"wander": None, "race": 0.5 * np.sin(time / 7), "weave": 4.0 * ((time // 15 + seed) % 3)}[kind]
    if aim is None:
        return (rng.normal(size=2) * [0.5, 0.1]).astype(np.float32)
    aside = env.vehicle.position[1] - aim
    steering = np.clip(-0.3 * aside - 12 * env.vehicle.heading, -1, 1)
    return np.array([1.0 if kind == "race" else rng.uniform(-0.3, 1), steering], np.float32)


@pytest.mark.parametrize("case", CASES)
def test_traffic_is_that_of_highway_env(case: str) -> None:
    config = CASES[case]
    frames = round(config["simulation_frequency"] / config["policy_frequency"])
    dt, lanes = 1 / config["simulation_frequency"], config["lanes_count"]
    step = jax.jit(partial(traffic.step, lanes=lanes, dt=dt, frames=frames))
    judge = jax.jit(observing.judge)
    kinds = [(kind, seed) for kind in ("wander", "race", "weave") for seed in range(2)]
    scenes = [HighwayEnvFast(config) for _ in kinds]
    for env, (_, seed) in zip(scenes, kinds, strict=True):
        env.reset(seed=seed)
    states = np.array([state_of(env) for env in scenes])
    since = np.zeros(len(scenes), int)
    for time in range(45):
        acts = [drive(kind, seed, time, env) for env, (kind, seed) in zip(scenes, kinds, strict=True)]
        with jax.enable_x64(True):
            states = np.asarray(step(states, np.array(acts)))
            rewards, terminated = map(np.asarray, judge(states))
        # Ten steps after a crash too. Then others stand, roll back, and steer so that rounding grows.
        for i in np.flatnonzero(since < 10):
            _, paid, _, _, _ = scenes[i].step(acts[i])
            ego = scenes[i].vehicle
            assert_same(states[i], scenes[i])
            assert rewards[i] == pytest.approx(paid, abs=ROUNDING)
            assert terminated[i] == (ego.crashed or not ego.on_road)
            since[i] += ego.crashed
    assert any(env.vehicle.crashed for env in scenes)


@pytest.mark.parametrize("variant", [None, "dense"])
def test_first_scenes_are_those_of_highway_env(variant: str | None) -> None:
    physics = SPEC.variants[variant]["physics"] if variant else NOMINAL
    made = {"vehicles_count": physics.vehicles, "vehicles_density": physics.density}
    upstream = HighwayEnvFast({**CONFIG, **made})
    for seed, first in enumerate(first_states(range(60), physics)):
        upstream.reset(seed=seed)
        np.testing.assert_array_equal(first, state_of(upstream))


def test_the_reference_driver_is_highway_envs() -> None:
    upstream, seeds = HighwayEnvFast(CONFIG), range(3)
    returns = []
    for seed in seeds:
        upstream.reset(seed=seed)
        ego = upstream.vehicle
        driver = IDMVehicle(ego.road, ego.position, ego.heading, ego.speed, target_speed=TARGET_SPEED)
        upstream.road.vehicles[0] = upstream.vehicle = driver
        returns.append(sum(upstream.step(None)[1] for _ in range(HORIZON)))
    np.testing.assert_allclose(idm_return(seeds)[0], returns, rtol=0, atol=ROUNDING)


def test_observations_are_in_their_units_and_an_episode_lasts_its_horizon() -> None:
    env = SPEC.make()
    obs, _ = env.reset(seed=1)
    inner: Any = env.unwrapped
    scene = inner.scene
    x, y, speed = scene.x, scene.y, scene.speed
    assert obs[0] * WIDE + (LANES - 1) / 2 * LANE_WIDTH == pytest.approx(y[0])
    assert obs[3] * FAST + CRUISE == pytest.approx(speed[0])
    ahead = (np.abs(y - y[0]) < 1) & (x > x[0])
    nearest = np.flatnonzero(ahead)[x[ahead].argmin()]
    gap = x[nearest] - x[0] - LENGTH
    assert obs[10] * LONG == pytest.approx(min(gap, REACH), rel=1e-5)
    steps = [env.step(np.array([-1, 0], np.float32)) for _ in range(HORIZON)]
    assert not any(step[2] for step in steps)
    assert [step[3] for step in steps] == [False] * (HORIZON - 1) + [True]
