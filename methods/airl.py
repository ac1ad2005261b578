"""Adversarial inverse reinforcement learning (Fu, Luo & Levine 2018).

As in GAIL, a discriminator learns to distinguish demonstrated steps from the agent's. It has a form in which
f is learned and the agent's own density pi(a|s) is given.

    D(s, a, s') = exp f(s, a, s') / (exp f(s, a, s') + pi(a|s))
    f(s, a, s') = g(s, a) + gamma h(s') - h(s)

The reward g depends on s and a, or on s alone. The potential h shapes it, and is 0 in the absorbing state. R*
is g. By the paper's appendix C it is the true reward up to a constant, if the policy is the best one under f
and its entropy. Both rewards must depend on states alone, and the dynamics must be deterministic and link
states in every way ("decomposable"). Where the model is known, tests confirm it (`methods.tabular.airl`).

Deviates from the paper: PPO is paid f - log pi. Soft actor-critic is paid f and weighs entropy by itself, and
Q-learning has no entropy, so their policies do not meet the theorem's condition. In the discriminator log
densities have bounds, because those of a confident agent would decide alone. The logit has a penalty on its
slope, along the absorbing indicators too, and so on the level of h. R* is the mean of all g, because single
ones swing, and pi* comes from reinforcement learning on that (`methods.adversarial`).
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from torch import Tensor, nn

from methods.adversarial import Game, Turn
from methods.base import Array, Episodes, Learned, Rng, StochasticPolicy, Transitions, Unsuitable, World
from methods.network import mlp
from methods.ranges import Between, Count, Positive, Weight
from methods.rewards import NetworkReward
from methods.tabular import airl as tabular
from methods.visits import visited


@dataclass(frozen=True)
class AIRL(Game):
    """AIRL's hyper-parameters, besides the game's."""

    actions: bool = True
    """True if g sees actions, besides observations."""
    entropy: Annotated[Weight, Between(0.1, 10)] = 1.0
    """PPO's reward of a nat of its policy's entropy."""
    most_sure: Annotated[Positive, Between(0.3, 3)] = 1.0
    """Bound, for each entry of actions, on their log density relative to uniform actions."""
    known_steps: Count = 1000
    """Steps of gradient descent where the model is known, each followed by a solve for the policy."""
    known_rate: Positive = 0.1
    """Learning rate where the model is known, by Adam."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Play the game. Raises Unsuitable unless every step is shown or the model is known."""
        if world.model is not None:
            return tabular.fit(
                demos, world, world.model, rng, self.actions, self.known_steps, self.known_rate
            )
        expert = as_transitions(demos)
        mean, std, generator = self.standard(demos, world, rng)
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        g = mlp(inputs, *self.layers, 1, generator=generator)
        h = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)
        discriminator = self.discriminator(Logit(g, h, world.gamma), generator)
        agent = world.agent(rng, kind="stochastic", entropy=self.entropy)
        size = 1 if world.discrete else world.act_size
        uniform = -np.log(world.act_size) if world.discrete else -size * np.log(2)

        def propose() -> Turn:
            reward = NetworkReward.of(g, mean, std, actions=self.actions)
            potential = NetworkReward.of(h, mean, std, actions=False)
            return Turn(Shaped(reward, potential, world.gamma), reward)

        def rows(steps: Transitions) -> Array:
            logs = log_density(agent.behaviour, steps, uniform, self.most_sure * size)
            return described(steps, logs, mean, std, self.actions)

        def improve(steps: Transitions) -> None:
            world.log(discriminator.learn(rows(expert), rows(steps), rng))

        result = self.play(world, agent, propose, improve, rng)
        return Learned(result.policy, result.mean)


def as_transitions(demos: Episodes) -> Transitions:
    """Return every step, with absorbing steps after each end. Raises Unsuitable unless all are shown."""
    if not demos.whole:
        raise Unsuitable("AIRL learns from demonstrations of which every step is shown")
    return Transitions.of(demos).absorbed()


def log_density(policy: StochasticPolicy, steps: Transitions, uniform: float, most: float) -> Array:
    """Return the log density of each action, (N,), within `most` of `uniform`, that of uniform actions. In
    the absorbing state, where actions mean nothing, it is `uniform`."""
    logs = policy.log_prob(steps.obs, steps.act)
    return np.where(steps.absorbing, uniform, np.clip(logs, uniform - most, uniform + most))


def described(steps: Transitions, logs: Array, mean: Array, std: Array, actions: bool) -> Array:
    """Return rows for `Logit`, (N, 1 + O + 1 + K), from the agent's log densities `logs` (N,)."""
    after = replace(steps, obs=steps.next_obs, absorbing=steps.next_absorbing)
    return np.column_stack([logs, visited(after, mean, std, False), visited(steps, mean, std, actions)])


class Logit(nn.Module):
    """The logit f - log pi of rows (B, 1 + O + 1 + K). A row is log pi, the next observation, its absorbing
    indicator, and the input of g: the observation, any action, and the absorbing indicator."""

    def __init__(self, g: nn.Module, h: nn.Module, gamma: float) -> None:
        super().__init__()
        self.g, self.h, self.gamma = g, h, gamma

    def forward(self, rows: Tensor) -> Tensor:
        size = next(self.h.parameters()).shape[1]
        logs, after, now = torch.tensor_split(rows, (1, 1 + size), dim=1)
        before = torch.cat([now[:, : size - 1], now[:, -1:]], dim=1)
        shaping = self.gamma * self._potential(after) - self._potential(before)
        f: Tensor = self.g(now) + shaping - logs
        return f

    def _potential(self, x: Tensor) -> Tensor:
        """Return h, which is 0 in the absorbing state."""
        h: Tensor = self.h(x) * (1 - x[:, -1:])
        return h


@dataclass(frozen=True)
class Shaped:
    """The payment f: g plus the change of the potential h."""

    g: NetworkReward
    h: NetworkReward
    gamma: float

    def __call__(self, steps: Transitions) -> Array:
        g, before, after = (
            reward(obs, steps.act, steps.next_obs)
            for reward, obs in ((self.g, steps.obs), (self.h, steps.obs), (self.h, steps.next_obs))
        )
        shaping: Array = self.gamma * after * ~steps.next_absorbing - before * ~steps.absorbing
        return np.where(steps.absorbing, self.g.absorbing, g) + shaping
