"""DAgger (Ross, Gordon & Bagnell 2011), algorithm 3.1: behaviour cloning that asks the expert what it would
do where its own policy leads, adds the answers to what it was shown, and clones again.

    D_(i+1) = D_i + (s, pi_E(s)) for s that pi_i visits,   pi_(i+1) = clone of D_(i+1)

It is told more than other methods are, and so it is a ceiling and no rival of theirs. It learns no reward.

Deviates from the paper: pi* is the last clone, not the best of all on validation. Whoever demonstrates, it is
the expert that answers. The paper's beta, by which the expert acts with a falling chance, is 1 in the first
iteration, whose episodes are the demonstrations, and 0 after it: its "parameter-free version".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.base import Episodes, Learned, World
from methods.bc import BehaviourCloning


@dataclass(frozen=True)
class DAgger(BehaviourCloning):
    """Its hyper-parameters, besides those of its clones."""

    rounds: int = 10
    """Policies that act, after that of the demonstrations."""
    rollouts: int = 5
    """Episodes of each, at every step of which the expert is asked."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Clone, act and ask in turn; pi* is the last clone, of all answers."""
        obs, act = demos.pairs()
        policy, losses = self.clone(obs, act, rng)
        ends = [losses[-1]]
        for _ in range(self.rounds):
            visited, _ = world.rollout(policy, self.rollouts, rng).pairs()
            obs, act = np.concatenate([obs, visited]), np.concatenate([act, world.ask(visited)])
            policy, losses = self.clone(obs, act, rng)
            ends.append(losses[-1])
        return Learned(policy, None, {"loss of each clone": ends})
