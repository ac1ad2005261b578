"""The shaped-reward model's policy, with the reward of states of D-REX (Brown, Goo & Niekum 2019).

R of eq. 4.3 is 0, its best, wherever the action is f(s): it says how to act in a state, and nothing about
which state to be in. Here the policy is f, fitted as in `methods.shaped`, and the reward is one of states
alone, by which f is the better the fewer of its actions are replaced by random ones. It is learned from these
comparisons by logistic regression (Bradley & Terry 1952) on sums of rewards, and touches the environment for
the rollouts alone. Only where `rl_steps` says so there is a little reinforcement learning: R* may pay well
for states that no rollout visits. RL finds them, and what it does then ranks last.

Deviates from the paper: states that are compared are drawn from all of a level's episodes, where the paper
compares stretches of two of them; rewards are bounded. The networks see an absorbing indicator, and episodes
that terminated count absorbing steps up to the horizon, so what absorption pays is learned as well. Where
demonstrations terminate less often than random actions it pays at most the least that a visited state does;
without this RL on cart-pole failed once (`docs/tuning.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import softplus

from methods.base import Episodes, Learned, Reward, World, roughened
from methods.maxent import visitations
from methods.network import descend, mlp, standardiser
from methods.rewards import MeanReward, NetworkReward, deterred, paid
from methods.shaped import Shaped

SEEN = 1000
"""Observations of each level, by whose spread they are standardised."""


@dataclass(frozen=True)
class ShapedRanked(Shaped):
    """Its hyper-parameters, besides those of `Shaped`."""

    levels: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
    """Shares of random actions, ascending."""
    rollouts: int = 10
    """Episodes of each."""
    comparisons: int = 2000
    """Of two levels each."""
    compared: int = 50
    """States of either."""
    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the reward's networks."""
    networks: int = 3
    """Of whose rewards R* is the mean."""
    reward_steps: int = 500
    """Gradient steps on each network, and how many comparisons each is the mean of."""
    reward_batch: int = 32
    reward_rate: float = 1e-3
    """Learning rate of these."""

    rl_steps: int | None = None
    """Environment steps of reinforcement learning under a first reward; what it then does ranks below all
    levels. None is no such solve."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Fit f as `Shaped` does, then the reward by comparisons."""
        learned = super().fit(demos, world, rng)
        policies = [roughened(learned.policy, share, world.random_actions, rng) for share in self.levels]
        ladder = [world.rollout(policy, self.rollouts, rng) for policy in policies]
        reward, curves = self._rank(ladder, demos, world, rng)
        if self.rl_steps is not None:
            agent = world.agent(rng)
            agent.learn(self.rl_steps, reward)
            ladder.append(world.rollout(agent.policy, self.rollouts, rng))
            reward, curves = self._rank(ladder, demos, world, rng)
        return Learned(learned.policy, reward, {**learned.curves, **curves})

    def _rank(
        self, ladder: Sequence[Episodes], demos: Episodes, world: World, rng: np.random.Generator
    ) -> tuple[Reward, dict[str, Sequence[float]]]:
        """A reward by which each of the ladder's episodes are better than those after it, and the losses."""
        mean, std = standardiser(np.concatenate([rng.choice(e.pairs()[0], SEEN) for e in ladder]))
        visits = [visitations(e, world.horizon, mean, std, actions=False) for e in ladder]
        pairs = np.sort([rng.choice(len(visits), 2, replace=False) for _ in range(self.comparisons)])
        both = [np.stack([rng.choice(visits[i], self.compared) for i in side]) for side in pairs.T]
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        random = ladder[len(self.levels) - 1]
        rewards, curves = list[Reward](), dict[str, Sequence[float]]()
        for i in range(self.networks):
            network = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)

            def loss(
                better: torch.Tensor, worse: torch.Tensor, network: torch.nn.Module = network
            ) -> torch.Tensor:
                r, other = (torch.tanh(network(x.flatten(0, 1))) for x in (better, worse))
                return softplus((other - r).view(len(better), -1).sum(1)).mean()

            curves[f"ranking loss, network {i}"] = descend(
                loss, [network], both, self.reward_rate, self.reward_steps, self.reward_batch, rng
            )
            reward = NetworkReward.of(network, mean, std, bound=1.0, actions=False)
            least = min(float(paid(reward, episodes).min()) for episodes in ladder)
            rewards.append(deterred(reward, demos, random, least))
        return MeanReward(tuple(rewards)), curves
