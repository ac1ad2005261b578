import math

import gymnasium as gym
import numpy as np
import pytest

from envs.balancing import cartpole_discrete
from envs.balancing.cartpole import NOMINAL, SPEC, Physics
from envs.balancing.cartpole_discrete import DiscreteCartPole
from envs.dynamics import DynamicsEnv

OTHER = Physics(
    gravity=5.0,
    cart_mass=2.0,
    pole_mass=0.4,
    half_length=0.8,
    max_force=15.0,
    time_step=0.03,
    max_x=0.2,
    max_angle=0.3,
)
PHYSICS = [NOMINAL, OTHER, *(made_with["physics"] for made_with in SPEC.variants.values())]


@pytest.mark.parametrize("physics", PHYSICS)
def test_dynamics_equal_gymnasiums_cartpole_at_full_force(physics: Physics) -> None:
    ours, theirs = DynamicsEnv(physics), DiscreteCartPole(physics)
    rng = np.random.default_rng(0)
    for seed in range(20):
        ours.reset(seed=seed)
        theirs.reset(seed=seed)
        assert np.array_equal(np.array(ours.state), theirs.state)
        failed = False
        while not failed:
            push = int(rng.integers(2))
            obs, _, failed, _, _ = ours.step(np.array([2.0 * push - 1], np.float32))
            expected, _, their_failed, _, _ = theirs.step(push)
            np.testing.assert_allclose(obs, expected, rtol=1e-6)
            assert failed == their_failed


def test_reward_is_rllabs() -> None:
    env = DynamicsEnv(NOMINAL)
    env.reset(seed=3)
    _, reward, failed, _, _ = env.step(np.array([0.5], np.float32))
    assert not failed
    assert reward == pytest.approx((10 - (1 - math.cos(env.state[2])) - 1e-5 * 5.0**2) / 10)
    while not failed:
        _, reward, failed, _, _ = env.step(np.array([1.0], np.float32))
    assert reward == 0.0


@pytest.mark.parametrize(
    ("state", "reason"), [((2.5, 0, 0, 0), "cart left the track"), ((0, 0, 0.3, 0), "pole fell")]
)
def test_why_it_ended(state: tuple[float, ...], reason: str) -> None:
    for spec in (SPEC, cartpole_discrete.SPEC):
        env = spec.make().unwrapped
        env.state = state  # type: ignore[attr-defined]
        assert spec.why_ended(env) == reason


def test_two_actions_are_gymnasiums_and_full_force_left_and_right() -> None:
    two, one, theirs = cartpole_discrete.SPEC.make(), SPEC.make(), gym.make("CartPole-v1")
    for seed in range(5):
        for env in (two, one, theirs):
            env.reset(seed=seed)
        failed = False
        for push in np.random.default_rng(seed).integers(2, size=500):
            obs, reward, failed, truncated, _ = two.step(cartpole_discrete.SPEC.native(np.eye(2)[push]))
            expected = theirs.step(push)
            assert np.array_equal(obs, expected[0])
            assert (reward, failed, truncated) == expected[1:4]
            one.step(np.array([2.0 * push - 1], np.float32))
            scenes = zip(cartpole_discrete.SPEC.draw(two).items(), SPEC.draw(one).items(), strict=True)
            for (name, shape), (its_name, its_shape) in scenes:
                assert name == its_name
                np.testing.assert_allclose(shape.points, its_shape.points, atol=1e-9)
            if failed:
                break
        assert failed


@pytest.mark.parametrize("physics", PHYSICS)
def test_the_pole_is_drawn_as_long_as_it_is(physics: Physics) -> None:
    env = DynamicsEnv(physics)
    env.reset(seed=0)
    foot, tip = SPEC.draw(env)["pole"].points
    assert np.linalg.norm(tip - foot) == pytest.approx(2 * physics.half_length)


def test_phi_is_one_at_the_centre_and_falls_to_zero_at_the_limits() -> None:
    obs = np.array([[0, 0, 0, 0], [2.4, 0, 12 * math.pi / 180, 0]], float)
    np.testing.assert_allclose(
        SPEC.features(obs, np.zeros((2, 1))), [[1, 1, 1, 1, 1], [0, 1, 0, 1, 1]], atol=1e-12
    )
