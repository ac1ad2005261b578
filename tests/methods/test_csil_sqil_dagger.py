"""CSIL reads a clone as a reward, SQIL is paid for demonstrated steps, and DAgger asks where it comes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from envs.gridworld import grid, objectworld
from envs.learners import soft
from harness.registry import ENVS, SPECS
from methods.base import Array, Episodes, Transitions
from methods.bc import BehaviourCloning
from methods.csil import CSIL, UNIFORM, GaussianProcess, coherent_table, evidence
from methods.dagger import DAgger
from methods.settings import settings_for
from methods.sqil import SQIL, imitate, soft_q
from methods.tabular.model import discounted_visitations, soft_policy, soft_value_iteration, value_iteration
from tests.methods.worlds import FiniteWorld, demonstrate

pytestmark = pytest.mark.usefixtures("fused_adam")
METHOD = CSIL(steps=200, places=100, rollouts=5)


def wave(obs: Array) -> Array:
    return 0.8 * np.column_stack([np.sin(3 * obs[:, 0]), np.cos(2 * obs[:, 1])])


def fitted(noise: float = 0.0, count: int = 500) -> GaussianProcess:
    rng = np.random.default_rng(0)
    obs = rng.uniform(-1, 1, (count, 3))
    act = wave(obs) + noise * rng.normal(size=(count, 2))
    return GaussianProcess.fitted(obs, act, (np.zeros(3), np.ones(3)), 256, 0.01, rng)


@pytest.mark.parametrize("noise", [0.05, 0.3])
def test_the_evidence_is_the_density_of_a_gaussian_process(noise: float) -> None:
    rng = np.random.default_rng(0)
    features, act = 0.3 * rng.normal(size=(20, 4)), rng.normal(size=(20, 2))
    covariance = noise**2 * np.eye(20) + (UNIFORM**2 - noise**2) * features @ features.T
    density = sum(multivariate_normal(cov=covariance).logpdf(column) for column in act.T)
    squares, axes = np.linalg.eigh(features.T @ features)
    found = evidence(squares, axes.T @ features.T @ act, act, noise)
    assert found == pytest.approx(density + 20 * np.log(2 * np.pi))


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
    # A floor pays what q avoids, and breaks that.
    floored = soft_policy(soft_value_iteration(tabular.P, np.maximum(r, CSIL.floor), 0.9)[1])
    assert np.abs(floored - q).sum(axis=1).mean() > 0.3
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


def test_a_soft_agent_learns_from_both(world: Any) -> None:
    demos = demonstrate(lambda obs: obs[:, :2])
    learned = SQIL(rl_steps=700).fit(demos, world, np.random.default_rng(0))
    assert world.options == [{"kind": "soft", "demonstrations": demos}]
    assert world.solves == [(imitate, 700, False)]
    assert learned.reward is None
    obs, flags = np.zeros((4, 3)), np.array([False, True, False, True])
    steps = Transitions(obs, obs, obs, flags, flags, demonstrated=np.array([True, True, False, False]))
    np.testing.assert_array_equal(imitate(steps), [1, 1, 0, 0])


def test_where_the_model_is_known_it_is_paid_what_the_demonstrations_share_is() -> None:
    tabular = objectworld(4, 3, 2, 0.3, np.random.default_rng(0))
    world = FiniteWorld(tabular, horizon=40)
    demos = world.rollout(world.optimal(), 50, np.random.default_rng(1))
    shown = np.zeros(tabular.P.shape[:2])
    obs, act = demos.pairs()
    np.add.at(shown, (tabular.states(obs), act.argmax(axis=1)), 1)
    q = soft_q(shown, tabular.model, world.gamma, 300)
    # What it converges to: the soft Q of the share of demonstrations among them and what its policy visits.
    policy = soft_policy(q)
    own = discounted_visitations(tabular.P, policy, tabular.start, world.gamma)[:, None] * policy
    share = shown / shown.sum() / (shown / shown.sum() + own / own.sum())
    v = np.logaddexp.reduce(q, axis=1)
    np.testing.assert_allclose(q, share + world.gamma * tabular.P @ v, atol=0.05)
    # It does as the demonstrations do in the states that those visit most.
    learned = SQIL().fit(demos, world, np.random.default_rng(0))
    often = shown.sum(axis=1) > 0.02 * shown.sum()
    chosen = learned.policy(tabular.obs[often]).argmax(axis=1)
    best = value_iteration(tabular.P, tabular.reward, world.gamma)[1][often]
    regret = best.max(axis=1) - best[np.arange(len(best)), chosen]
    assert regret.max() < 0.05


BRIEF: dict[str, Any] = {"steps": 300}


def test_it_does_what_the_expert_does_where_it_comes() -> None:
    """Of one step that is shown a clone knows nothing of the way; asked, the expert tells it."""
    world = FiniteWorld(grid(5, 0.0), horizon=12)
    expert, far = world.optimal(), world.model.obs[:1]
    one = Episodes((far.copy(),), (expert(far),), (False,), times=(np.array([0]),), steps=(12,))
    start = np.flatnonzero(world.model.start)

    def wrong(method: BehaviourCloning) -> float:
        """Share of other choices than the expert's on the policy's own way."""
        learned = method.fit(one, world, np.random.default_rng(0))
        obs, act = world.rollout(learned.policy, 40, np.random.default_rng(1)).pairs()
        return float((act.argmax(axis=1) != expert(obs).argmax(axis=1)).mean())

    assert len(start) > 1
    assert wrong(BehaviourCloning(**BRIEF)) > 0.3
    assert wrong(DAgger(rounds=4, rollouts=20, **BRIEF)) < 0.02
