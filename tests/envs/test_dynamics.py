"""Dynamics that are written once: what JAX compiles of them does as NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from envs.dynamics import Dynamics, namespace
from harness.registry import SPECS
from harness.rl.ppo import JaxDraws

NAMES = ("cartpole", "swingup", "cartpole_swingup", "acrobot")
SEEDS, STEPS = 100, 1000
CLOSE = 1e-9


def physics_of(name: str) -> dict[str, Dynamics]:
    spec = SPECS[name]
    variants = {key: value["physics"] for key, value in spec.variants.items()}
    return {"nominal": spec.kwargs["physics"], **variants}


def in_64_bits(function: Callable[..., Any]) -> Callable[..., Any]:
    compiled = jax.jit(function)

    def call(*arrays: Any) -> Any:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, compiled(*arrays))

    return call


@pytest.mark.parametrize("name", NAMES)
def test_a_compiled_step_is_that_of_the_task(name: str) -> None:
    for physics in physics_of(name).values():
        compiled = in_64_bits(lambda s, a, p=physics: (p.advance(s, a), p.pay(s, a, p.advance(s, a))))
        told = in_64_bits(lambda s, p=physics: (p.observe(s), p.fails(s)))
        rng, endings = np.random.default_rng(0), 0
        state = np.stack([physics.start(np.random.default_rng(seed)) for seed in range(SEEDS)], axis=1)
        for _ in range(STEPS if physics == SPECS[name].kwargs["physics"] else STEPS // 10):
            act = rng.uniform(-1, 1, (physics.act_size, SEEDS)).astype(np.float32)
            after, (theirs, paid) = (
                physics.advance(state, act.astype(float)),
                compiled(state, act.astype(float)),
            )
            size = np.maximum(np.abs(after).max(axis=0), 1.0)
            assert (np.abs(after - theirs) <= CLOSE * size).all()
            np.testing.assert_allclose(paid, physics.pay(state, act.astype(float), after), CLOSE, CLOSE)
            seen, ended = told(after)
            assert (np.abs(physics.observe(after) - seen) <= CLOSE * size).all()
            fails = physics.fails(after)
            assert np.array_equal(fails, ended)
            endings += int(fails.sum())
            state = np.array(after)
            for place in np.flatnonzero(fails):
                state[:, place] = physics.start(rng)
        assert endings > 0 or not name.startswith("cartpole")


@pytest.mark.parametrize("name", NAMES)
def test_first_states_are_drawn_alike(name: str) -> None:
    (physics, *_) = physics_of(name).values()
    rng = np.random.default_rng(0)
    ours = np.array([physics.start(rng) for _ in range(4000)])
    with jax.enable_x64(True):
        keys = jax.random.split(jax.random.key(0), 4000)
        theirs = np.asarray(jax.vmap(lambda key: physics.start(JaxDraws(key)))(keys))
    spread = ours.std(axis=0)
    np.testing.assert_allclose((theirs.mean(axis=0) - ours.mean(axis=0)) / spread, 0, atol=0.1)
    np.testing.assert_allclose(theirs.std(axis=0), spread, rtol=0.05)


def test_the_namespace_is_that_of_the_array() -> None:
    assert namespace(np.zeros(1)) is np
    assert namespace(jax.numpy.zeros(1)) is jax.numpy
