"""Coherent soft imitation learning where the model is known: q is a table, its reward solved exactly."""

from dataclasses import dataclass

import numpy as np

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, World
from methods.tabular.model import TabularReward, demonstrated, known_model


@dataclass(frozen=True)
class TabularCSIL:
    """Hyper-parameters of `methods.csil.CSIL` where the model is known."""

    rl_steps: int = 40_000
    """Environment steps under R*, which an exact solve does not need."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Count actions, and solve for pi* under their reward."""
        model = known_model(world)
        reward = coherent_reward(demonstrated(demos, model).sum(axis=0) * len(demos), model)
        return Learned(world.solve(reward, rng, self.rl_steps), reward)


def coherent_reward(counts: Array, model: Model) -> TabularReward:
    """Return log q - log p. `counts` (S, A): demonstrations of each action. q is the mean of a Dirichlet
    posterior in each state, whose prior counts as one action."""
    actions = counts.shape[1]
    q = (counts + 1 / actions) / (counts.sum(axis=1, keepdims=True) + 1)
    return TabularReward(model.obs, np.log(q * actions))
