"""Soft Q imitation learning (Reddy, Dragan & Levine 2020): soft actor-critic that is paid for demonstrated
steps, and for its own not. Half of each batch is demonstrated. It has no discriminator, and no reward to be
retrained on.

    r = 1 for demonstrated steps,   r = 0 for its own

What it pays is never negative, and where episodes end an end pays 0: under protocol `native` it prefers to
live (docs/termination.md). pi* is what the agent does at last, for no reward tells its checkpoints apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from envs.spec import Model
from methods.base import Array, Episodes, Learned, Transitions, Unsuitable, World
from methods.tabular import (
    TabularPolicy,
    discounted_visitations,
    greedy,
    soft_policy,
    soft_value_iteration,
)
from methods.visits import demonstrated


@dataclass(frozen=True)
class SQIL:
    """Its hyper-parameters."""

    rl_steps: int = 40_000
    """Environment steps."""
    iterations: int = 100
    """Where the model is known: soft policies, each found from what those before it visit."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Learn from both. Raises Unsuitable where not every step of the demonstrations is shown."""
        if world.model is not None:
            q = soft_q(
                demonstrated(demos, world.model).sum(axis=0), world.model, world.gamma, self.iterations
            )
            return Learned(TabularPolicy(world.model.obs, greedy(q)), None)
        if not demos.whole:
            raise Unsuitable("SQIL learns from demonstrations of which every step is shown")
        agent = world.agent(rng, kind="soft", demonstrations=demos)
        agent.learn(self.rl_steps, imitate)
        return Learned(agent.policy, None)


def imitate(steps: Transitions) -> Array:
    """1 for demonstrated steps, and 0 for others."""
    return steps.demonstrated.astype(np.float64)


def soft_q(shown: Array, model: Model, gamma: float, iterations: int) -> Array:
    """(S, A): the soft Q of what a step is paid on average, the share of demonstrations among those like it.
    shown (S, A): demonstrated steps, which are half of all; the others are of all soft policies so far."""
    shown = shown / shown.sum()
    own = np.full_like(shown, 1 / shown.size)
    for i in range(iterations):
        _, q = soft_value_iteration(model.P, shown / (shown + own), gamma)
        policy = soft_policy(q)
        visits = discounted_visitations(model.P, policy, model.start, gamma)[:, None] * policy
        own += (visits / visits.sum() - own) / (i + 2)
    return q
