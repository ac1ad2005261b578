"""The game of adversarial methods where the model is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.adversarial import Game
from methods.base import Agent, Transitions, World


@dataclass(frozen=True)
class TabularGame(Game):
    """A game against an agent that solves for its policy. It has no replay buffer, so its steps are
    rollouts."""

    def latest_steps(self, world: World, agent: Agent, rng: np.random.Generator) -> Transitions:
        """Return the steps of `rollouts` episodes of the agent's policy."""
        return Transitions.of(world.rollout(agent.policy, self.rollouts, rng))
