"""Soft Q imitation learning (Reddy, Dragan & Levine 2020): soft actor-critic that is paid for demonstrated
steps, and not for its own. Half of each batch is demonstrated. It learns no discriminator and no reward.

    r = 1 for demonstrated steps,   r = 0 for its own

Payments are never negative. Under protocol `native` an end pays 0, so the agent prefers to live
(docs/termination.md). pi* is the last policy, because no reward can rank its checkpoints.

Deviates from the paper: soft actor-critic learns its weight of entropy, where the paper's is fixed. Under
protocol `absorbing` it also has to learn what the absorbing state is worth, and more steps can make it worse.
On the pendulum it then returns 5 to 112 on four seeds, and 249 to 1,000 under `native`
(`results/studies/sqil_ends.csv`, `sqil_steps.csv`).
"""

from dataclasses import dataclass

import numpy as np

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, Transitions, Unsuitable, World
from methods.ranges import Count
from methods.tabular import model as mdp
from methods.tabular.model import TabularPolicy, demonstrated


@dataclass(frozen=True)
class SQIL:
    """SQIL's hyper-parameters."""

    rl_steps: Count = 40_000
    """Environment steps."""
    iterations: Count = 100
    """Soft policies where the model is known, each solved for with the visits of those before it."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Learn from both. Raises Unsuitable unless every step is shown or the model is known."""
        if world.model is not None:
            shown = demonstrated(demos, world.model).sum(axis=0)
            q = soft_q(shown, world.model, world.gamma, self.iterations)
            return Learned(TabularPolicy(world.model.obs, mdp.greedy(q)), None)
        if not demos.whole:
            raise Unsuitable("SQIL learns from demonstrations of which every step is shown")
        agent = world.agent(rng, kind="soft", demonstrations=demos)
        agent.learn(self.rl_steps, imitate)
        return Learned(agent.policy, None)


def imitate(steps: Transitions) -> Array:
    """Return 1 for demonstrated steps and 0 for others, (N,)."""
    return steps.demonstrated.astype(np.float64)


def soft_q(expert: Array, model: Model, gamma: float, iterations: int) -> Array:
    """Return the soft Q of the expected payment of each step, (S, A).

    The payment is the share of demonstrated steps among all steps like it. `expert` (S, A): demonstrated
    steps, which are half of all. The other half is of all soft policies until then.
    """
    expert = expert / expert.sum()
    own = np.full_like(expert, 1 / expert.size)
    for i in range(iterations):
        _, q = mdp.soft_value_iteration(model.P, expert / (expert + own), gamma)
        policy = mdp.soft_policy(q)
        visits = mdp.discounted_visitations(model.P, policy, model.start, gamma)[:, None] * policy
        own += (visits / visits.sum() - own) / (i + 2)
    return q
