"""Linear maximum-entropy inverse reinforcement learning (Ziebart, Maas, Bagnell & Dey 2008): the gradient of
the demonstrations' log-likelihood L with respect to weights of features is the demonstrations' mean features
less those that the weights lead to.

    r(s, a) = w^T phi(s, a),   grad_w log L = phi_D - E[phi]

Where the model is known the likelihood is that of maximum causal entropy up to the horizon (Ziebart, Bagnell
& Dey 2010), which is concave in w, maximised by L-BFGS.

Deviates from the paper: a Gaussian prior on w keeps it finite where demonstrations leave no doubt. Elsewhere
"solve the MDP" is warm-started RL, and E[phi] comes from rollouts of it, averaged over the iterations. Each
iteration's weights solve a linear system, for a Gaussian prior on the reward's values is quadratic in them.
Features get an absorbing indicator, and visitations count absorbing steps up to the horizon, so what
absorption pays is learned like any state's reward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from envs.spec import Model
from methods.base import Array, Episodes, Learned, Policy, World
from methods.maxent import log_likelihood
from methods.rewards import LinearReward
from methods.visits import demonstrated, with_absorbing_steps


@dataclass(frozen=True)
class MaxEntLinear:
    """Its hyper-parameters."""

    iterations: int = 5
    """Reward updates, each followed by a reinforcement-learning solve."""
    rl_share: float = 0.3
    """Environment steps of each, of those of a solve from scratch."""
    rollouts: int = 10
    """Episodes that estimate a policy's mean features."""
    prior: float = 0.5
    """Inverse variance of the Gaussian prior on reward values, where the model is not known."""
    weight_prior: float = 1e-3
    """Inverse variance of the Gaussian prior on weights."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Maximise the likelihood of the demonstrations."""
        if world.model is None:
            return self._fit(demos, world, rng)
        return self._fit_exactly(demos, world, world.model, rng)

    def _fit_exactly(self, demos: Episodes, world: World, model: Model, rng: np.random.Generator) -> Learned:
        states, actions = model.P.shape[:2]
        every = np.repeat(model.obs, actions, axis=0), np.tile(np.eye(actions), (states, 1))
        phi = world.phi(*every).reshape(states, actions, -1)
        mu_demo = demonstrated(demos, model)
        likelihoods: list[float] = []

        def loss(w: Array) -> tuple[float, Array]:
            likelihood, gradient = log_likelihood(model, phi @ w, mu_demo, world.gamma)
            likelihoods.append(likelihood)
            value = 0.5 * self.weight_prior * float(w @ w) - likelihood
            return value, self.weight_prior * w - np.tensordot(gradient, phi, axes=2)

        w = optimize.minimize(loss, np.zeros(phi.shape[2]), jac=True, method="L-BFGS-B").x
        reward = LinearReward(world.phi, np.append(w, 0.0))
        policy = world.solve(reward, rng, world.solve_steps)
        return Learned(policy, reward, {"log-likelihood of a step": likelihoods})

    def _fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Alternate the weights' closed form and reinforcement learning on their reward."""
        mean_demo, moment_demo = moments(demos, world)
        policy: Policy = lambda obs: world.random_actions(len(obs), rng)  # noqa: E731
        means: list[Array] = []
        second: list[Array] = []
        gaps: list[float] = []
        agent = world.agent(rng)
        for _ in range(self.iterations):
            mean, moment = moments(world.rollout(policy, self.rollouts, rng), world)
            means.append(mean)
            second.append(moment)
            gap = mean_demo - np.mean(means, axis=0)
            precision = self.prior * (moment_demo + np.mean(second, axis=0))
            w = np.linalg.solve(precision + self.weight_prior * np.eye(len(gap)), gap)
            gaps.append(float(w @ gap))
            reward = LinearReward(world.phi, w)
            agent.learn(math.ceil(self.rl_share * world.solve_steps), reward)
            policy = agent.best(reward)
        return Learned(policy, reward, {"mean reward, demonstrations minus rollouts": gaps})


def moments(episodes: Episodes, world: World) -> tuple[Array, Array]:
    """Mean (K + 1,) and second moments (K + 1, K + 1) of the features over all steps up to the horizon, the
    last feature being the absorbing indicator."""
    phi = with_absorbing_steps(world.phi(*episodes.pairs()), episodes, world.horizon - episodes.lengths)
    return phi.mean(axis=0), phi.T @ phi / len(phi)
