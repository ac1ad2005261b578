"""The racing car is Gymnasium's, and small pictures show what Gymnasium's do."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from envs.racing.carracing import SPEC, STATES
from envs.scaled import scaled
from envs.spec import Array

pytest.importorskip("Box2D")

from envs.racing import picture
from envs.racing.environment import FRAMES, Racing

DECISIONS = 24


def driven(racing: Racing, decisions: int) -> Array:
    """Drive by the expert, and return the rewards."""
    assert STATES.controller is not None
    obs, rewards = racing.states(), list[float]()
    for _ in range(decisions):
        act = STATES.controller(obs[None].astype(np.float64))[0]
        obs, reward, ended, *_ = racing.step(act.astype(np.float32))
        rewards.append(reward)
        if ended:
            break
    return np.array(rewards)


def is_road(green: Any) -> Any:
    return (green >= 95) & (green <= 115)


@pytest.mark.parametrize("seed", [1, 2])
def test_physics_rewards_and_pictures_are_gymnasiums(seed: int) -> None:
    theirs, ours = scaled(gym.make("CarRacing-v3").unwrapped), Racing()
    theirs.reset(seed=seed)
    ours.reset(seed=seed)
    painted, rng = picture.ground(ours.car), np.random.default_rng(seed)
    for number in range(DECISIONS):
        act = np.clip(rng.normal([0, 0, -1], 0.5), -1, 1).astype(np.float32)
        steps = [theirs.step(act) for _ in range(FRAMES)]
        assert ours.step(act)[1] == sum(step[1] for step in steps)
        hull, other = ours.car.car.hull, theirs.unwrapped.car.hull  # type: ignore[attr-defined]
        assert (*hull.position, hull.angle, *hull.linearVelocity) == (
            *other.position,
            other.angle,
            *other.linearVelocity,
        )
        if number * FRAMES > 60 and number % 4 == 0:  # the zoom is over
            shown = steps[-1][0][:84].astype(int)  # above the bar
            road = is_road(shown[..., 1]) & (abs(shown[..., 0] - shown[..., 1]) < 12)
            drawn = is_road(picture.look(painted, ours.pose(), 84, 96))
            assert (road == drawn).mean() > 0.97
            assert road.mean() > 0.1


def test_a_small_picture_is_the_mean_of_the_large_one() -> None:
    view = picture.View(2)
    image, numbers = view.reset(1, 3)
    assert image.shape == (48, 48, 1)
    assert not numbers[1:5].any()
    images, numbers, _, _ = view.step([1], np.array([[0.5, 1.0, -1.0]]))
    large = picture.look(view._painted[1], view._racing[1].pose(), 96, 96)
    expected = large.reshape(48, 2, 48, 2).mean(axis=(1, 3)).astype(np.uint8)
    assert np.array_equal(images[0, ..., 0], expected)
    assert numbers.shape == (1, 7)
    assert numbers[0, 3] > numbers[0, 1]  # it is driven by its rear wheels
    assert numbers[0, 5] < 0  # to the right


@pytest.mark.parametrize("changed", [{}, *STATES.variants.values()], ids=["as trained", *STATES.variants])
def test_the_expert_completes_a_lap(changed: dict[str, float]) -> None:
    racing = Racing(**changed)
    racing.reset(seed=8)
    rewards = driven(racing, STATES.horizon)
    assert rewards.sum() > 850
    assert racing.ending == "lap complete"


def test_turned_and_slippery_change_what_they_say() -> None:
    straight, turned, slippery = Racing(), *(Racing(**changed) for changed in STATES.variants.values())
    for racing in (straight, turned, slippery):
        racing.reset(seed=4)
    assert np.array_equal(straight.centre, turned.centre)
    np.testing.assert_allclose(turned.pose()[1], straight.pose()[2], atol=0.1)
    assert {tile.road_friction for tile in slippery.car.road} == {0.8}


def test_far_off_the_track_an_episode_ends() -> None:
    racing = Racing()
    racing.reset(seed=0)
    for _ in range(STATES.horizon):
        _, reward, ended, *_ = racing.step(np.array([0, -0.4, -1], np.float32))
        if ended:
            break
    assert racing.ending == "left the field"
    assert reward < -90


def test_points_ahead_are_of_the_road() -> None:
    racing = Racing()
    obs, _ = racing.reset(seed=6)
    ahead, left = obs[5::2], obs[6::2]
    assert (np.diff(ahead) > 0).all()
    np.testing.assert_allclose(np.hypot(ahead, left)[:3], [4, 8, 12], rtol=0.1)
    assert len(obs) == STATES.obs_size == len(STATES.observations)
    assert SPEC.expert_task is STATES
    assert SPEC.controller is None
