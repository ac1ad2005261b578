"""Dynamics that are written once: their equations are right, and what JAX compiles does as NumPy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import jax
import numpy as np
import pytest

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


def test_copies_take_an_action_each() -> None:
    batch = swingup.SPEC.batch(3)
    for place in range(3):
        batch.reset(place, place)
    for act in (np.zeros((1, 1)), np.zeros((3, 2)), np.zeros(3)):
        with pytest.raises(ValueError, match="actions of 3 copies"):
            batch.step([0, 1, 2], act)


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
        after, (theirs, paid) = (
            physics.advance(state, act.astype(float)),
            compiled(state, act.astype(float)),
        )
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
