"""Soft Q imitation learning where the model is known: soft values of expected payments."""

from dataclasses import dataclass

import numpy as np

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, World
from methods.tabular import model as mdp
from methods.tabular.model import TabularPolicy, demonstrated, known_model


@dataclass(frozen=True)
class TabularSQIL:
    """Hyper-parameters of `methods.sqil.SQIL` where the model is known."""

    iterations: int = 100
    """Soft policies, each solved for with the visits of those before it."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Act greedily by the last soft Q."""
        model = known_model(world)
        q = soft_q(demonstrated(demos, model).sum(axis=0), model, world.gamma, self.iterations)
        return Learned(TabularPolicy(model.obs, mdp.greedy(q)), None)


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
