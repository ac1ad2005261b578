"""The highway task is what its spec says."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from envs.driving import highway
from envs.driving.environment import NOMINAL, Highway, look
from envs.driving.highway import CONFIG, HORIZON, SPEC
from envs.driving.scene import CRUISE, FAST, LANE_WIDTH, LANES, LENGTH, LONG, REACH, WIDE


def test_the_task_is_imported_without_its_compiler() -> None:
    code = "import sys, envs.driving.highway; print({'jax', 'highway_env'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def inner(env: Any) -> Highway:
    """Return the task itself."""
    assert isinstance(env.unwrapped, Highway)
    return env.unwrapped


def beginning_in(lane: int) -> Highway:
    """Return the task in a first scene whose ego is in the lane."""
    env = Highway(NOMINAL)
    for seed in range(100):
        env.reset(seed=seed)
        if env.scene.lane[0] == lane:
            break
    return env


@pytest.mark.parametrize(("lane", "missing"), [(0, slice(6, 10)), (2, slice(14, 18))])
def test_there_is_nothing_to_see_beyond_the_road(lane: int, missing: slice) -> None:
    obs = look(beginning_in(lane).state[None])[0]
    assert (obs[missing] == 0).all()
    assert (obs[[10, 12]] > 0).all()


@pytest.mark.parametrize(
    ("dx", "dv", "beside"),
    [
        (0, 0, True),
        (-6.5, 0, True),
        (7.5, 0, False),
        (9, -3, True),
        (9, 3, False),
        (-9, 3, True),
    ],
)
@pytest.mark.parametrize("side", [-1, 1])
def test_who_is_beside_or_will_be_in_a_second(dx: float, dv: float, beside: bool, side: int) -> None:
    env = beginning_in(1)
    scene = env.scene
    scene.x[1:] = scene.x[0] + 1000
    scene.x[1], scene.y[1] = scene.x[0] + dx, scene.y[0] + 0.9 * side * LANE_WIDTH
    scene.speed[1] = scene.speed[0] + dv
    free = look(env.state[None])[0, 4:6] * WIDE
    to_the_edge = 1.5 * LANE_WIDTH
    there, elsewhere = free if side == -1 else free[::-1]
    assert there == pytest.approx(0.9 * LANE_WIDTH if beside else to_the_edge, rel=1e-5)
    assert elsewhere == pytest.approx(to_the_edge)


def test_dense_traffic_is_the_same_but_half_as_far_apart_again() -> None:
    nominal, dense = SPEC.make(), SPEC.variant("dense").make()
    gaps = []
    for env in (nominal, dense):
        env.reset(seed=0)
        gaps.append(np.diff(inner(env).scene.x))
    np.testing.assert_allclose(gaps[0], 1.5 * gaps[1][: len(gaps[0])])


def test_drawing() -> None:
    env = SPEC.make()
    env.reset(seed=0)
    before = SPEC.draw(env)
    terminated = False
    while not terminated:
        terminated = env.step(np.array([1, 1], np.float32))[2]
    after = SPEC.draw(env)
    assert list(before) == list(after)
    others = [name for name in after if name.startswith("vehicle_") and not name.endswith("_speed")]
    assert len(others) == CONFIG["vehicles_count"]
    assert {f"{name}_speed" for name in (*others, "ego")} <= {*after}
    arrow = after["ego_speed"].points
    speed = inner(env).scene.speed[0]
    assert np.linalg.norm(arrow[1] - arrow[0]) == pytest.approx(speed * highway.TIME_STEP)
    for shapes in (before, after):
        sides = np.linalg.norm(np.diff(shapes["ego"].points, axis=0), axis=1)
        assert sorted(sides.tolist()) == pytest.approx([2, 2, 5, 5])
        assert np.array_equal(shapes["ego"].points[0], shapes["ego"].points[-1])
    assert abs(np.diff(after["ego"].points[:2], axis=0)).min() > 1e-3  # rotated
    assert SPEC.why_ended(env) in ("crashed", "left the road")


def test_observations_are_in_their_units_and_an_episode_lasts_its_horizon() -> None:
    env = SPEC.make()
    obs, _ = env.reset(seed=1)
    scene = inner(env).scene
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
