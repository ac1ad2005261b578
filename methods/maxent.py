"""Maximum-entropy deep inverse reinforcement learning (Wulfmeier, Ondruska & Posner 2015; Ziebart et al.
2008), algorithm 1: the gradient of the demonstrations' log-likelihood with respect to the reward is
mu_D - E[mu], propagated back through a reward network.

Deviates from the paper: the environments are continuous, so "solve the MDP" is warm-started DDPG and the
expected visitations E[mu] come from rollouts of it. They are averaged over the iterations, and a Gaussian
prior on the reward's values (the paper's is on the weights) keeps it bounded between sparse visitations.
The network sees an absorbing indicator, and visitations count absorbing steps up to the horizon, so what
absorption pays is learned like any state's reward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Array, Episodes, Learned, Policy, World
from methods.network import Network, mlp, standardiser


@dataclass(frozen=True)
class MaxEnt:
    """Its hyper-parameters."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the reward network."""
    iterations: int = 5
    """Reward updates, each followed by a reinforcement-learning solve."""
    rl_steps: int = 3000
    """Environment steps of each solve; the first takes twice as many."""
    reward_steps: int = 500
    """Gradient steps on the reward in each iteration."""
    learning_rate: float = 1e-3
    batch: int = 256
    """Visitations sampled from the demonstrations, and as many from the rollouts."""
    rollouts: int = 10
    """Episodes that estimate a policy's visitations."""
    prior: float = 0.5
    """Inverse variance of the Gaussian prior on reward values."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Alternate reward ascent and reinforcement learning on the reward."""
        mean, std = standardiser(demos.pairs()[0])
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        network = mlp(world.obs_size + world.act_size + 1, *self.layers, 1, generator=generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate)
        visits_demo = visitations(demos, world.horizon, mean, std)
        policy: Policy = lambda obs: rng.uniform(-1, 1, (len(obs), world.act_size))  # noqa: E731
        visits_policy: list[Array] = []
        gaps: list[float] = []
        for i in range(self.iterations):
            rollouts = world.rollout(policy, self.rollouts, rng)
            visits_policy.append(visitations(rollouts, world.horizon, mean, std))
            for _ in range(self.reward_steps):
                expected = visits_policy[int(rng.integers(len(visits_policy)))]
                d, e = (network(sample(v, self.batch, rng)) for v in (visits_demo, expected))
                prior = 0.5 * self.prior * (d.square().mean() + e.square().mean())
                loss = e.mean() - d.mean() + prior
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
            gaps.append((d.mean() - e.mean()).item())
            reward = NetworkReward.of(network, mean, std)
            policy = world.solve(reward, rng, self.rl_steps * (2 if i == 0 else 1), warm=i > 0)
        return Learned(policy, reward, {"mean reward, demonstrations minus rollouts": gaps})


def visitations(episodes: Episodes, horizon: int, mean: Array, std: Array) -> Array:
    """(N, O + A + 1): every visited (observation, action, absorbing indicator), observations standardised;
    an episode that terminated visits the absorbing state, all zeros and 1, up to the horizon."""
    obs, act = episodes.pairs()
    alive = np.concatenate([(obs - mean) / std, act, np.zeros((len(obs), 1))], axis=1)
    steps = int(sum((horizon - episodes.lengths)[np.array(episodes.terminated)]))
    absorbed = np.zeros((steps, alive.shape[1]))
    absorbed[:, -1] = 1
    return np.concatenate([alive, absorbed])


def sample(visits: Array, batch: int, rng: np.random.Generator) -> torch.Tensor:
    """A uniform minibatch of visitations."""
    return torch.as_tensor(visits[rng.integers(len(visits), size=batch)], dtype=torch.float32)


@dataclass(frozen=True)
class NetworkReward:
    """A network of (observation, action, absorbing indicator)."""

    network: Network
    absorbing: float

    @classmethod
    def of(cls, layers: torch.nn.Module, mean: Array, std: Array) -> NetworkReward:
        """From torch layers on standardised observations (`mean`, `std`), actions and the indicator."""
        linear = [m for m in layers.modules() if isinstance(m, torch.nn.Linear)]
        rest = linear[0].in_features - len(mean)
        shift, scale = np.append(mean, np.zeros(rest)), np.append(std, np.ones(rest))
        network = Network.from_torch(layers, shift, scale)
        absorbed = np.append(mean, np.zeros(rest))
        absorbed[-1] = 1
        return cls(network, float(network(absorbed[None])[0, 0]))

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.network(np.concatenate([obs, act, np.zeros((len(obs), 1))], axis=1))[:, 0]
