"""The game of adversarial methods where the model is known."""

from dataclasses import dataclass

from methods.adversarial import Game
from methods.base import Agent, Rng, Transitions, World


@dataclass(frozen=True)
class TabularGame(Game):
    """A game against an agent without a replay buffer. Its steps are rollouts of its exact policy."""

    def latest_steps(self, world: World, agent: Agent, rng: Rng) -> Transitions:
        """Return the steps of `rollouts` episodes of the agent's policy."""
        return Transitions.of(world.rollout(agent.policy, self.rollouts, rng))
