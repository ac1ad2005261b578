"""DAgger (Ross, Gordon & Bagnell 2011), algorithm 3.1: behaviour cloning that asks the expert for its actions
where its own policy leads, adds them to the demonstrations, and clones again.

    D_(i+1) = D_i + (s, pi_E(s)) for s that pi_i visits,   pi_(i+1) = clone of D_(i+1)

It learns no reward. It sees more than other methods do, so its scores are a ceiling for them.

Deviates from the paper: pi* is the last clone, not the best of all on validation. The expert answers, whoever
demonstrates. The paper's beta, by which the expert acts with a falling chance, is 1 in the first iteration,
whose episodes are the demonstrations, and 0 after it: its "parameter-free version".
"""

from dataclasses import dataclass

import numpy as np

from methods.base import Episodes, Learned, Rng, World
from methods.bc import BehaviourCloning
from methods.ranges import Count


@dataclass(frozen=True)
class DAgger(BehaviourCloning):
    """DAgger's hyper-parameters, besides those of its clones."""

    rounds: Count = 10
    """Clones that act, after the demonstrations."""
    rollouts: Count = 5
    """Episodes of each clone. The expert is asked at every step."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Clone, act and ask in turn. pi* is the last clone, of all answers."""
        obs, act = demos.pairs()
        policy, losses = self.clone(obs, act, rng)
        world.log({"loss of each clone": losses[-1]})
        for _ in range(self.rounds):
            visited, _ = world.rollout(policy, self.rollouts, rng).pairs()
            obs, act = np.concatenate([obs, visited]), np.concatenate([act, world.ask(visited)])
            policy, losses = self.clone(obs, act, rng)
            world.log({"loss of each clone": losses[-1]})
        return Learned(policy, None)
