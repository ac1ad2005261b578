"""The highway task is what its spec says."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs.driving import highway
from envs.driving.environment import NOMINAL, Highway, look
from envs.driving.highway import CONFIG, HORIZON, SPEC, idm_return
from envs.driving.scene import CRUISE, FAST, LANE_WIDTH, LANES, LENGTH, LONG, REACH, WIDE


def test_the_task_is_imported_without_its_compiler() -> None:
    code = "import sys, envs.driving.highway; print({'jax', 'highway_env'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_gymnasium_checker() -> None:
    env = SPEC.make()
    check_env(env.unwrapped, skip_render_check=True)
    assert env.action_space == env.unwrapped.action_space


def test_deterministic_under_seed() -> None:
    def episode() -> list[Any]:
        env = SPEC.make()
        obs, _ = env.reset(seed=3)
        trace: list[Any] = [obs.tolist()]
        env.action_space.seed(3)
        for _ in range(30):
            obs, reward, terminated, _, _ = env.step(env.action_space.sample())
            trace.append((obs.tolist(), reward, terminated))
            if terminated:
                break
        return trace

    first, second = episode(), episode()
    assert first == second


def returns(scale: float, seeds: range) -> float:
    """Mean return of uniform actions times `scale`."""
    env, rng, total = SPEC.make(), np.random.default_rng(0), 0.0
    for seed in seeds:
        env.reset(seed=seed)
        ended = False
        while not ended:
            action = (scale * rng.uniform(-1, 1, 2)).astype(np.float32)
            _, reward, terminated, truncated, _ = env.step(action)
            total, ended = total + float(reward), terminated or truncated
    return total / len(seeds)


def test_driving_matters() -> None:
    seeds = range(5000, 5060)
    reference, crashes = idm_return(seeds)
    random = returns(1.0, seeds)
    assert not crashes.any()
    assert SPEC.bar(seeds[:5]) == reference[:5].mean()
    assert (returns(0.0, seeds) - random) / (reference.mean() - random) <= 0.4


def slow_episode() -> list[tuple[Any, Any, float, bool, bool]]:
    """Brakes and steers straight: (environment, observation, reward, terminated, truncated) a step."""
    env = SPEC.make()
    env.reset(seed=1)
    steps: list[Any] = []
    while not steps or not (steps[-1][3] or steps[-1][4]):
        obs, reward, terminated, truncated, _ = env.step(np.array([-1, 0], np.float32))
        steps.append((env, obs, float(reward), terminated, truncated))
    return steps


def test_horizon_is_exact() -> None:
    steps = slow_episode()
    assert len(steps) == HORIZON == SPEC.horizon
    assert steps[-1][3:] == (False, True)


def test_phi_in_range_and_of_the_observation_alone() -> None:
    obs = np.array([step[1] for step in slow_episode()], np.float64)
    obs = np.concatenate(
        [obs, np.random.default_rng(0).normal(0, 3, obs.shape), np.zeros((1, SPEC.obs_size))]
    )
    features = SPEC.features(obs, np.zeros((len(obs), 2)))
    assert features.shape == (len(obs), 8)
    assert np.abs(features).max() <= 1
    assert (features[:, -1] == 1).all()
    assert (features[:HORIZON, 1] == features[0, 1]).all()  # centred while it drives straight


def test_observation_units() -> None:
    env = SPEC.make()
    obs, _ = env.reset(seed=2)
    scene = inner(env).scene
    x, y, speed = scene.x, scene.y, scene.speed
    assert obs[0] * WIDE + (LANES - 1) / 2 * LANE_WIDTH == pytest.approx(y[0])
    assert obs[3] * FAST + CRUISE == pytest.approx(speed[0])
    ahead = (np.abs(y - y[0]) < 1) & (x > x[0])
    nearest = np.flatnonzero(ahead)[x[ahead].argmin()]
    gap = x[nearest] - x[0] - LENGTH
    assert obs[10] * LONG == pytest.approx(min(gap, REACH), rel=1e-5)
    if gap < REACH:
        assert obs[11] * FAST == pytest.approx(speed[nearest] - speed[0], rel=1e-4)


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
        (6.5, 0, True),
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


def test_offset_from_its_lane() -> None:
    env = beginning_in(2)
    env.scene.y[0] -= 1.5
    assert look(env.state[None])[0, 1] == pytest.approx(-1.5)


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
