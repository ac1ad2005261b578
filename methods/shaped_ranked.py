"""The shaped-reward model's policy, with the reward of states of D-REX (Brown, Goo & Niekum 2019).

R of eq. 4.3 is 0, its best, wherever the action is f(s). It ranks actions in a state, but not states. Here
the policy is f, fitted as in `methods.shaped`, and the reward is one of states alone. It ranks f the higher,
the fewer of f's actions are replaced by random ones. Logistic regression learns it from such comparisons
(Bradley & Terry 1952). They are of sums of rewards over states of two levels, i with less noise than j. Only
rollouts act.

    max over r of E log sigma(sum_(s in i) r(s) - sum_(s in j) r(s))

R* may pay well for other states. Where `rl_rounds` is above 0, a little reinforcement learning reaches them,
and each of its states is compared with one of f's. States like f's are then paid like f's, and other states
less.

Deviates from the paper: compared states are drawn from all of a level's episodes, where the paper compares
stretches of two of them. Rewards are bounded. The networks see an absorbing indicator, and episodes that
terminated count absorbing steps up to the horizon, so the reward of absorption is learned as well. Where
demonstrations terminate less often than random actions, absorption pays at most the least reward of a visited
state. Without this RL on cart-pole failed once (`docs/tuning.md`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from methods.base import Array, Episodes, Learned, Reward, Rng, World
from methods.network import ADAM, descend, mlp, preference_loss, standardiser
from methods.ranges import Count, CountOrNone, Hidden, Rate, Share
from methods.rewards import MeanReward, NetworkReward, deterred, paid
from methods.shaped import Shaped
from methods.stochastic import roughened
from methods.visits import visitations

SEEN = 1000  # observations of each level that standardise all


@dataclass(frozen=True)
class ShapedRanked(Shaped):
    """Hyper-parameters, besides those of `Shaped`."""

    levels: tuple[Share, ...] = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
    """Shares of random actions, ascending."""
    rollouts: Count = 10
    """Episodes of each level."""
    comparisons: Count = 2000
    """Comparisons of two levels."""
    compared: Count = 50
    """States of each level in a comparison."""
    layers: Hidden = (64, 64)
    """Hidden layers of the reward's networks."""
    networks: Count = 3
    """Networks that R* is the mean of."""
    reward_steps: Count = 500
    """Gradient steps on each network."""
    reward_batch: Count = 32
    """Comparisons in each gradient step."""
    reward_rate: Rate = 1e-3
    """Learning rate of the reward."""
    rl_rounds: CountOrNone = 0
    """Solves from scratch by reinforcement learning, each under the latest reward. Their states rank below
    f's in the next one."""

    def go_on(self, first: Learned, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Fit the reward by comparisons."""
        policies = [roughened(first.policy, share, world.random_actions, rng) for share in self.levels]
        ladder = [world.rollout(policy, self.rollouts, rng) for policy in policies]
        reached = list[Episodes]()
        reward, curves = self._rank(ladder, reached, demos, world, rng)
        for _ in range(self.rl_rounds):
            agent = world.agent(rng)
            agent.learn(world.solve_steps, reward)
            reached.append(world.rollout(agent.policy, self.rollouts, rng))
            reward, curves = self._rank(ladder, reached, demos, world, rng)
        return Learned(first.policy, reward, {**first.curves, **curves})

    def _rank(
        self, ladder: Sequence[Episodes], reached: Sequence[Episodes], demos: Episodes, world: World, rng: Rng
    ) -> tuple[Reward, dict[str, Sequence[float]]]:
        """Return a reward that ranks each level of the ladder above the next, and the first level's states
        above those that RL reached; and its losses."""
        levels = (*ladder, *reached)
        mean, std = standardiser(np.concatenate([rng.choice(level.pairs()[0], SEEN) for level in levels]))

        def visits(episodes: Episodes) -> Array:
            return visitations(episodes, world.horizon - episodes.lengths, mean, std, actions=False)

        rows = [visits(level) for level in ladder]
        pairs = np.sort([rng.choice(len(rows), 2, replace=False) for _ in range(self.comparisons)])
        compared = [np.stack([rng.choice(rows[i], self.compared) for i in side]) for side in pairs.T]
        if reached:
            by_rl = np.concatenate([visits(episodes) for episodes in reached])
            size = (self.comparisons, self.compared)
            compared += [rng.choice(rows[0], size), rng.choice(by_rl, size)]
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        rewards, curves = list[Reward](), dict[str, Sequence[float]]()
        for i in range(self.networks):
            network = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)

            def loss(*states: Tensor, network: nn.Module = network) -> Tensor:
                ranked = preference_loss(network, *states[:2])
                if not reached:
                    return ranked
                f, rl = (torch.tanh(network(s.flatten(0, 1))) for s in states[2:])
                total: Tensor = ranked + softplus(rl - f).mean()
                return total

            adam = torch.optim.Adam(network.parameters(), self.reward_rate, **ADAM)
            curves[f"ranking loss, network {i}"] = descend(
                loss, adam, compared, self.reward_steps, self.reward_batch, rng
            )
            reward = NetworkReward.of(network, mean, std, bound=1.0, actions=False)
            least = min(float(paid(reward, episodes).min()) for episodes in ladder)
            rewards.append(deterred(reward, demos, ladder[-1], least))
        return MeanReward(tuple(rewards)), curves
