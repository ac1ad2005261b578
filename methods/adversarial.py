"""The game of adversarial methods: a reward learns to distinguish demonstrations from the agent's steps, and
the agent learns under that reward, in turn.

The agent's steps are read from its replay buffer, steps in the absorbing state included, as in
Discriminator-Actor-Critic (Kostrikov et al. 2019). For PPO the buffer is its latest bout. Single iterates of
either player swing widely. So all these methods find pi* by one rule, without the true reward. After the game
the agent learns on under the mean of all rewards, and pi* is its best checkpoint there. The mean is over all
because a player's average over the whole game converges. Early rewards also judge states that no later agent
visits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from methods.base import Agent, Array, Episodes, Payment, Policy, Reward, Rng, Transitions, World
from methods.network import ADAM, Contrast, contrast, standardiser
from methods.ranges import Between, Count, Hidden, Positive, Rate, Weight
from methods.rewards import MeanReward
from methods.visits import sample, seen_by_both


class Turn(NamedTuple):
    """A move of the reward's player: what the agent is paid, and the R* that this stands for."""

    payment: Reward | Payment
    reward: Reward


class Outcome(NamedTuple):
    """The result of a game: pi*, the last reward, and the mean of all."""

    policy: Policy
    last: Reward
    mean: MeanReward


@dataclass(frozen=True)
class Game:
    """Hyper-parameters of adversarial methods."""

    layers: Hidden = (64, 64)
    """Hidden layers of the reward's networks."""
    iterations: Count = 20
    """Turns of each player."""
    rl_share: Positive = 0.06
    """Environment steps of each turn of the agent, as a share of a solve from scratch."""
    reward_steps: Count = 100
    """Gradient steps of each turn of the reward."""
    learning_rate: Rate = 1e-3
    """Learning rate of the reward, by Adam."""
    batch: Count = 256
    """Demonstrated steps in each gradient step of the discriminator, and as many of the agent's."""
    latest: Count = 3000
    """Latest steps of the agent that are sampled from. PPO remembers fewer."""
    slope_penalty: Annotated[Weight, Between(0.01, 100)] = 1.0
    """Weight of the reward's mean squared slope between demonstrations and the agent's steps
    (`contrast_among_living`), on standardised observations."""
    final_share: Positive = 0.5
    """Environment steps under the mean of all rewards at the end, as a share of a solve from scratch."""
    rollouts: Count = 10
    """Episodes of random actions that standardise observations. Where the model is known, also episodes of
    the agent in each turn."""

    def standard(self, demos: Episodes, world: World, rng: Rng) -> tuple[Array, Array, torch.Generator]:
        """Return the mean and spread of observations, (O,) each, and the source of first weights."""
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        mean, std = standardiser(seen_by_both(demos, random, rng))
        return mean, std, torch.Generator().manual_seed(int(rng.integers(1 << 31)))

    def play(
        self,
        world: World,
        agent: Agent,
        propose: Callable[[], Turn],
        improve: Callable[[Transitions], None],
        rng: Rng,
    ) -> Outcome:
        """Alternate the players: the agent learns under each proposal, and its steps improve the next one."""
        turns = [propose()]
        for _ in range(self.iterations):
            agent.learn(math.ceil(self.rl_share * world.solve_steps), turns[-1].payment)
            improve(self.latest_steps(world, agent, rng))
            turns.append(propose())
        mean = MeanReward(tuple(turn.reward for turn in turns[1:]))
        agent.learn(math.ceil(self.final_share * world.solve_steps), mean)
        return Outcome(agent.best(mean), turns[-1].reward, mean)

    def latest_steps(self, world: World, agent: Agent, rng: Rng) -> Transitions:
        """Return the agent's latest steps, at most `latest`. Where the model is known it has no replay
        buffer, and plays `rollouts` episodes."""
        if world.model is not None:
            return Transitions.of(world.rollout(agent.policy, self.rollouts, rng))
        return agent.replay().last(self.latest)

    def discriminator(self, logit: nn.Module, generator: torch.Generator) -> Discriminator:
        """Return an untrained discriminator."""
        optimizer = torch.optim.Adam(logit.parameters(), self.learning_rate, **ADAM)
        return Discriminator(self, logit, optimizer, generator)


@dataclass(frozen=True)
class Discriminator:
    """A classifier of rows that describe steps. `logit`: of rows (B, K), (B, 1), log D - log(1 - D). D is the
    probability that a step is demonstrated."""

    game: Game
    logit: nn.Module
    optimizer: torch.optim.Optimizer
    generator: torch.Generator

    def learn(self, expert: Array, own: Array, rng: Rng) -> dict[str, float]:
        """Learn to distinguish expert rows (N, K) from own rows (M, K). Return points of curves, of the last
        batch: the logistic loss (1.39 if uninformed), the accuracy, and the mean entropy of D (0.69 at most).
        """
        for _ in range(self.game.reward_steps):
            d, e = (sample(visits, self.game.batch, rng) for visits in (expert, own))
            logits = contrast_among_living(self.logit, d, e, self.generator)
            errors = softplus(-logits.a).mean() + softplus(logits.b).mean()
            loss = errors + self.game.slope_penalty * logits.squared_slope
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
        both = torch.cat([logits.a, -logits.b]).detach()
        uncertain = torch.sigmoid(both) * softplus(-both) + torch.sigmoid(-both) * softplus(both)
        return {
            "discriminator's loss": errors.item(),
            "discriminator's accuracy": float((both > 0).double().mean()),
            "discriminator's entropy": float(uncertain.mean()),
        }


def contrast_among_living(network: nn.Module, a: Tensor, b: Tensor, generator: torch.Generator) -> Contrast:
    """Return the contrast of rows a (B, K) and b (B, K), whose last entry is the absorbing indicator. Its
    slope is over pairs of two living steps only. A step that terminates is a living one.

    The absorbing state has no neighbours. A penalty on the slope on the way there would pull its reward
    towards that of the mean observation, so that an end would pay more than a fall. The slope is along the
    indicators too. Without that, rewards retrained worse on the swing-up (`docs/tuning.md`).
    """
    return contrast(network, a, b, generator, (a[:, -1] == 0) & (b[:, -1] == 0))
