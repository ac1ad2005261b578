"""f-IRL (Ni et al. 2020) of the forward divergence: it learns a reward of states whose soft policy visits the
demonstrated states. It needs no game, because it descends the divergence of the two state densities. The
gradient is in proportion to a covariance over the policy's trajectories tau.

    grad KL(rho_E || rho) ~ -cov_tau(sum_t rho_E(s_t) / rho(s_t), sum_t grad r(s_t))     (theorem 4.1)

A discriminator estimates the ratio. Trajectories are rollouts of the policy that the agent explores with, and
demonstrations, as in the authors' code.

Deviates from the paper: only the gradient's direction counts, because it is divided by the spread of the
trajectories' ratios. Several steps go along each direction. The reward has a penalty on its slope instead of
bounds, of half the weight of the discriminator's, which has one as well. Ratios have bounds (`LARGEST_LOG`).
The ratio is of the agent's latest steps, and so of slightly older policies too. Where actions are choices the
policy is Q-learning's, which has no entropy. R* is the mean of all networks, because single ones swing. Where
the model is known the gradient is exact (`methods.tabular.f_irl`).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import nn

from methods.adversarial import Game, Turn, contrast_among_living
from methods.base import ABSORBING_STEPS, Array, Episodes, Learned, Rng, Transitions, World
from methods.network import ADAM, mlp
from methods.ranges import Count, Positive
from methods.rewards import NetworkReward
from methods.tabular import f_irl as tabular
from methods.visits import sample, visitations, visited

LARGEST_LOG = 5.0  # bound of log density ratios


@dataclass(frozen=True)
class FIRL(Game):
    """f-IRL's hyper-parameters, besides the game's. `rollouts` also estimate each gradient."""

    needs_actions: ClassVar[bool] = False
    """True if demonstrations must have actions."""
    known_steps: Count = 300
    """Steps of gradient descent where the model is known."""
    known_rate: Positive = 3e-2
    """Learning rate where the model is known, by Adam."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Descend the divergence."""
        if world.model is not None:
            return tabular.fit(demos, world, world.model, rng, self.known_steps, self.known_rate)
        mean, std, generator = self.standard(demos, world, rng)
        logit, network = (mlp(world.obs_size + 1, *self.layers, 1, generator=generator) for _ in range(2))
        discriminator = self.discriminator(logit, generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        expert = visitations(demos, ABSORBING_STEPS, mean, std, False)
        agent = world.agent(rng, kind="stochastic")

        def propose() -> Turn:
            reward = NetworkReward.of(network, mean, std, actions=False)
            return Turn(reward, reward)

        def improve(steps: Transitions) -> None:
            world.log(discriminator.learn(expert, visited(steps, mean, std, False), rng))
            behaviour = agent.behaviour
            own = world.rollout(lambda obs: behaviour.sample(obs, rng), self.rollouts, rng)
            each = [trajectory(one, mean, std) for one in (*separate(own), *separate(demos))]
            weighted = weigh(each, logit)
            for _ in range(self.reward_steps):
                rows = sample(weighted, self.batch, rng)
                a, b = rows[:, :-1].chunk(2)
                rewards = contrast_among_living(network, a, b, generator)
                gain = (rows[:, -1:] * torch.cat([rewards.a, rewards.b])).mean()
                loss = 0.5 * self.slope_penalty * rewards.squared_slope - gain
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()

        result = self.play(world, agent, propose, improve, rng)
        return Learned(result.policy, result.mean)


def separate(episodes: Episodes) -> list[Episodes]:
    """Return each episode alone."""
    every = zip(episodes.obs, episodes.act, episodes.terminated, episodes.lengths.tolist(), strict=True)
    times = episodes.times
    return [
        Episodes((obs,), (act,), (ended,), None if times is None else (times[i],), (steps,))
        for i, (obs, act, ended, steps) in enumerate(every)
    ]


def trajectory(episode: Episodes, mean: Array, std: Array) -> tuple[Array, Array]:
    """Return the rows of one episode, (N, O + 1), and the number of steps that each stands for, (N,).

    Where it terminated the last row is the absorbing state. It stands for `ABSORBING_STEPS`, relative to all
    steps of the episode.
    """
    rows = visitations(episode, 0, mean, std, False)
    counts = np.ones(len(rows))
    if episode.terminated[0]:
        rows = np.concatenate([rows, np.eye(rows.shape[1])[-1:]])
        counts = np.append(counts, ABSORBING_STEPS * len(counts) / episode.lengths[0])
    return rows, counts


def weigh(trajectories: list[tuple[Array, Array]], logit: nn.Module) -> Array:
    """Return all rows (M, K) of the trajectories, each with its weight, (M, K + 1).

    A trajectory's mean density ratio exp(logit) is standardised among trajectories. A row's weight is that
    number times the row's share of its trajectory. Trajectories count alike, whatever their length.
    """
    ratios, shares = [], []
    for rows, counts in trajectories:
        with torch.no_grad():
            logs = logit(torch.as_tensor(rows, dtype=torch.float32))[:, 0].numpy()
        shares.append(counts / counts.sum())
        ratios.append(float(shares[-1] @ np.exp(np.clip(logs, -LARGEST_LOG, LARGEST_LOG))))
    above = (np.array(ratios) - np.mean(ratios)) / max(float(np.std(ratios)), 1e-8)
    rows = np.concatenate([rows for rows, _ in trajectories])
    weights = np.concatenate([share * a for share, a in zip(shares, above, strict=True)])
    return np.column_stack([rows, weights * len(rows) / len(trajectories)])
