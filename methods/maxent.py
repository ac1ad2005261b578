"""Maximum-entropy deep inverse reinforcement learning (Wulfmeier, Ondruska & Posner 2015; Ziebart et al.
2008), algorithm 1: the gradient of the demonstrations' log-likelihood with respect to the reward is
mu_D - E[mu], propagated back through a reward network.

Where the model is known this is the algorithm line by line; the likelihood is that of maximum causal entropy
up to the horizon (Ziebart, Bagnell & Dey 2010), with the discount that rewards are solved under: one that
explains the demonstrations without it may be worth another journey with it.

Deviates from the paper elsewhere: the environments are continuous, so "solve the MDP" is warm-started RL and
the expected visitations E[mu] come from rollouts of it. They are averaged over the iterations, and a Gaussian
prior on the reward's values (the paper's is on the weights) keeps it bounded between sparse visitations; the
optimum then lies within 1 / prior of 0, so the network's output is bounded by that.
The network sees an absorbing indicator, and visitations count absorbing steps up to the horizon, so what
absorption pays is learned like any state's reward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from envs.spec import Model
from methods.base import Array, Episodes, Learned, Policy, World
from methods.network import ADAM, Network, mlp, standardiser
from methods.rewards import NetworkReward, StateReward
from methods.tabular import finite_soft_value_iteration, state_visitations


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
        policy = world.solve(reward, rng, self.rl_steps)
        return Learned(policy, reward, {"log-likelihood of a step": likelihoods})

    def _fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Alternate reward ascent and reinforcement learning on the reward."""
        policy: Policy = lambda obs: world.random_actions(len(obs), rng)  # noqa: E731
        rollouts = world.rollout(policy, self.rollouts, rng)
        # Where an expert hardly moves, its own spread would make outliers of all states but its own.
        visited = rollouts.pairs()[0]
        mean, std = standardiser(np.concatenate([rng.choice(demos.pairs()[0], len(visited)), visited]))
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        network = mlp(world.obs_size + world.act_size + 1, *self.layers, 1, generator=generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        visits_demo = visitations(demos, world.horizon, mean, std)
        visits_policy: list[Array] = []
        gaps: list[float] = []
        agent = world.agent(rng)
        for i in range(self.iterations):
            if i > 0:
                rollouts = world.rollout(policy, self.rollouts, rng)
            visits_policy.append(visitations(rollouts, world.horizon, mean, std))
            for _ in range(self.reward_steps):
                expected = visits_policy[int(rng.integers(len(visits_policy)))]
                d, e = (
                    torch.tanh(network(sample(v, self.batch, rng))) / self.prior
                    for v in (visits_demo, expected)
                )
                prior = 0.5 * self.prior * (d.square().mean() + e.square().mean())
                loss = e.mean() - d.mean() + prior
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
            gaps.append((d.mean() - e.mean()).item())
            reward = NetworkReward.of(network, mean, std, 1 / self.prior)
            agent.learn(self.rl_steps * (2 if i == 0 else 1), reward)
            policy = agent.best(reward)
        return Learned(policy, reward, {"mean reward, demonstrations minus rollouts": gaps})


def demonstrated(demos: Episodes, model: Model) -> Array:
    """mu_D (T, S, A): the share of the demonstrations, all of T steps, that are shown in each state and
    choosing each action at each time. Raises ValueError where their lengths differ."""
    if demos.lengths.min() < demos.lengths.max():
        raise ValueError("in a known model, demonstrations must be equally long")
    mu = np.zeros((demos.lengths[0], *model.P.shape[:2]))
    for i, (obs, act) in enumerate(zip(demos.obs, demos.act, strict=True)):
        times = np.arange(len(act)) if demos.times is None else demos.times[i]
        mu[times, model.states(obs[: len(act)]), act.argmax(axis=1)] += 1 / len(demos)
    return mu


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


def visitations(episodes: Episodes, horizon: int, mean: Array, std: Array) -> Array:
    """(N, O + A + 1): every visited (observation, action, absorbing indicator), observations standardised;
    an episode that terminated visits the absorbing state, all zeros and 1, up to the horizon."""
    obs, act = episodes.pairs()
    return with_absorbing_steps(np.concatenate([(obs - mean) / std, act], axis=1), episodes, horizon)


def with_absorbing_steps(steps: Array, episodes: Episodes, horizon: int) -> Array:
    """(N, K + 1): what describes each step that is shown of the episodes, (M, K), and an absorbing indicator;
    episodes that terminated add their steps from there to the horizon, all zeros and 1."""
    absorbed = sum((horizon - episodes.lengths)[np.array(episodes.terminated)])
    left = round(absorbed * len(steps) / sum(episodes.lengths))  # of as many as are shown of the others
    visits = np.zeros((len(steps) + left, steps.shape[1] + 1))
    visits[: len(steps), :-1] = steps
    visits[len(steps) :, -1] = 1
    return visits


def sample(visits: Array, batch: int, rng: np.random.Generator) -> torch.Tensor:
    """A uniform minibatch of visitations."""
    return torch.as_tensor(visits[rng.integers(len(visits), size=batch)], dtype=torch.float32)
