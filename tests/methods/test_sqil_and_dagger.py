"""SQIL is paid for demonstrated steps, and DAgger asks where its policy leads."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.gridworld import grid, objectworld
from methods.base import Episodes, Transitions
from methods.bc import BehaviourCloning
from methods.dagger import DAgger
from methods.sqil import SQIL, imitate, soft_q
from methods.tabular.model import discounted_visitations, soft_policy, value_iteration
from tests.methods.worlds import FiniteWorld, demonstrate


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
