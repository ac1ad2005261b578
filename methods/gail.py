"""Generative adversarial imitation learning (Ho & Ermon 2016), with a learned reward of the absorbing state,
as Discriminator-Actor-Critic (Kostrikov et al. 2019).

A discriminator D learns to distinguish demonstrated steps from the agent's, and its logit is the agent's
reward. At best that is the log ratio of the two densities.

    R*(s, a) = log D(s, a) - log(1 - D(s, a)),   at best log(rho_E(s, a) / rho_pi(s, a))

R* is the last one or the mean. In a zero-sum game a player's average converges, while its last choice need
not (Freund & Schapire 1999; Syed & Schapire 2007; Swamy et al. 2021).

Deviates from the papers: the penalty is on the discriminator's squared slope. Kostrikov et al. have the
target of 1 of Gulrajani et al. 2017. It counts among living steps only
(`methods.adversarial.contrast_among_living`).
"""

from dataclasses import dataclass, replace

from methods.adversarial import Game, Turn
from methods.base import ABSORBING_STEPS, Episodes, Learned, Rng, Transitions, World
from methods.network import mlp
from methods.parts import TwoParts
from methods.rewards import NetworkReward
from methods.visits import visitations, visited


@dataclass(frozen=True)
class GAIL(TwoParts, Game):
    """GAIL's hyper-parameters, besides the game's."""

    actions: bool = True
    """True if the discriminator sees actions, besides observations."""
    mean: bool = False
    """True if R* is the mean of all logits, False if it is the last one."""

    @property
    def needs_actions(self) -> bool:
        """True if demonstrations must have actions."""
        return self.actions

    def first(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Play the game."""
        mean, std, generator = self.standard(demos, world, rng)
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        logit = mlp(inputs, *self.layers, 1, generator=generator)
        discriminator = self.discriminator(logit, generator)
        expert = visitations(demos, ABSORBING_STEPS, mean, std, self.actions)

        def propose() -> Turn:
            reward = NetworkReward.of(logit, mean, std, actions=self.actions)
            return Turn(reward, reward)

        def improve(steps: Transitions) -> None:
            world.log(discriminator.learn(expert, visited(steps, mean, std, self.actions), rng))

        result = self.play(world, world.agent(rng, kind="stochastic"), propose, improve, rng)
        return Learned(result.policy, result.last, others={"gail_mean": result.mean})

    def go_on(self, first: Learned, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Choose the reward."""
        return replace(first, reward=first.others["gail_mean"], others={}) if self.mean else first
