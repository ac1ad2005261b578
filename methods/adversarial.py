"""The game that adversarial methods play: a reward is fitted to tell demonstrations from what an agent does,
and the agent learns under it, in turn.

What the agent does is read from its replay, steps in the absorbing state included, as in Discriminator-Actor-
Critic (Kostrikov et al. 2019); where the model is known, from rollouts. Single iterates of either player
swing widely. So one rule finds pi* for all these methods, without the true reward: once the game is over,
reinforcement learning goes on under the mean of the latest rewards, and its best checkpoint there is pi*.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from methods.base import Agent, Payment, Policy, Reward, Transitions, World
from methods.rewards import MeanReward


class Turn(NamedTuple):
    """What the reward's player says once: what the agent is paid, and which R* that stands for."""

    payment: Reward | Payment
    reward: Reward


class Outcome(NamedTuple):
    """pi*, the last reward, and the mean of the latest."""

    policy: Policy
    last: Reward
    mean: MeanReward


@dataclass(frozen=True)
class Game:
    """Hyper-parameters of adversarial methods."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the reward's networks."""
    iterations: int = 30
    """Turns of each player."""
    rl_steps: int = 1000
    """Environment steps of each turn of the agent; of its first one, twice as many."""
    reward_steps: int = 100
    """Gradient steps of each turn of the reward."""
    learning_rate: float = 1e-3
    """Of Adam, of the reward."""
    batch: int = 256
    """Steps of demonstrations in each of those gradient steps, and as many of the agent's."""
    latest: int = 3000
    """Steps of the agent, its last, that are sampled from."""
    slope_penalty: float = 1.0
    """Weight of the reward's mean squared slope between the two (`methods.network.squared_slope`),
    observations being standardised."""
    averaged: int = 15
    """Latest rewards, of whose mean the agent learns at the end."""
    final_steps: int = 5000
    """Environment steps of that."""
    rollouts: int = 10
    """Episodes of random actions, with which observations are standardised; where the model is known, also of
    the agent in each turn."""

    def play(
        self,
        world: World,
        agent: Agent,
        first: Turn,
        answer: Callable[[Transitions], Turn],
        rng: np.random.Generator,
    ) -> Outcome:
        """Each player takes its turns, the agent under `first` to begin with, and the reward's by `answer` to
        the agent's latest steps."""
        turns = [first]
        for i in range(self.iterations):
            agent.learn(self.rl_steps * (2 if i == 0 else 1), turns[-1].payment)
            if world.model is None:
                seen = agent.replay().last(self.latest)
            else:
                seen = Transitions.of(world.rollout(agent.policy, self.rollouts, rng))
            turns.append(answer(seen))
        mean = MeanReward(tuple(turn.reward for turn in turns[1:][-self.averaged :]))
        agent.learn(self.final_steps, mean)
        return Outcome(agent.best(mean), turns[-1].reward, mean)
