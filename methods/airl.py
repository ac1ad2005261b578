"""Adversarial inverse reinforcement learning (Fu, Luo & Levine 2018).

As in GAIL, a discriminator is fitted to tell demonstrated steps from the agent's, but of a form in which f
is learned up to what the agent's own density says.

    D(s, a, s') = exp f(s, a, s') / (exp f(s, a, s') + pi(a|s))
    f(s, a, s') = g(s, a) + gamma h(s') - h(s)

g is a reward, of s and a or of s alone, and h a potential that shapes it, 0 in the absorbing state. R* is g.
Where the policy is the best one under f and its entropy, g sees states alone, the
true reward does, and the dynamics are deterministic and link states in every way ("decomposable"), g is the
true reward up to a constant (the paper's appendix C). Where the model is known (`known`) it is.

Deviates from the paper: an agent that learns by PPO is paid f - log pi, but one by soft actor-critic f and
entropy by a weight of its own (Q-learning none), so what the theorem asks for is not met there; in the
discriminator densities count within bounds, for an agent that is sure of itself would say all there is to
tell; the logit has a penalty on its slope, along the absorbing indicators too, and
so on the level of h; R* is the mean of all g, for single ones swing, and pi* comes of reinforcement
learning on that (`methods.adversarial`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch.nn.functional import softplus

from envs.spec import Model
from methods.adversarial import Game, Turn
from methods.base import (
    Array,
    Episodes,
    Learned,
    StochasticPolicy,
    Transitions,
    Unsuitable,
    World,
)
from methods.network import ADAM, mlp
from methods.rewards import NetworkReward
from methods.tabular import TabularReward, soft_policy, soft_value_iteration, state_visitations
from methods.visits import demonstrated, visited


@dataclass(frozen=True)
class AIRL(Game):
    """Its hyper-parameters, besides the game's."""

    actions: bool = True
    """Whether g sees actions, besides observations."""
    entropy: float = 1.0
    """What a nat of the entropy of its policy is worth to an agent that learns by PPO."""
    most_sure: float = 1.0
    """Bound, for each entry of actions, on the logarithm of their density over that of uniform ones."""
    known_steps: int = 1000
    """Where the model is known: steps of gradient descent, after each of which the policy is solved for."""
    known_rate: float = 0.1
    """Of Adam there."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Play the game. Raises Unsuitable where not every step of the demonstrations is shown, unless the
        model is known."""
        if world.model is not None:
            return self._fit_exactly(demos, world, world.model, rng)
        shown = as_transitions(demos)
        mean, std, generator = self.standard(demos, world, rng)
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        g = mlp(inputs, *self.layers, 1, generator=generator)
        h = mlp(world.obs_size + 1, *self.layers, 1, generator=generator)
        discriminator = self.discriminator(Logit(g, h, world.gamma), generator)
        agent = world.agent(rng, kind="stochastic", entropy=self.entropy)
        size = 1 if world.discrete else world.act_size
        uniform = -np.log(world.act_size) if world.discrete else -size * np.log(2)
        losses: list[float] = []

        def turn() -> Turn:
            reward = NetworkReward.of(g, mean, std, actions=self.actions)
            potential = NetworkReward.of(h, mean, std, actions=False)
            return Turn(Shaped(reward, potential, world.gamma), reward)

        def rows(steps: Transitions) -> Array:
            logs = log_density(agent.behaviour, steps, uniform, self.most_sure * size)
            return described(steps, logs, mean, std, self.actions)

        def answer(seen: Transitions) -> Turn:
            losses.append(discriminator.tell(rows(shown), rows(seen), rng))
            return turn()

        found = self.play(world, agent, turn(), answer, rng)
        return Learned(found.policy, found.mean, {"discriminator's loss": losses})

    def _fit_exactly(self, demos: Episodes, world: World, model: Model, rng: np.random.Generator) -> Learned:
        shown = demonstrated(demos, model).sum(axis=0)
        g, _ = known(self, shown / shown.sum(), model, world.gamma, world.horizon)
        reward = TabularReward(model.obs, np.broadcast_to(g, shown.shape))
        return Learned(world.solve(reward, rng, world.solve_steps), reward)


def known(method: AIRL, shown: Array, model: Model, gamma: float, horizon: int) -> tuple[Array, Array]:
    """g (S, A), or (S, 1), and h (S,), by descent on the discriminator's loss where both densities are known:
    shown (S, A), which sums to 1, and that of the soft policy of g in episodes of that length."""
    P = torch.tensor(model.P)
    rewards = torch.zeros(len(P), shown.shape[1] if method.actions else 1, dtype=P.dtype, requires_grad=True)
    potential = torch.zeros(len(P), dtype=P.dtype, requires_grad=True)
    optimizer = torch.optim.Adam([rewards, potential], method.known_rate, **ADAM)
    for _ in range(method.known_steps):
        g = rewards.detach().numpy()
        policy = soft_policy(soft_value_iteration(model.P, np.broadcast_to(g, shown.shape), gamma)[1])
        visits = state_visitations(model.P, policy, model.start, horizon).mean(axis=0)
        # Of each action in each state, to each next one.
        own, theirs = (torch.as_tensor(w)[..., None] * P for w in (visits[:, None] * policy, shown))
        f = rewards[..., None] + gamma * potential - potential[:, None, None]
        logit = f - torch.as_tensor(np.log(policy))[..., None]
        loss = (theirs * softplus(-logit) + own * softplus(logit)).sum()
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return rewards.detach().numpy(), potential.detach().numpy()


def as_transitions(demos: Episodes) -> Transitions:
    """Every step, and `ABSORBING_STEPS` in the absorbing state after each end. Raises Unsuitable where
    some are not shown."""
    if not demos.whole:
        raise Unsuitable("AIRL learns from demonstrations of which every step is shown")
    return Transitions.of(demos).absorbed()


def log_density(policy: StochasticPolicy, steps: Transitions, uniform: float, most: float) -> Array:
    """(N,): the logarithm of the density of each action, that of `uniform` ones give or take `most`; in the
    absorbing state, where actions mean nothing, that of uniform ones."""
    logs = policy.log_prob(steps.obs, steps.act)
    return np.where(steps.absorbing, uniform, np.clip(logs, uniform - most, uniform + most))


def described(steps: Transitions, logs: Array, mean: Array, std: Array, actions: bool) -> Array:
    """(N, 1 + O + 1 + K): rows as `Logit` takes them, of the logarithms (N,) of the agent's density."""
    after = replace(steps, obs=steps.next_obs, absorbing=steps.next_absorbing)
    return np.column_stack([logs, visited(after, mean, std, False), visited(steps, mean, std, actions)])


class Logit(torch.nn.Module):
    """f - log pi, of rows (B, 1 + O + 1 + K): log pi; the next observation and its absorbing indicator; what
    g sees, of which the observation is first and the indicator last."""

    def __init__(self, g: torch.nn.Module, h: torch.nn.Module, gamma: float) -> None:
        super().__init__()
        self.g, self.h, self.gamma = g, h, gamma

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        size = next(self.h.parameters()).shape[1]
        logs, after, now = torch.tensor_split(rows, (1, 1 + size), dim=1)
        before = torch.cat([now[:, : size - 1], now[:, -1:]], dim=1)
        shaping = self.gamma * self._potential(after) - self._potential(before)
        f: torch.Tensor = self.g(now) + shaping - logs
        return f

    def _potential(self, x: torch.Tensor) -> torch.Tensor:
        """0 in the absorbing state."""
        h: torch.Tensor = self.h(x) * (1 - x[:, -1:])
        return h


@dataclass(frozen=True)
class Shaped:
    """Pays f: g, and what the potential h gains on the way."""

    g: NetworkReward
    h: NetworkReward
    gamma: float

    def __call__(self, steps: Transitions) -> Array:
        g, before, after = (
            reward(obs, steps.act, steps.next_obs)
            for reward, obs in ((self.g, steps.obs), (self.h, steps.obs), (self.h, steps.next_obs))
        )
        gained: Array = self.gamma * after * ~steps.next_absorbing - before * ~steps.absorbing
        return np.where(steps.absorbing, self.g.absorbing, g) + gained
