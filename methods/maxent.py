"""Maximum-entropy deep inverse reinforcement learning (Wulfmeier, Ondruska & Posner 2015; Ziebart et al.
2008), algorithm 1: the gradient of the demonstrations' log-likelihood L with respect to the reward of a state
is how often demonstrations visit it, less how often the policy does; it is propagated back through a network.

    grad log L = sum_s (mu_D(s) - E[mu(s)]) grad r(s)

Where the model is known this is the algorithm line by line; the likelihood is that of maximum causal entropy
up to the horizon (Ziebart, Bagnell & Dey 2010), with the discount that rewards are solved under: one that
explains the demonstrations without it may be worth another journey with it.

Deviates from the paper: elsewhere the environments are continuous, so "solve the MDP" is reinforcement
learning that goes on a little in each iteration, as in maximum-likelihood IRL (Zeng et al. 2022), and the
expected visitations E[mu] come from rollouts of the policy by chance that it learns. Our PPO learns one that
is best in reward plus entropy, as the likelihood asks for; soft actor-critic weighs entropy by itself; other
learners have no such policy, and theirs is rolled out as it is. pi* is the policy without chance. The paper's
prior on the network's weights is one on its slope here, for with one on its values RL from scratch failed on
the swing-up (`docs/tuning.md`). R* is the mean of the networks, for in the game between reward and policy
averages converge, and the last choices need not (Freund & Schapire 1999; Syed & Schapire 2007). The network
sees an absorbing indicator, and visitations count absorbing steps up to the horizon, so what absorption pays
is learned like any state's reward. But once the policy no longer ends, nothing says that an end is bad: so
where demonstrations end less often than random actions, an end pays at most the mean of what steps of these
do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from envs.spec import Model
from methods.base import Agent, Array, Episodes, Learned, Policy, World, seen_by_both
from methods.network import ADAM, Network, contrast, mlp, standardiser
from methods.rewards import MeanReward, NetworkReward, StateReward, deterred, paid
from methods.stochastic import EpsilonGreedy
from methods.tabular import finite_soft_value_iteration, state_visitations
from methods.visits import demonstrated, sample, visitations


@dataclass(frozen=True)
class MaxEnt:
    """Its hyper-parameters."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the reward network."""
    actions: bool = True
    """Whether the reward sees actions, besides observations. Where the model is known it never does."""
    iterations: int = 20
    """Reward updates, each followed by reinforcement learning that goes on."""
    rl_share: float = 0.06
    """Environment steps of each iteration, of those of a solve from scratch."""
    entropy: float = 1.0
    """What a nat of its policy's entropy is worth to an agent that learns by PPO; 1 in the likelihood."""
    averaged: int = 20
    """Latest iterations, by default all, of whose networks R* is the mean."""
    final_share: float = 0.5
    """Environment steps under R*, of those of a solve; pi* is the best checkpoint of these."""
    reward_steps: int = 100
    """Gradient steps on the reward in each iteration."""
    learning_rate: float = 1e-3
    """Of Adam, on the reward."""
    batch: int = 256
    """Visitations sampled from the demonstrations, and as many from the rollouts."""
    rollouts: int = 10
    """Episodes that estimate a policy's visitations."""
    remembered: int = 3
    """Latest iterations whose rollouts stand for E[mu]."""
    slope_prior: float = 1.0
    """Inverse variance of the Gaussian prior on the reward's slope, observations being standardised."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Ascend the likelihood of the demonstrations."""
        if world.model is None:
            return self._fit(demos, world, rng)
        return self._fit_exactly(demos, world, world.model, rng)

    def _fit_exactly(self, demos: Episodes, world: World, model: Model, rng: np.random.Generator) -> Learned:
        """Algorithm 1; its lines are numbered."""
        mean, std = standardiser(model.obs)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        network = mlp(world.obs_size, *self.layers, 1, generator=generator)  # 1
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        features = torch.as_tensor((model.obs - mean) / std, dtype=torch.float32)
        mu_demo = demonstrated(demos, model)
        likelihoods: list[float] = []
        for _ in range(self.iterations):  # 2
            r = network(features)[:, 0]  # 3
            likelihood, gradient = log_likelihood(model, r.detach().double().numpy(), mu_demo, world.gamma)
            optimizer.zero_grad()
            r.backward(-torch.as_tensor(gradient, dtype=torch.float32))  # 8
            optimizer.step()  # 9
            likelihoods.append(likelihood)
        reward = StateReward(Network.from_torch(network, mean, std))
        policy = world.solve(reward, rng, world.solve_steps)
        return Learned(policy, reward, {"log-likelihood of a step": likelihoods})

    def _fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Alternate reward ascent and reinforcement learning on the reward."""
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        mean, std = standardiser(seen_by_both(demos, random, rng))
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        network = mlp(inputs, *self.layers, 1, generator=generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        visits_demo = visitations(demos, world.horizon - demos.lengths, mean, std, self.actions)
        visits_policy: list[Array] = []
        rewards: list[NetworkReward] = []
        gaps: list[float] = []
        agent = world.agent(rng, entropy=self.entropy)
        for i in range(self.iterations):
            rollouts = random if i == 0 else world.rollout(drawn_by(agent, rng), self.rollouts, rng)
            visits = visitations(rollouts, world.horizon - rollouts.lengths, mean, std, self.actions)
            visits_policy = [*visits_policy, visits][-self.remembered :]
            for _ in range(self.reward_steps):
                expected = visits_policy[int(rng.integers(len(visits_policy)))]
                d, e = (sample(v, self.batch, rng) for v in (visits_demo, expected))
                said = contrast(network, d, e, generator)
                gap = said.a.mean() - said.b.mean()
                loss = 0.5 * self.slope_prior * said.squared_slope - gap
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
            gaps.append(gap.item())
            reward = NetworkReward.of(network, mean, std, actions=self.actions)
            rewards.append(deterred(reward, demos, random, float(paid(reward, random).mean())))
            agent.learn(math.ceil(self.rl_share * world.solve_steps), rewards[-1])
        mean_reward = MeanReward(tuple(rewards[-self.averaged :]))
        agent.learn(math.ceil(self.final_share * world.solve_steps), mean_reward)
        return Learned(
            agent.best(mean_reward), mean_reward, {"mean reward, demonstrations minus rollouts": gaps}
        )


def drawn_by(agent: Agent, rng: np.random.Generator) -> Policy:
    """Return the policy by chance that the agent learns, as it is now; of an agent that learns none, what it
    would do."""
    try:
        behaviour = agent.behaviour
    except ValueError:
        return agent.policy
    if isinstance(behaviour, EpsilonGreedy):  # by chance only to explore
        return agent.policy
    return lambda obs: behaviour.sample(obs, rng)


def log_likelihood(model: Model, r: Array, mu_demo: Array, gamma: float) -> tuple[float, Array]:
    """Mean log-likelihood of a demonstrated step under the reward r (S,) or (S, A), and its gradient
    mu_D - E[mu], of the shape of r.

    E[mu] is what the policy would visit from where the demonstrations start and, where chance then leads
    them elsewhere than the model expects, from there: their luck is not the reward's doing. A discount is a
    chance 1 - gamma at each step to go on from where the demonstrations are.
    """
    horizon = len(mu_demo)
    _, policies = finite_soft_value_iteration(model.P, r, horizon, gamma)  # 4
    arrivals = mu_demo.sum(axis=2)
    arrivals[1:] -= np.tensordot(mu_demo[:-1], gamma * model.P, axes=2)
    expected = state_visitations(gamma * model.P, policies, arrivals, horizon)  # 5
    seen = mu_demo > 0
    likelihood = float(mu_demo[seen] @ np.log(policies[seen]))  # 6
    gradient = (mu_demo - expected[:, :, None] * policies).sum(axis=0)  # 7
    return likelihood / horizon, (gradient if r.ndim == 2 else gradient.sum(axis=1)) / horizon
