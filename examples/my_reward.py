"""A method of one's own that learns a reward: a plug-in of one step of Abbeel and Ng's projection (2004)."""

from dataclasses import dataclass

import numpy as np

from irl_bench import Episodes, Learned, LinearReward, World


@dataclass(frozen=True)
class Difference:
    """The reward w^T phi(s, a), where w points from the features of random actions to those demonstrated."""

    rollouts: int = 10

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        shown, seen = (world.phi(*episodes.pairs()).mean(axis=0) for episodes in (demos, random))
        w = (shown - seen) / np.linalg.norm(shown - seen)
        absorbing = float(w @ seen)  # a step after termination pays what a random one does
        reward = LinearReward(world.phi, np.append(w, absorbing))
        return Learned(world.solve(reward, rng, world.solve_steps), reward)


METHODS = {"difference": Difference}
