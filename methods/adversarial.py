"""The game that adversarial methods play: a reward is fitted to tell demonstrations from what an agent does,
and the agent learns under it, in turn.

What the agent does is read from what it remembers, steps in the absorbing state included, as in
Discriminator-Actor-Critic (Kostrikov et al. 2019): of PPO that is its latest bout. Where the model is known,
it is read from rollouts. Single iterates of either player
swing widely. So one rule finds pi* for all these methods, without the true reward: once the game is over,
reinforcement learning goes on under the mean of rewards, and its best checkpoint there is pi*. Of all,
for it is a player's average over the whole game that converges, and early rewards say what is wrong with
states that no later agent visits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import softplus

from methods.base import Agent, Array, Episodes, Payment, Policy, Reward, Transitions, World, seen_by_both
from methods.network import ADAM, Contrast, contrast, standardiser
from methods.rewards import MeanReward
from methods.visits import sample


class Turn(NamedTuple):
    """What the reward's player says once: what the agent is paid, and which R* that stands for."""

    payment: Reward | Payment
    reward: Reward


class Outcome(NamedTuple):
    """pi*, the last reward, and the mean of all."""

    policy: Policy
    last: Reward
    mean: MeanReward


@dataclass(frozen=True)
class Game:
    """Hyper-parameters of adversarial methods."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the reward's networks."""
    iterations: int = 20
    """Turns of each player."""
    rl_share: float = 0.06
    """Environment steps of each turn of the agent, of those of a solve from scratch."""
    reward_steps: int = 100
    """Gradient steps of each turn of the reward."""
    learning_rate: float = 1e-3
    """Of Adam, of the reward."""
    batch: int = 256
    """Steps of demonstrations in each of the discriminator's gradient steps, and as many of the agent's."""
    latest: int = 3000
    """Steps of the agent, its last, that are sampled from; an agent that learns by PPO remembers fewer."""
    slope_penalty: float = 1.0
    """Weight of the reward's mean squared slope between the two (`contrast_among_living`), observations being
    standardised."""
    final_share: float = 0.5
    """Environment steps under the mean of all rewards at the end, of those of a solve from scratch."""
    rollouts: int = 10
    """Episodes of random actions, with which observations are standardised; where the model is known, also of
    the agent in each turn."""

    def standard(
        self, demos: Episodes, world: World, rng: np.random.Generator
    ) -> tuple[Array, Array, torch.Generator]:
        """Mean and spread (O,) of observations, and what networks begin with."""
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        mean, std = standardiser(seen_by_both(demos, random, rng))
        return mean, std, torch.Generator().manual_seed(int(rng.integers(1 << 31)))

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
        for _ in range(self.iterations):
            agent.learn(math.ceil(self.rl_share * world.solve_steps), turns[-1].payment)
            if world.model is None:
                seen = agent.replay().last(self.latest)
            else:
                seen = Transitions.of(world.rollout(agent.policy, self.rollouts, rng))
            turns.append(answer(seen))
        mean = MeanReward(tuple(turn.reward for turn in turns[1:]))
        agent.learn(math.ceil(self.final_share * world.solve_steps), mean)
        return Outcome(agent.best(mean), turns[-1].reward, mean)

    def discriminator(self, logit: torch.nn.Module, generator: torch.Generator) -> Discriminator:
        """One that has not learned yet."""
        optimizer = torch.optim.Adam(logit.parameters(), self.learning_rate, **ADAM)
        return Discriminator(self, logit, optimizer, generator)


@dataclass(frozen=True)
class Discriminator:
    """Tells demonstrated steps from others, by rows that describe them. logit: of such rows (B, K), (B, 1):
    log D - log(1 - D), D being the probability that one is demonstrated."""

    game: Game
    logit: torch.nn.Module
    optimizer: torch.optim.Optimizer
    generator: torch.Generator

    def tell(self, shown: Array, own: Array, rng: np.random.Generator) -> float:
        """Learn to tell shown (N, K) from own (M, K). Its logistic loss at the end, 1.39 where it knows
        nothing."""
        for _ in range(self.game.reward_steps):
            d, e = (sample(visits, self.game.batch, rng) for visits in (shown, own))
            said = contrast_among_living(self.logit, d, e, self.generator)
            errors = softplus(-said.a).mean() + softplus(said.b).mean()
            loss = errors + self.game.slope_penalty * said.squared_slope
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
        return errors.item()


def contrast_among_living(
    network: torch.nn.Module, a: torch.Tensor, b: torch.Tensor, generator: torch.Generator
) -> Contrast:
    """Return the contrast of rows a (B, K) and b (B, K), whose last entry is the absorbing indicator. Its
    slope is between those pairs alone of which both are living steps, one that ends being one.

    The absorbing state is beside no other: were the slope on all the way there penalised too, it would pay
    almost what the mean of observations does, and an end more than a fall. Slopes are along the indicators as
    well; without that, rewards retrained worse on the swing-up (`docs/tuning.md`).
    """
    return contrast(network, a, b, generator, (a[:, -1] == 0) & (b[:, -1] == 0))
