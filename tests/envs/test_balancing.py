"""Carts that balance a pole are Gymnasium's, with scaled actions and RLLab's reward."""

import math

import gymnasium as gym
import numpy as np
import pytest

from envs.balancing import cartpole, cartpole_discrete
from envs.balancing.cartpole_discrete import DiscreteCartPole
from envs.balancing.pendulum import NOMINAL, RAIL, SPEC, Pendulum, Physics
from envs.dynamics import DynamicsEnv

OTHER = cartpole.Physics(
    **{"gravity": 5.0, "cart_mass": 2.0, "pole_mass": 0.4, "half_length": 0.8},
    **{"max_force": 15.0, "time_step": 0.03, "max_x": 0.2, "max_angle": 0.3},
)


@pytest.mark.parametrize("physics", [cartpole.NOMINAL, OTHER])
def test_dynamics_equal_gymnasiums_cartpole_at_full_force(physics: cartpole.Physics) -> None:
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
    env = DynamicsEnv(cartpole.NOMINAL)
    env.reset(seed=3)
    _, reward, failed, _, _ = env.step(np.array([0.5], np.float32))
    assert not failed
    assert reward == pytest.approx((10 - (1 - math.cos(env.state[2])) - 1e-5 * 5.0**2) / 10)
    while not failed:
        _, reward, failed, _, _ = env.step(np.array([1.0], np.float32))
    assert reward == 0.0


def test_two_actions_are_gymnasiums_and_full_force_left_and_right() -> None:
    two, one, theirs = cartpole_discrete.SPEC.make(), cartpole.SPEC.make(), gym.make("CartPole-v1")
    drawn = (cartpole_discrete.SPEC, two), (cartpole.SPEC, one)
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
            poles = [spec.draw(env)["pole"].points for spec, env in drawn]
            np.testing.assert_allclose(*poles, atol=1e-9)
            if failed:
                break
        assert failed


def test_it_is_gymnasiums_with_scaled_actions() -> None:
    ours, theirs = SPEC.make(), gym.make("InvertedPendulum-v5")
    rng = np.random.default_rng(0)
    for seed in range(5):
        assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for _ in range(200):  # against the rail's ends too
            action = rng.uniform(-1, 1, 1).astype(np.float32)
            obs, reward, terminated, truncated, _ = ours.step(action)
            expected = theirs.step(3 * action)
            assert np.array_equal(obs, expected[0])
            assert (reward, terminated, truncated) == expected[1:4]


@pytest.mark.parametrize("physics", [NOMINAL, Physics(gear=1000.0)])
def test_pendulums_in_lockstep_are_those_alone_against_the_rails_ends_too(physics: Physics) -> None:
    """Where the solver iterates, what it begins at decides the last bits."""
    ours, theirs = SPEC.batch(3, physics=physics), [Pendulum(physics) for _ in range(3)]
    for place, env in enumerate(theirs):
        assert np.array_equal(ours.reset(place, place), env.reset(seed=place)[0])
    rng, farthest = np.random.default_rng(0), 0.0
    for step in range(300):
        places = [0, 1, 2] if step % 7 else [2, 0]
        act = rng.uniform(-0.2, 1, (len(places), 1)) * (1 if step % 100 < 50 else -1)
        obs, _, fell, _ = ours.step(places, act)
        for row, place in enumerate(places):
            expected = theirs[place].step(act[row].astype(np.float32))
            assert np.array_equal(obs[row], expected[0])
            assert fell[row] == expected[2]
        farthest = max(farthest, np.abs(obs[:, 0]).max())
    assert farthest > RAIL


@pytest.mark.parametrize("physics", [NOMINAL, Physics(pole_length=0.9, pole_density=2000.0)])
def test_the_pole_is_a_capsule_of_its_length_and_density(physics: Physics) -> None:
    env = Pendulum(physics)
    radius, length = 0.049, np.hypot(0.001, physics.pole_length)
    volume = np.pi * radius**2 * (length + 4 / 3 * radius)
    assert env.model.body("pole").mass == pytest.approx(physics.pole_density * volume)
    assert env.model.body("pole").ipos[2] == pytest.approx(physics.pole_length / 2)
    env.reset(seed=0)
    foot, tip = SPEC.draw(env)["pole"].points
    assert np.linalg.norm(tip - foot) == pytest.approx(physics.pole_length)
