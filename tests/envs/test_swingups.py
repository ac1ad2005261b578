"""Dynamics that are written down here: the equations are right, and the tasks are the published ones."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from envs.balancing import cartpole
from envs.dynamics import DynamicsEnv, runge_kutta
from envs.swingups import acrobot, cartpole_swingup, swingup

IDLE = np.zeros(1, np.float32)
LAGRANGE = [cartpole_swingup.Physics(), acrobot.Physics()]
LAGRANGE += [made_with["physics"] for made_with in cartpole_swingup.SPEC.variants.values()]
LAGRANGE += [made_with["physics"] for made_with in acrobot.SPEC.variants.values()]
Written = cartpole_swingup.Physics | acrobot.Physics


def energy(physics: Written, state: np.ndarray) -> float:
    """Return kinetic and potential energy [J], relative to the hinge."""
    if isinstance(physics, acrobot.Physics):
        first, second, rate, other = state
        size, weight = physics.mass * physics.length**2, physics.mass * physics.gravity * physics.length
        moving = 2 / 3 * rate * rate + other * other / 6 + np.cos(first - second) / 2 * rate * other
        return float(size * moving - weight * (1.5 * np.cos(first) + np.cos(second) / 2))
    _, velocity, angle, rate = state
    moment = physics.pole_mass * physics.pole_length / 2
    inertia = physics.pole_mass * physics.pole_length**2 / 3
    moving = (physics.cart_mass + physics.pole_mass) * velocity**2 / 2 + inertia * rate**2 / 2
    return float(moving + moment * np.cos(angle) * (velocity * rate + physics.gravity))


@pytest.mark.parametrize("gravity", [10.0, 14.0])
def test_swingup_is_gymnasiums_pendulum(gravity: float) -> None:
    ours, theirs = DynamicsEnv(swingup.Physics(gravity=gravity)), gym.make("Pendulum-v1", g=gravity)
    rng = np.random.default_rng(0)
    for seed in range(10):
        assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for act in rng.uniform(-1, 1, (200, 1)).astype(np.float32):
            obs, reward, terminated, _, _ = ours.step(act)
            expected = theirs.step(2 * act)
            assert np.array_equal(obs, expected[0])
            assert reward == pytest.approx(float(expected[1]), rel=1e-7)  # a square may be rounded otherwise
            assert not terminated


@pytest.mark.parametrize("physics", LAGRANGE, ids=repr)
def test_energy_stays_without_a_push(physics: Written) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        state = rng.uniform([-1, -2, -3, -5], [1, 2, 3, 5])
        before = energy(physics, state)
        for _ in range(100):
            state = physics.advance(state, IDLE)
        assert energy(physics, state) == pytest.approx(before, abs=1e-4 * (1 + abs(before)))


@pytest.mark.parametrize("physics", LAGRANGE, ids=repr)
def test_power_is_force_times_velocity(physics: Written) -> None:
    rng, step = np.random.default_rng(1), 1e-5
    slides = isinstance(physics, cartpole_swingup.Physics)
    for _ in range(20):
        state, push = rng.uniform([-1, -2, -3, -5], [1, 2, 3, 5]), np.array(rng.uniform(-5, 5))
        moving = partial(physics.rates, **{"force" if slides else "torque": push})
        after, before = (runge_kutta(moving, state, seconds, 1) for seconds in (step, -step))
        power = (energy(physics, after) - energy(physics, before)) / (2 * step)
        velocity = state[1] if slides else state[3] - state[2]
        assert power == pytest.approx(float(push * velocity), abs=1e-4)


def test_runge_kutta_is_of_the_fourth_order() -> None:
    def error(parts: int) -> float:
        return abs(float(runge_kutta(lambda s: s, np.ones(1), 1.0, parts)[0]) - np.e)

    assert error(10) / error(20) == pytest.approx(16, rel=0.1)


def test_the_swing_up_cart_moves_like_the_balancing_one_without_steps() -> None:
    """Two derivations of one system."""
    ours = cartpole_swingup.Physics(gravity=9.8)
    short, shorter = cartpole.Physics(time_step=1e-7), cartpole_swingup.Physics(gravity=9.8, time_step=1e-7)
    rng = np.random.default_rng(2)
    for _ in range(20):
        state, act = rng.uniform(-1, 1, 4), rng.uniform(-1, 1, 1).astype(np.float32)
        expected = (short.advance(state, act) - state) / 1e-7
        np.testing.assert_allclose((shorter.advance(state, act) - state) / 1e-7, expected, atol=1e-4)
        force = np.float64(10 * act[0])
        np.testing.assert_allclose(ours.rates(state, force), expected, atol=1e-4)


def test_the_swing_ups_reward_and_end_are_rllabs() -> None:
    env = cartpole_swingup.SPEC.make()
    starts = np.array([env.reset(seed=seed)[0] for seed in range(500)])
    assert np.abs(starts[:, 0]).max() == pytest.approx(1, abs=0.02)
    assert np.abs(starts[:, 1]).max() == pytest.approx(2, abs=0.04)
    assert starts[:, 2].max() == pytest.approx(-np.cos(1), abs=0.02)  # angles within 1 of hanging
    assert np.abs(starts[:, 4]).max() == pytest.approx(3, abs=0.06)
    inner = env.unwrapped
    assert isinstance(inner, DynamicsEnv)
    inner.state = np.array([0.5, 0.0, 0.3, 0.0])
    obs, reward, terminated, _, _ = env.step(np.array([0.2], np.float32))
    assert reward == pytest.approx(obs[2])
    assert not terminated
    inner.state = np.array([2.99, 2.0, 0.3, 0.0])
    _, reward, terminated, _, _ = env.step(np.array([0.2], np.float32))
    assert (reward, terminated) == (-100.0, True)
    assert cartpole_swingup.SPEC.why_ended(env) == "cart left the track"


def test_the_acrobots_reward_is_the_tips_distance() -> None:
    physics = acrobot.NOMINAL
    hanging, upright, out = (
        np.zeros(4),
        np.array([np.pi, np.pi, 0, 0]),
        np.array([np.pi / 2, np.pi / 2, 0, 0]),
    )
    assert physics.pay(out, IDLE, hanging) == pytest.approx(-4)
    assert physics.pay(out, IDLE, upright) == pytest.approx(0)
    assert physics.pay(out, IDLE, out) == pytest.approx(-np.hypot(2, 2))
    np.testing.assert_allclose(physics.advance(hanging, IDLE), hanging, atol=1e-12)
    np.testing.assert_allclose(physics.advance(upright, IDLE), upright, atol=1e-12)


def test_the_acrobots_motor_pushes_both_links() -> None:
    """With no weight and nothing turning, a torque turns the second link one way and the first the other."""
    physics = acrobot.Physics(gravity=0.0)
    _, _, first, second = physics.rates(np.zeros(4), np.array(1.0))
    assert first < 0 < second
    momentum = 4 / 3 * first + second / 3 + (first + second) / 2  # about the hinge, of links in line
    assert momentum == pytest.approx(0, abs=1e-12)


def test_the_acrobots_rates_are_cut() -> None:
    state = np.array([0.3, -0.2, 100.0, 150.0])
    for _ in range(500):
        state = acrobot.NOMINAL.advance(state, np.ones(1))
        assert np.isfinite(state).all()
        assert np.abs(state[2:]).max() <= acrobot.NOMINAL.max_rate


def test_copies_take_an_action_each() -> None:
    batch = swingup.SPEC.batch(3)
    for place in range(3):
        batch.reset(place, place)
    for act in (np.zeros((1, 1)), np.zeros((3, 2)), np.zeros(3)):
        with pytest.raises(ValueError, match="actions of 3 copies"):
            batch.step([0, 1, 2], act)
