"""A cloned policy read as a reward."""

from typing import Any

import numpy as np
import pytest

from envs.gridworld import objectworld
from envs.learners import soft
from harness.registry import ENVS, SPECS
from methods.base import Array
from methods.csil import CSIL, UNIFORM, GaussianProcess, coherent_table
from methods.settings import settings_for
from methods.tabular.model import soft_policy, soft_value_iteration
from tests.methods.worlds import demonstrate

pytestmark = pytest.mark.usefixtures("fused_adam")
METHOD = CSIL(steps=200, places=100, rollouts=5)


def wave(obs: Array) -> Array:
    return 0.8 * np.column_stack([np.sin(3 * obs[:, 0]), np.cos(2 * obs[:, 1])])


def fitted(noise: float = 0.0, count: int = 500) -> GaussianProcess:
    rng = np.random.default_rng(0)
    obs = rng.uniform(-1, 1, (count, 3))
    act = wave(obs) + noise * rng.normal(size=(count, 2))
    return GaussianProcess.fitted(obs, act, (np.zeros(3), np.ones(3)), 256, 0.01, rng)


def test_where_the_model_is_known_q_is_the_soft_optimal_policy_of_its_reward() -> None:
    tabular = objectworld(4, 3, 2, 0.3, np.random.default_rng(0))
    counts = np.random.default_rng(1).integers(0, 6, tabular.P.shape[:2])
    reward = coherent_table(counts, tabular.model)
    states, actions = counts.shape
    obs = np.repeat(tabular.obs, actions, axis=0)
    r = reward(obs, np.tile(np.eye(actions), (states, 1)), obs).reshape(states, actions)
    q = (counts + 1 / actions) / (counts.sum(axis=1, keepdims=True) + 1)
    found = soft_policy(soft_value_iteration(tabular.P, r, 0.9)[1])
    np.testing.assert_allclose(found, q, atol=1e-6)
    # Where nothing was demonstrated it pays nothing.
    np.testing.assert_allclose(r[counts.sum(axis=1) == 0], 0, atol=1e-12)


def test_q_is_sure_near_demonstrations_and_the_prior_far_from_them() -> None:
    assert fitted(noise=0.1).noise == 0.1
    q, rng = fitted(), np.random.default_rng(1)
    assert q.noise == 0.01
    near, far = rng.uniform(-0.8, 0.8, (200, 3)), rng.uniform(-1, 1, (200, 3)) + 100
    mean, variance = q(near)
    assert np.abs(mean - wave(near)).mean() < 0.05
    assert np.sqrt(variance).mean() < 0.1
    mean, variance = q(far)
    np.testing.assert_allclose(np.sqrt(variance), UNIFORM)
    np.testing.assert_allclose(mean, 0, atol=1e-9)


def test_the_agent_goes_on_from_the_clone_and_learns_from_the_demonstrations(world: Any) -> None:
    demos = demonstrate(wave, count=30)
    learned: Any = METHOD.fit(demos, world, np.random.default_rng(0))
    ((reward, steps, warm),) = world.solves
    assert reward is learned.reward
    assert (steps, warm) == (METHOD.rl_steps, False)
    (given,) = world.options
    assert given["kind"] == "soft"
    assert given["demonstrations"] is demos
    obs = np.random.default_rng(1).uniform(-0.8, 0.8, (100, 3))
    assert np.abs(given["init"](obs) - wave(obs)).mean() < 0.1
    # No step pays less than an end.
    paid = learned.reward(obs, -wave(obs), obs)
    assert paid.min() == learned.reward.absorbing
    # Where some steps are not shown it learns from itself alone.
    METHOD.fit(demos.every(2, np.random.default_rng(0)), world, np.random.default_rng(0))
    assert world.options[1]["demonstrations"] is None


@pytest.mark.parametrize("env", [name for name in ENVS if not SPECS[name].discrete])
def test_it_clones_what_the_actor_can_begin_as(env: str) -> None:
    clone = settings_for("csil", env, "full").get("layers", CSIL.layers)
    for learner in (SPECS[env].rl, SPECS[env].ddpg):
        assert clone == soft(learner, discrete=False).net
