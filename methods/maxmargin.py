"""Apprenticeship learning by maximum margin (Abbeel & Ng 2004).

    t(i) = max over |w| <= 1 of min over j < i of w^T (mu_E - mu(j))     (thesis, eq. 3.2)

`maxmargin_projection` has w from the paper's simpler projection method instead (its section 3.1).

The reward is w^T phi. mu(j) are discounted feature expectations of the policies so far, and mu_E those of the
demonstrations. Features are the environment's, random Fourier features where the model is not known, and one
for the absorbing state, where all others are 0. Every episode is counted up to the horizon, so the reward of
absorption is learned as well. The loop is `methods.margins.Margins.alternate`.

Deviates from the paper: where the model is not known, "solve the MDP" is reinforcement learning that goes on
a little under each new w. Feature expectations come from a few rollouts, so a later policy may be further
from the expert. The paper ends with a mixture of all policies, or one chosen by hand. Here R* has the mean of
the w, each counting by its margin, and the agent learns under that last. pi* is the policy that the margin
problem separates least from the expert by itself, the one with the smallest |mu_E - mu(j)|.
"""

from dataclasses import dataclass

import numpy as np

from methods.base import Array, Episodes, Learned, Phi, Policy, Rng, World
from methods.fourier import FourierFeatures
from methods.margins import Margins, feature_expectations
from methods.tabular import tabular
from methods.tabular.maxmargin import TabularMaxMargin
from methods.visits import seen_by_both


@dataclass(frozen=True)
class MaxMargin(Margins):
    """Hyper-parameters, besides the loop's."""

    rollouts: int = 10
    """Episodes that estimate a policy's feature expectations."""
    waves: int = 200
    """Random Fourier features besides the environment's, where the model is not known."""
    width: float = 0.5
    """Width of their kernel in standard deviations of its inputs, times the root of the number of inputs."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Alternate weights and reinforcement learning, with feature expectations from rollouts."""
        if world.model is not None:
            return tabular(TabularMaxMargin, self).fit(demos, world, rng)
        phi: Phi = world.phi
        if self.waves:
            random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
            width = self.width * np.sqrt(world.obs_size + world.act_size)
            both = seen_by_both(demos, random, rng)
            phi = FourierFeatures.drawn(phi, both, world.act_size, self.waves, width, rng)

        def expectations(policy: Policy) -> Array:
            return feature_expectations(world.rollout(policy, self.rollouts, rng), world, phi)

        return self.alternate(feature_expectations(demos, world, phi), expectations, phi, world, rng)
