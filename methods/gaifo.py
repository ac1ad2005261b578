"""Generative adversarial imitation from observation (Torabi, Warnell & Stone 2018). It needs no actions.

As in GAIL, a discriminator D learns to distinguish demonstrated steps from the agent's, and its logit is the
agent's reward. It sees a state and the next one. At best the logit is the log ratio of their densities.

    R*(s, s') = log D(s, s') - log(1 - D(s, s')),   at best log(rho_E(s, s') / rho_pi(s, s'))

Where the dynamics are deterministic and every action leads elsewhere, (s, s') says as much as (s, a).

Deviates from the paper: the reward is the logit, where the paper's is -log D of a D that is 1 for the agent.
The reward of the absorbing state is learned, and the slope has a penalty, as in `methods.gail`. R* is the
mean of all logits, because single ones swing.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from methods.adversarial import Game, Turn
from methods.base import Array, Episodes, Learned, Rng, Transitions, Unsuitable, World
from methods.network import mlp
from methods.rewards import NetworkReward


@dataclass(frozen=True)
class GAIfO(Game):
    """GAIfO's hyper-parameters, which are the game's."""

    needs_actions: ClassVar[bool] = False
    """True if demonstrations must have actions."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Play the game. Raises Unsuitable unless every step is shown."""
        if not demos.whole:
            raise Unsuitable("GAIfO learns from demonstrations of which every step is shown")
        mean, std, generator = self.standard(demos, world, rng)
        logit = mlp(2 * world.obs_size + 1, *self.layers, 1, generator=generator)
        discriminator = self.discriminator(logit, generator)
        expert = changes(Transitions.of(demos).absorbed(), mean, std)

        def propose() -> Turn:
            reward = NetworkReward.of(logit, mean, std, actions=False, next_obs=True)
            return Turn(reward, reward)

        def improve(steps: Transitions) -> None:
            world.log(discriminator.learn(expert, changes(steps, mean, std), rng))

        result = self.play(world, world.agent(rng, kind="stochastic"), propose, improve, rng)
        return Learned(result.policy, result.mean)


def changes(steps: Transitions, mean: Array, std: Array) -> Array:
    """Return a row for each step, (N, 2 O + 1): the standardised observation, the next one, and the absorbing
    indicator. In the absorbing state it is all zeros and 1."""
    seen = np.concatenate([(obs - mean) / std for obs in (steps.obs, steps.next_obs)], axis=1)
    return np.column_stack([np.where(steps.absorbing[:, None], 0.0, seen), steps.absorbing])
