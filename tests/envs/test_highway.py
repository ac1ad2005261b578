"""Highway: the fast environment equals highway-env's, and the task is what its spec says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.road.lane import SineLane, StraightLane
from highway_env.road.road import Road as UpstreamRoad

from envs.driving import highway
from envs.driving.batch import Road, Scenes
from envs.driving.fast import FastHighwayEnv
from envs.driving.highway import CONFIG, HORIZON, SPEC, idm_return

VIEW = {
    "type": "Kinematics",
    "features": ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "lat_off", "ang_off"],
    "features_range": {"x": [-100, 100], "y": [-12, 12], "vx": [-30, 30]},
}
META = {"type": "DiscreteMetaAction"}
CASES: dict[str, dict[str, Any]] = {
    "task": CONFIG,
    "dense": {**CONFIG, "vehicles_density": 2.5, "vehicles_count": 30, "lanes_count": 4},
    "offroad": {**CONFIG, "offroad_terminal": False, "lanes_count": 2, "simulation_frequency": 10},
    "meta": {"action": META, "observation": VIEW, "vehicles_density": 2, "policy_frequency": 1},
    "shuffled": {"action": META, "observation": {**VIEW, "order": "shuffled", "see_behind": True}},
    "absolute": {"action": META, "observation": {**VIEW, "absolute": True, "clip": False}, "lanes_count": 1},
    # From here on at least one of the fast paths must step aside.
    "other observation": {"action": META, "observation": {"type": "OccupancyGrid"}},
    "unknown feature": {"action": META, "observation": {"type": "Kinematics", "features": ["x", "cos_d"]}},
    "connected lanes": {"action": META, "neighbour_vehicles_connected_lanes": True},
    "other drivers": {
        "action": META,
        "other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle",
    },
}


def scene(env: Any) -> list[tuple[Any, ...]]:
    names = ("heading", "speed", "crashed", "lane_index", "target_lane_index", "timer")
    return [(*v.position.tolist(), *(getattr(v, name, None) for name in names)) for v in env.road.vehicles]


def assert_identical(ours: Any, theirs: Any, seed: int, steps: int) -> None:
    """Same seed and actions, compared bit by bit until either ends."""
    assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        action: Any = int(rng.integers(5))
        if theirs.action_space.shape == (2,):
            action = (rng.normal(size=2) * [0.5, 0.1]).astype(np.float32)
        mine, upstream = ours.step(action), theirs.step(action)
        assert mine[0].dtype == upstream[0].dtype
        assert np.array_equal(mine[0], upstream[0])
        assert mine[1:4] == upstream[1:4]
        assert {**mine[4], "action": 0} == {**upstream[4], "action": 0}
        assert scene(ours) == scene(theirs)
        if upstream[2] or upstream[3]:
            break


@pytest.mark.parametrize("case", CASES)
def test_identical_to_upstream(case: str) -> None:
    for seed in range(3):
        steps = 40 if CASES[case].get("policy_frequency") == 2.5 else 8
        assert_identical(FastHighwayEnv(CASES[case]), HighwayEnvFast(CASES[case]), seed, steps)


def drive(kind: str, seed: int, time: int, env: Any) -> Any:
    """An action of a driver who wanders, who races down the lanes, or who changes lanes."""
    rng = np.random.default_rng([seed, time])
    aim = {"wander": None, "race": 0.5 * np.sin(time / 7), "weave": 4.0 * ((time // 15 + seed) % 3)}[kind]
    if aim is None:
        return (rng.normal(size=2) * [0.5, 0.1]).astype(np.float32)
    aside = env.vehicle.position[1] - aim
    steering = np.clip(-0.3 * aside - 12 * env.vehicle.heading, -1, 1)
    return np.array([1.0 if kind == "race" else rng.uniform(-0.3, 1), steering], np.float32)


def rows_of(scenes: Scenes, row: int) -> list[tuple[Any, ...]]:
    """Of every vehicle what `scene` tells."""
    names = ("x", "y", "heading", "speed", "crashed", "lane", "target", "timer")
    ego, *others = zip(*(getattr(scenes, name)[row].tolist() for name in names), strict=True)
    return [(*ego[:6], None, None), *others]


@pytest.mark.parametrize("kind", ["wander", "race", "weave"])
@pytest.mark.parametrize("case", ["task", "dense", "offroad"])
def test_scenes_side_by_side_are_identical_to_upstream(case: str, kind: str) -> None:
    config, crashes = CASES[case], 0
    frames = round(config["simulation_frequency"] / config["policy_frequency"])
    ours, upstream = FastHighwayEnv(config), HighwayEnvFast(config)
    road = Road.of(ours.road, config["action"]["speed_range"])
    together, compared, still = np.array([2, 0]), 0, 1
    for seed in range(3):
        scenes = Scenes.of(ours.road)[np.zeros(3, np.int64)]
        for row in range(3):
            ours.reset(seed=seed + row)
            scenes[np.array([row])] = Scenes.of(ours.road)
        start = rows_of(scenes, still)
        upstream.reset(seed=seed)
        for time in range(60):  # upstream steps on after a crash
            action = drive(kind, seed, time, upstream)
            asked = upstream.action_type.get_action(action)
            upstream.step(action)
            driven = scenes[together]
            driven.steering[:, 0], driven.acceleration[:, 0] = (
                (0.01, asked["steering"]),
                (1, asked["acceleration"]),
            )
            for _ in range(frames):
                driven.step(road, 1 / config["simulation_frequency"])
            scenes[together] = driven
            theirs = [(*v[:5], *(lane and lane[2] for lane in v[5:7]), v[7]) for v in scene(upstream)]
            assert rows_of(scenes, compared) == theirs
        crashes += upstream.vehicle.crashed
        assert rows_of(scenes, still) == start
    assert crashes or kind == "wander"


@pytest.mark.parametrize("change", ["meta", "connected lanes", "other drivers"])
def test_scenes_of_another_kind_are_refused(change: str) -> None:
    Scenes.of(FastHighwayEnv(CONFIG).road)
    config = {**CONFIG, **CASES[change]}
    if change != "meta":
        config["action"] = CONFIG["action"]
    with pytest.raises(ValueError, match="beside others"):
        Scenes.of(FastHighwayEnv(config).road)


def test_curved_lanes_keep_upstream_methods() -> None:
    def bend(env: Any) -> None:
        lanes = env.road.network.graph["0"]["1"]
        lanes[0] = SineLane(lanes[0].start, lanes[0].end, 1.0, 0.02, 0.0)

    class Bent(HighwayEnvFast):  # type: ignore[misc]
        def _create_road(self) -> None:
            super()._create_road()
            bend(self)

    class FastBent(FastHighwayEnv):
        def _create_road(self) -> None:
            super()._create_road()
            bend(self)

    ours = FastBent(CONFIG)
    assert type(ours.road) is UpstreamRoad
    assert type(ours.road.network.graph["0"]["1"][1]) is StraightLane
    assert_identical(ours, Bent(CONFIG), seed=0, steps=20)


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
    inner: Any = env.unwrapped
    ego = inner.vehicle
    middle = (highway.LANES - 1) / 2 * highway.LANE_WIDTH
    assert obs[0] * highway.WIDE + middle == pytest.approx(ego.position[1])
    assert obs[3] * highway.FAST + highway.CRUISE == pytest.approx(ego.speed)
    own = [v for v in inner.road.vehicles if v is not ego and abs(v.position[1] - ego.position[1]) < 1]
    ahead = min((v for v in own if v.position[0] > ego.position[0]), key=lambda v: v.position[0])
    gap = ahead.position[0] - ego.position[0] - ego.LENGTH
    assert obs[10] * highway.LONG == pytest.approx(min(gap, highway.REACH), rel=1e-5)
    if gap < highway.REACH:
        assert obs[11] * highway.FAST == pytest.approx(ahead.speed - ego.speed, rel=1e-4)


@pytest.mark.parametrize(("lane", "missing"), [(0, slice(6, 10)), (2, slice(14, 18))])
def test_there_is_nothing_to_see_beyond_the_road(lane: int, missing: slice) -> None:
    scene = highway.Highway({"initial_lane_id": lane})
    obs, _ = scene.reset(seed=4)
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
    scene = highway.Highway({"initial_lane_id": 1, "vehicles_count": 1})
    scene.reset(seed=0)
    ego, other = scene.vehicle, scene.road.vehicles[1]
    other.position = ego.position + np.array([dx, 0.9 * side * highway.LANE_WIDTH])
    other.heading, other.speed = 0.0, ego.speed + dv
    free = scene._observe()[4:6] * highway.WIDE
    to_the_edge = 1.5 * highway.LANE_WIDTH
    there, elsewhere = free if side == -1 else free[::-1]
    assert there == pytest.approx(0.9 * highway.LANE_WIDTH if beside else to_the_edge, rel=1e-5)
    assert elsewhere == pytest.approx(to_the_edge)


def test_offset_from_its_lane() -> None:
    scene = highway.Highway({"initial_lane_id": 2})
    scene.reset(seed=0)
    scene.vehicle.position[1] -= 1.5
    assert scene._observe()[1] == pytest.approx(-1.5)


def test_dense_traffic_is_the_same_but_half_as_far_apart_again() -> None:
    nominal, dense = SPEC.make(), SPEC.variant("dense").make()
    gaps = []
    for env in (nominal, dense):
        env.reset(seed=0)
        gaps.append(np.diff([vehicle.position[0] for vehicle in env.unwrapped.road.vehicles]))  # type: ignore[attr-defined]
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
    assert len(others) == int(CONFIG["vehicles_count"])  # type: ignore[call-overload]
    assert {f"{name}_speed" for name in (*others, "ego")} <= {*after}
    arrow = after["ego_speed"].points
    speed = env.unwrapped.vehicle.speed  # type: ignore[attr-defined]
    assert np.linalg.norm(arrow[1] - arrow[0]) == pytest.approx(speed * highway.TIME_STEP)
    for shapes in (before, after):
        sides = np.linalg.norm(np.diff(shapes["ego"].points, axis=0), axis=1)
        assert sorted(sides.tolist()) == pytest.approx([2, 2, 5, 5])
        assert np.array_equal(shapes["ego"].points[0], shapes["ego"].points[-1])
    assert abs(np.diff(after["ego"].points[:2], axis=0)).min() > 1e-3  # rotated
    assert SPEC.why_ended(env) in ("crashed", "left the road")
