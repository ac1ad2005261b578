"""Generative adversarial imitation learning (Ho & Ermon 2016), with a learned reward of the absorbing state,
as Discriminator-Actor-Critic (Kostrikov et al. 2019).

A discriminator D of steps is fitted to tell demonstrations from what the agent does, and the agent is paid
its logit. At best that is the logarithm of the ratio of the two densities.

    R*(s, a) = log D(s, a) - log(1 - D(s, a)),   at best log(rho_E(s, a) / rho_pi(s, a))

R* is the last discriminator's logit, or the mean of all: in a zero-sum game it is the average of
a player's choices that converges, while the last need not (Freund & Schapire 1999; Syed & Schapire 2007;
Swamy et al. 2021).

Deviates from the papers: the gradient penalty is on the discriminator's squared slope, without the target of
1 that Kostrikov et al. have from Gulrajani et al. 2017, and among living steps alone
(`methods.adversarial.contrast_among_living`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.adversarial import Game, Turn
from methods.base import ABSORBING_STEPS, Episodes, Learned, Transitions, World
from methods.network import mlp
from methods.rewards import NetworkReward
from methods.visits import visitations, visited


@dataclass(frozen=True)
class GAIL(Game):
    """Its hyper-parameters, besides the game's."""

    actions: bool = True
    """Whether the discriminator sees actions, besides observations."""
    mean: bool = False
    """Whether R* is the mean of all logits, and not the last one."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Play the game."""
        mean, std, generator = self.standard(demos, world, rng)
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        logit = mlp(inputs, *self.layers, 1, generator=generator)
        discriminator = self.discriminator(logit, generator)
        shown = visitations(demos, ABSORBING_STEPS, mean, std, self.actions)
        losses: list[float] = []

        def turn() -> Turn:
            reward = NetworkReward.of(logit, mean, std, actions=self.actions)
            return Turn(reward, reward)

        def answer(seen: Transitions) -> Turn:
            losses.append(discriminator.tell(shown, visited(seen, mean, std, self.actions), rng))
            return turn()

        found = self.play(world, world.agent(rng, kind="stochastic"), turn(), answer, rng)
        reward = found.mean if self.mean else found.last
        return Learned(found.policy, reward, {"discriminator's loss": losses})
