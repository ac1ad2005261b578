"""The car, its roads and its camera."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from envs.hills import camera, environment
from envs.hills.camera import FARTHEST, RAYS, seen
from envs.hills.drive import OBS_NAMES, SPEC
from envs.hills.drive_images import View
from envs.hills.environment import Drive, drive, look, rotated
from envs.hills.tracks import CELLS, HALF, HALF_WIDTH, POINTS, TIGHTEST, Track, cross, draw_track, height

CIRCLE = 40.0  # m
GROUND = 5.0  # m
GROUND_ALONE = np.array([0, 1, 0, 0, 0, 0], np.uint8)
"""Groups of geometries that MuJoCo's rays hit."""


def circle(slope: float = 0.0) -> Track:
    """Return a circular road to the left, which begins at (CIRCLE, 0), on a plane that rises along x."""
    turns = np.arange(POINTS) * (2 * math.pi / POINTS)
    points, tangents = (
        np.column_stack(pair) for pair in ((np.cos(turns), np.sin(turns)), (-np.sin(turns), np.cos(turns)))
    )
    terrain = np.tile(GROUND + slope * np.linspace(-HALF, HALF, CELLS), (CELLS, 1))
    rises = height(terrain, *(CIRCLE * points).T)
    return Track(CIRCLE * points, tangents, 2 * math.pi * CIRCLE / POINTS, terrain, rises)


def test_roads_are_closed_wide_enough_and_turn_either_way() -> None:
    rng, sides = np.random.default_rng(0), set()
    for _ in range(20):
        track = draw_track(rng)
        gaps = np.hypot(*(np.roll(track.points, -1, axis=0) - track.points).T)
        np.testing.assert_allclose(gaps, track.spacing, rtol=0.02)
        np.testing.assert_allclose(np.hypot(*track.tangents.T), 1)
        turned = np.arcsin(cross(track.tangents, np.roll(track.tangents, -1, axis=0)))
        assert np.abs(turned).max() < 1.2 * track.spacing / TIGHTEST
        assert np.abs(track.points).max() + HALF_WIDTH < HALF
        sides.add(round(turned.sum() / (2 * math.pi)))
    assert sides == {-1, 1}


def test_heights_are_those_of_mujocos_ground() -> None:
    env = Drive()
    env.reset(seed=0)
    rng, found = np.random.default_rng(0), []
    for x, y in rng.uniform(-70, 70, (50, 2)):
        geom = np.zeros(1, np.int32)
        start, down = np.array([x, y, 100.0]), np.array([0, 0, -1.0])
        below = mujoco.mj_ray(
            env.model, env.data, start, down, np.array([0, 1, 0, 0, 0, 0], np.uint8), 1, -1, geom, None
        )
        found.append(100 - below - height(env.track.terrain, x, y))
    assert np.abs(found).max() < 0.25  # its cells are two triangles
    assert np.abs(found).mean() < 0.05


def test_what_is_observed_of_a_circle() -> None:
    env = Drive()
    env.reset(seed=0)
    aside, askew, speed = 1.5, 0.2, 6.0
    env.put(circle(0.1), aside, askew, speed)
    obs = dict(zip((q.name for q in OBS_NAMES), look([env])[0][0], strict=True))
    assert obs["forward speed"] == pytest.approx(speed)
    assert obs["offset to the left of the road's centre"] == pytest.approx(aside)
    assert obs["heading to the left of the road's"] == pytest.approx(askew, abs=0.01)
    # The car looks along y, so that it is tilted by the rise along x, to its right.
    assert obs["sine of the roll to the right"] == pytest.approx(-math.sin(math.atan(0.1)), abs=0.02)
    for ahead in (10, 30):
        turn = ahead / CIRCLE
        x, y = CIRCLE * math.cos(turn) - (CIRCLE - aside), CIRCLE * math.sin(turn)
        left = -x * math.cos(askew) - y * math.sin(askew)
        assert obs[f"road {ahead} m ahead, to the left"] == pytest.approx(left, abs=0.1)
    assert obs["road 20 m ahead, upwards"] == pytest.approx(0.1 * CIRCLE * (math.cos(0.5) - 1), abs=0.02)


def test_pay_is_progress_up_to_a_limit_and_ends_off_the_road() -> None:
    env = Drive()
    env.reset(seed=0)
    env.put(circle(), 0.0, 0.0, 5.0)
    start, paid, moved = env.data.qpos[:2].copy(), 0.0, 0.0
    for _ in range(60):
        obs, reward, ended = drive([env], np.array([[math.atan(2.6 / CIRCLE) / 0.5, 0.2]]))
        paid, moved = paid + reward[0], moved + 0.1 * obs[0, 0]
        assert reward[0] <= environment.MOST
        assert ended[0] == (abs(obs[0, environment.OFFSET]) > HALF_WIDTH)
        if ended[0]:
            break
    turned = math.atan2(env.data.qpos[1], env.data.qpos[0])
    assert paid == pytest.approx(CIRCLE * turned, rel=0.02)
    assert np.linalg.norm(env.data.qpos[:2] - start) > 10


def test_a_car_on_its_roof_ends_the_episode() -> None:
    env = Drive()
    env.reset(seed=0)
    env.put(circle(), 0.0, 0.0, 0.0)
    env.data.qpos[2:7] = GROUND + 2, 0, 1, 0, 0
    assert drive([env], np.zeros((1, 2)))[2][0]
    assert environment.why_ended(env) == "upside down"


@pytest.mark.parametrize(("action", "sign"), [(1.0, 1), (-1.0, -1)])
@pytest.mark.parametrize("variant", [None, "steering_flipped"])
def test_steering_turns_the_car_to_its_side(action: float, sign: int, variant: str | None) -> None:
    spec = SPEC.variant(variant) if variant else SPEC
    env = spec.make().unwrapped
    assert isinstance(env, Drive)
    env.reset(seed=0)
    env.put(circle(), 0.0, 0.0, 5.0)
    for _ in range(5):
        obs, *_ = drive([env], np.array([[action, 0.3]]))
    assert obs[0, 2] * sign * (-1 if variant else 1) > 0.3  # yaw rate


def test_on_flat_ground_distance_is_height_by_the_sine_of_the_angle() -> None:
    env = Drive()
    env.reset(seed=0)
    env.put(circle(), 0.0, 0.0, 0.0)
    distance, road = (part.ravel() for part in seen(env))
    eye = env.data.qpos[2] + env.physics.camera - GROUND
    with np.errstate(divide="ignore"):
        expected = np.where(RAYS[:, 2] < 0, -eye / RAYS[:, 2], np.inf)
    np.testing.assert_allclose(distance, np.minimum(expected, FARTHEST), rtol=1e-6)
    # The car looks along y from (CIRCLE, 0).
    at = np.column_stack([CIRCLE - distance * RAYS[:, 1], distance * RAYS[:, 0]])
    offset = np.abs(np.hypot(*at.T) - CIRCLE)
    sure = (distance < FARTHEST) & (np.abs(offset - HALF_WIDTH) > 0.1)
    assert sure.sum() > 200
    assert np.array_equal(road[sure], offset[sure] < HALF_WIDTH)
    assert not road[distance == FARTHEST].any()


def test_on_hills_distances_are_those_of_mujocos_rays() -> None:
    env = Drive()
    env.reset(seed=3)
    axes = np.array(rotated(env.data.qpos[None, 3:7]))[:, 0]
    rays, eye = (RAYS @ axes).ravel(), env.data.qpos[:3] + env.physics.camera * axes[2]
    exact, hit = np.empty(len(RAYS)), np.empty(len(RAYS), np.int32)
    within = None, len(RAYS), FARTHEST
    mujoco.mj_multiRay(env.model, env.data, eye, rays, GROUND_ALONE, 1, -1, hit, exact, *within)
    exact[hit < 0] = FARTHEST
    error = np.abs(seen(env)[0].ravel() - np.minimum(exact, FARTHEST))
    assert np.quantile(error, 0.95) < 0.2


def test_a_view_has_what_is_seen_and_measured() -> None:
    physics = dataclasses.replace(environment.NOMINAL, camera=0.5)
    image, numbers = View(1, physics).reset(0, seed=1)
    car = Drive(physics)
    car.reset(seed=1)
    distance, road = seen(car)
    np.testing.assert_allclose(image[..., 0] * (FARTHEST / 255), distance, atol=FARTHEST / 500)
    assert np.array_equal(image[..., 1] == 255, road)
    assert np.array_equal(numbers, look([car])[0][0, : camera.OWN])
