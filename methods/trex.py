"""T-REX (Brown, Goo, Nagarajan & Niekum 2019): a reward of states, learned from ranked demonstrations.

Logistic regression on pairs of demonstrations finds a reward that sums to more over the better one
(Bradley & Terry 1952). States that are better than all shown ones may pay more.

    max over r of E log sigma(sum_(s in j) r(s) - sum_(s in i) r(s)),   j better than i

It needs preferences between demonstrations, which other methods do not see, and no actions. pi* is learned by
RL under R*.

Deviates from the paper: stretches of two demonstrations begin anywhere, where the paper lets the better one
begin later. Rewards are bounded. The networks see an absorbing indicator, and episodes that terminated count
absorbing steps up to the horizon, so the reward of absorption is learned as well. Where demonstrations
terminate less often than random actions, absorption pays at most the least reward of a demonstrated state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from methods.base import Array, Episodes, Learned, Reward, Rng, Unsuitable, World
from methods.f_irl import separate
from methods.network import ADAM, descend, mlp, preference_loss, standardiser
from methods.ranges import Between, Count, Hidden, Rate
from methods.rewards import MeanReward, NetworkReward, deterred
from methods.visits import seen_by_both, visitations


@dataclass(frozen=True)
class TREX:
    """T-REX's hyper-parameters."""

    needs_actions: ClassVar[bool] = False
    """True if demonstrations must have actions."""
    layers: Hidden = (64, 64)
    """Hidden layers of the reward's networks."""
    networks: Count = 3
    """Networks that R* is the mean of."""
    comparisons: Count = 2000
    """Comparisons of stretches of two demonstrations."""
    stretch: Annotated[Count, Between(10, 200)] = 50
    """Steps of each stretch."""
    reward_steps: Count = 500
    """Gradient steps on each network."""
    batch: Count = 32
    """Comparisons in each gradient step."""
    learning_rate: Rate = 1e-3
    """Learning rate of the reward, by Adam."""
    rollouts: Count = 10
    """Episodes of random actions that standardise observations."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Fit the reward, and solve for pi* under it. Raises Unsuitable without preferences."""
        if demos.preferences is None or not len(demos.preferences):
            raise Unsuitable("T-REX learns from demonstrations with ranks, returns or preferences")
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        mean, std = standardiser(seen_by_both(demos, random, rng))
        rows = [
            visitations(one, world.horizon - one.lengths, mean, std, actions=False) for one in separate(demos)
        ]
        pairs = rng.choice(demos.preferences, self.comparisons)
        compared = [np.stack([self.stretch_of(rows[i], rng) for i in side]) for side in pairs.T]
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        rewards, curves = list[Reward](), dict[str, Sequence[float]]()
        for i in range(self.networks):
            network = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)

            def loss(*states: Tensor, network: nn.Module = network) -> Tensor:
                return preference_loss(network, states[1], states[0])

            adam = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
            curves[f"ranking loss, network {i}"] = descend(
                loss, adam, compared, self.reward_steps, self.batch, rng
            )
            reward = NetworkReward.of(network, mean, std, bound=1.0, actions=False)
            least = float(reward(*demos.pairs(), demos.pairs()[0]).min())
            rewards.append(deterred(reward, demos, random, least))
        mean_reward = MeanReward(tuple(rewards))
        return Learned(world.solve(mean_reward, rng, world.solve_steps), mean_reward, curves)

    def stretch_of(self, rows: Array, rng: Rng) -> Array:
        """Return successive rows (`stretch`, K) of (N, K), from a random one. The last repeats where rows are
        fewer."""
        start = rng.integers(max(1, len(rows) - self.stretch + 1))
        return np.asarray(rows[np.minimum(start + np.arange(self.stretch), len(rows) - 1)])
