"""Swing-ups and balanced poles: their equations are right, and what JAX compiles does as NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import jax
import numpy as np
import pytest

from envs.balancing import cartpole, cartpole_discrete
from envs.balancing.cartpole_discrete import DiscreteCartPole
from envs.balancing.pendulum import NOMINAL, RAIL, SPEC, Pendulum, Physics
from envs.dynamics import DynamicsEnv, runge_kutta
from envs.swingups import acrobot, cartpole_swingup, swingup
from harness.registry import SPECS
from harness.rl.ppo import JaxDraws

IDLE = np.zeros(1, np.float32)
LAGRANGE = [cartpole_swingup.Physics(pole_length=1.5), acrobot.Physics(length=1.5, mass=1.0)]
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


def test_swingup_is_gymnasiums_pendulum() -> None:
    gravity = 14.0
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


@pytest.mark.parametrize("physics", LAGRANGE, ids=["swing-up", "acrobot"])
def test_energy_stays_without_a_push(physics: Written) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        state = rng.uniform([-1, -2, -3, -5], [1, 2, 3, 5])
        before = energy(physics, state)
        for _ in range(100):
            state = physics.advance(state, IDLE)
        assert energy(physics, state) == pytest.approx(before, abs=1e-4 * (1 + abs(before)))


@pytest.mark.parametrize("physics", LAGRANGE, ids=["swing-up", "acrobot"])
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


def test_the_swing_ups_reward_and_end_are_rllabs() -> None:
    env = cartpole_swingup.SPEC.make()
    starts = np.array([env.reset(seed=seed)[0] for seed in range(500)])
    assert np.abs(starts[:, 0]).max() == pytest.approx(1, abs=0.02)
    assert starts[:, 2].max() == pytest.approx(-np.cos(1), abs=0.02)  # angles within 1 of hanging
    inner: Any = env.unwrapped
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
    hanging, out, upright = (np.pi / 2 * np.array([turns, turns, 0, 0]) for turns in (0, 1, 2))
    assert physics.pay(out, IDLE, hanging) == pytest.approx(-4)
    assert physics.pay(out, IDLE, upright) == pytest.approx(0)
    assert physics.pay(out, IDLE, out) == pytest.approx(-np.hypot(2, 2))
    np.testing.assert_allclose(physics.advance(upright, IDLE), upright, atol=1e-12)


NAMES = ("cartpole", "swingup", "cartpole_swingup", "acrobot")


def in_64_bits(function: Callable[..., Any]) -> Callable[..., Any]:
    compiled = jax.jit(function)

    def call(*arrays: Any) -> Any:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, compiled(*arrays))

    return call


@pytest.mark.parametrize("name", NAMES)
def test_a_compiled_step_is_that_of_the_task(name: str) -> None:
    spec, close, copies = SPECS[name], 1e-9, 100
    physics = spec.kwargs["physics"]
    compiled = in_64_bits(lambda s, a, p=physics: (p.advance(s, a), p.pay(s, a, p.advance(s, a))))
    told = in_64_bits(lambda s, p=physics: (p.observe(s), p.fails(s)))
    rng, endings = np.random.default_rng(0), 0
    state = np.stack([physics.start(np.random.default_rng(seed)) for seed in range(copies)], axis=1)
    for _ in range(200):
        act = rng.uniform(-1, 1, (physics.act_size, copies)).astype(np.float32)
        after = physics.advance(state, act.astype(float))
        theirs, paid = compiled(state, act.astype(float))
        size = np.maximum(np.abs(after).max(axis=0), 1.0)
        assert (np.abs(after - theirs) <= close * size).all()
        np.testing.assert_allclose(paid, physics.pay(state, act.astype(float), after), close, close)
        seen, ended = told(after)
        assert (np.abs(physics.observe(after) - seen) <= close * size).all()
        fails = physics.fails(after)
        assert np.array_equal(fails, ended)
        endings += int(fails.sum())
        state = np.array(after)
        for place in np.flatnonzero(fails):
            state[:, place] = physics.start(rng)
    assert endings > 0 or not name.startswith("cartpole")


@pytest.mark.parametrize("name", [*NAMES, "highway"])
def test_first_states_are_drawn_alike(name: str) -> None:
    physics = SPECS[name].kwargs["physics"]
    rng = np.random.default_rng(0)
    first = getattr(physics, "first", physics.start)  # the highway's draws one vehicle after the other
    ours = np.array([first(rng).ravel() for _ in range(4000)])
    with jax.enable_x64(True):
        keys = jax.random.split(jax.random.key(0), 4000)
        theirs = np.asarray(jax.vmap(lambda key: physics.start(JaxDraws(key)))(keys))
    spread = np.maximum(ours.std(axis=0), 1e-9)
    np.testing.assert_allclose((theirs.mean(axis=0) - ours.mean(axis=0)) / spread, 0, atol=0.1)
    np.testing.assert_allclose(theirs.std(axis=0), ours.std(axis=0), rtol=0.05, atol=1e-9)


OTHER = cartpole.Physics(
    **{"gravity": 5.0, "cart_mass": 2.0, "pole_mass": 0.4, "half_length": 0.8},
    **{"max_force": 15.0, "time_step": 0.03, "max_x": 0.2, "max_angle": 0.3},
)


@pytest.mark.parametrize("physics", [cartpole.NOMINAL, OTHER])
def test_the_cart_poles_dynamics_equal_gymnasiums_at_full_force(physics: cartpole.Physics) -> None:
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


def test_the_cart_poles_reward_is_rllabs() -> None:
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


def test_the_pendulum_is_gymnasiums_with_scaled_actions() -> None:
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
