"""The shaped-reward model's policy, with the reward of states of D-REX (Brown, Goo & Niekum 2019).

R of eq. 4.3 is 0, its best, wherever the action is f(s): it says how to act in a state, and nothing about
which state to be in. Here the policy is f, fitted as in `methods.shaped`, and the reward is one of states
alone, by which f is the better the fewer of its actions are replaced by random ones. It is learned from these
comparisons by logistic regression (Bradley & Terry 1952) on sums of rewards over states of two levels, i with
less noise than j, and touches the environment for the rollouts alone.

    max over r of E log sigma(sum_(s in i) r(s) - sum_(s in j) r(s))

Only where `rl_rounds` says so there is a little reinforcement learning: R* may pay well
for states that no rollout visits. RL finds them, and each of its states is compared with one of f's: what
cannot be told from f's pays like them, and what can pays less.

Deviates from the paper: states that are compared are drawn from all of a level's episodes, where the paper
compares stretches of two of them; rewards are bounded. The networks see an absorbing indicator, and episodes
that terminated count absorbing steps up to the horizon, so what absorption pays is learned as well. Where
demonstrations terminate less often than random actions it pays at most the least that a visited state does,
for without this RL on cart-pole failed once (`docs/tuning.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import softplus

from methods.base import Array, Episodes, Learned, Reward, World, roughened
from methods.network import ADAM, descend, mlp, standardiser
from methods.rewards import MeanReward, NetworkReward, deterred, paid
from methods.shaped import Shaped
from methods.visits import visitations

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
    """Gradient steps on each network."""
    reward_batch: int = 32
    """Comparisons that each of these is the mean of."""
    reward_rate: float = 1e-3
    """Learning rate of these."""

    rl_rounds: int = 0
    """Solves from scratch by reinforcement learning, each under the latest reward, whose states rank below
    f's in the next one."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Fit f as `Shaped` does, then the reward by comparisons."""
        learned = super().fit(demos, world, rng)
        policies = [roughened(learned.policy, share, world.random_actions, rng) for share in self.levels]
        ladder = [world.rollout(policy, self.rollouts, rng) for policy in policies]
        found = list[Episodes]()
        reward, curves = self._rank(ladder, found, demos, world, rng)
        for _ in range(self.rl_rounds):
            agent = world.agent(rng)
            agent.learn(world.solve_steps, reward)
            found.append(world.rollout(agent.policy, self.rollouts, rng))
            reward, curves = self._rank(ladder, found, demos, world, rng)
        return Learned(learned.policy, reward, {**learned.curves, **curves})

    def _rank(
        self,
        ladder: Sequence[Episodes],
        found: Sequence[Episodes],
        demos: Episodes,
        world: World,
        rng: np.random.Generator,
    ) -> tuple[Reward, dict[str, Sequence[float]]]:
        """A reward by which each of the ladder's episodes are better than those after it, and the states of
        the first than those that RL found; and the losses."""
        mean, std = standardiser(np.concatenate([rng.choice(e.pairs()[0], SEEN) for e in (*ladder, *found)]))

        def visits(episodes: Episodes) -> Array:
            return visitations(episodes, world.horizon - episodes.lengths, mean, std, actions=False)

        levels = [visits(episodes) for episodes in ladder]
        pairs = np.sort([rng.choice(len(levels), 2, replace=False) for _ in range(self.comparisons)])
        compared = [np.stack([rng.choice(levels[i], self.compared) for i in side]) for side in pairs.T]
        if found:
            by_rl = np.concatenate([visits(episodes) for episodes in found])
            size = (self.comparisons, self.compared)
            compared += [rng.choice(levels[0], size), rng.choice(by_rl, size)]
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        rewards, curves = list[Reward](), dict[str, Sequence[float]]()
        for i in range(self.networks):
            network = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)

            def loss(*states: torch.Tensor, network: torch.nn.Module = network) -> torch.Tensor:
                r = [torch.tanh(network(s.flatten(0, 1))).view(s.shape[:2]) for s in states]
                ranked = softplus((r[1] - r[0]).sum(1)).mean()
                return ranked + softplus(r[3] - r[2]).mean() if found else ranked

            adam = torch.optim.Adam(network.parameters(), self.reward_rate, **ADAM)
            curves[f"ranking loss, network {i}"] = descend(
                loss, adam, compared, self.reward_steps, self.reward_batch, rng
            )
            reward = NetworkReward.of(network, mean, std, bound=1.0, actions=False)
            least = min(float(paid(reward, episodes).min()) for episodes in ladder)
            rewards.append(deterred(reward, demos, ladder[-1], least))
        return MeanReward(tuple(rewards)), curves
