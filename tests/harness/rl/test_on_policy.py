"""What PPO of our own learns from: the task's own steps, paid as ends and the absorbing state ask."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

from envs import EnvSpec
from envs.driving.environment import drive, look
from envs.learners import PPO
from harness.registry import SPECS
from harness.rl import ppo
from harness.rl.on_policy import OnPolicy, dynamics_of
from harness.rl.ppo import Kind
from harness.rl.solving import Agent
from harness.rl.training_env import TrainingEnv
from methods.base import ABSORBING_STEPS, Array, Transitions
from methods.stochastic import Gaussian, Softmax

SMALL = PPO(copies=4, steps=600, batch=600, epochs=1, net=(8,))


def steps_of(spec: EnvSpec, settings: PPO = SMALL) -> tuple[Transitions, Array]:
    """The steps (T, N) of one bout, one after the other, and what the environment paid for them."""
    seen: list[tuple[Transitions, Array]] = []

    class Watched(TrainingEnv):
        def paid(self, steps: Transitions, true: Array) -> Array:
            seen.append((steps, true))
            return super().paid(steps, true)

    env = Watched(spec, "absorbing", np.random.default_rng(0), settings.copies)
    OnPolicy(env, settings, 0).learn(settings.unit, lambda progress: 1e-3, lambda taken: None, 0.0)
    return seen[0]


def test_steps_of_the_compiled_loop_are_the_tasks() -> None:
    spec = SPECS["cartpole"]
    physics: Any = dynamics_of(spec)
    steps, true = steps_of(spec)
    obs, act, after = steps.obs.T, steps.act.T, steps.next_obs.T
    np.testing.assert_allclose(physics.advance(obs, act), after, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(physics.pay(obs, act, after), true, atol=1e-6)
    assert np.array_equal(physics.fails(after), steps.next_absorbing)
    assert np.abs(act).max() <= 1
    assert (np.abs(act) == 1).any()
    ended = steps.next_absorbing.reshape(SMALL.steps, SMALL.copies)
    following, last = (o.reshape(SMALL.steps, SMALL.copies, -1) for o in (steps.obs, steps.next_obs))
    begun = (following[1:] != last[:-1]).any(axis=2)
    assert begun[ended[:-1]].all()
    assert (np.abs(following[1:][begun]) <= 0.05 + 1e-6).all()


def test_steps_of_compiled_traffic_are_those_of_the_batch() -> None:
    spec, copies, count = SPECS["highway"], 64, 80
    physics: Any = dynamics_of(spec)
    settings = PPO(copies=copies, steps=count, batch=copies * count, net=(8,))
    kind = Kind(settings, spec.obs_size, spec.act_size, spec.discrete, spec.gamma)
    first, collect = ppo.collector(kind, physics, spec.horizon)
    params, scale = ppo.functions(kind).begin(jax.random.key(0)).params, np.ones(spec.obs_size, np.float32)
    with jax.enable_x64(True):
        scene = first(jax.random.key(1))
        begun = np.asarray(scene[0])
        _, seen = collect(params, scene, scale, jax.random.key(2))
    states = begun.T.reshape(copies, 12, -1).copy()
    act = np.clip(np.asarray(seen.act), -1, 1)
    ended = np.asarray(seen.terminated | seen.cut)
    going = np.arange(copies)  # those whose first episode lasts
    for time in range(spec.horizon):
        np.testing.assert_allclose(np.asarray(seen.obs)[time, going], look(states[going]), atol=1e-5)
        after, paid, terminated = drive(states, going, act[time, going])
        np.testing.assert_allclose(np.asarray(seen.next_obs)[time, going], after, atol=1e-5)
        np.testing.assert_allclose(np.asarray(seen.true)[time, going], paid, atol=1e-6)
        assert np.array_equal(np.asarray(seen.terminated)[time, going], terminated)
        going = going[~ended[time, going]]
        if not len(going):
            break
    assert np.asarray(seen.terminated).any()
    assert np.asarray(seen.cut).any()
    assert not len(going)


def test_an_episode_is_cut_at_the_horizon_and_first_ones_at_even_intervals() -> None:
    spec = SPECS["swingup"]
    steps, _ = steps_of(spec)
    obs, after = (o.reshape(SMALL.steps, SMALL.copies, -1) for o in (steps.obs, steps.next_obs))
    for copy in range(SMALL.copies):
        (cuts,) = np.nonzero((obs[1:, copy] != after[:-1, copy]).any(axis=1))
        first = spec.horizon - copy * spec.horizon // SMALL.copies
        assert (cuts + 1).tolist() == list(range(first, SMALL.steps, spec.horizon))
    assert not steps.next_absorbing.any()


@pytest.mark.parametrize(("protocol", "forever"), [("absorbing", 1.0), ("state", 1.0), ("native", 0.0)])
def test_what_the_absorbing_state_pays_for_ever_is_part_of_the_last_step(
    fragile: EnvSpec, protocol: str, forever: float
) -> None:
    env = TrainingEnv(fragile, protocol, np.random.default_rng(0), 1)
    env.reward = lambda steps: np.where(steps.absorbing, -2.0, 1.0)
    ends = np.array([False, True])
    steps = Transitions.own(np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros(2, bool), ends)
    beyond = forever * fragile.gamma * -2.0 / (1 - fragile.gamma)
    np.testing.assert_allclose(env.paid(steps, np.zeros(2)), [1.0, 1.0 + beyond])


def test_it_tells_its_latest_steps_and_what_it_draws_from() -> None:
    agent = Agent(SPECS["cartpole"], "absorbing", np.random.default_rng(0), "sbx", SMALL)
    agent.learn(2 * SMALL.unit, None)
    seen = agent.replay()
    ends = int((seen.next_absorbing & ~seen.absorbing).sum())
    assert len(seen) == SMALL.unit + ABSORBING_STEPS * ends
    assert seen.absorbing.sum() == ABSORBING_STEPS * ends > 0
    assert isinstance(agent.behaviour, Gaussian)
    choosing = Agent(SPECS["cartpole_discrete"], "absorbing", np.random.default_rng(0), "sbx", SMALL)
    choosing.learn(SMALL.unit, None)
    assert isinstance(choosing.behaviour, Softmax)
    assert set(choosing.replay().act.ravel()) == {0.0, 1.0}


@pytest.mark.parametrize("shape", [(4, 64), (64, 64), (64, 3), (3, 1), (256, 256)])
def test_first_weights_are_those_of_jaxs_orthogonal_initializer(shape: tuple[int, int]) -> None:
    key = jax.random.key(7)
    theirs = jax.nn.initializers.orthogonal(2**0.5)(key, shape)
    assert np.array_equal(ppo._orthogonal(key, *shape, 2**0.5), theirs)
