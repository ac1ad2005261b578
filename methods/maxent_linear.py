"""Linear maximum-entropy inverse reinforcement learning (Ziebart, Maas, Bagnell & Dey 2008).

The demonstrations' log-likelihood L rises along their mean features, minus those that the weights w lead to.
The reward is linear.

    r(s, a) = w^T phi(s, a),   grad_w log L = phi_D - E[phi]

Here phi are features. Where the model is known the likelihood is that of maximum causal entropy up to the
horizon (Ziebart, Bagnell & Dey 2010). It is concave in w, and L-BFGS maximises it with the weights' prior.

Deviates from the paper: a Gaussian prior on w keeps it finite where demonstrations leave no doubt. Where the
model is not known, "solve the MDP" is RL that goes on from before, and E[phi] comes from its rollouts,
averaged over the iterations. Each iteration's weights solve a linear system, because a Gaussian prior on
reward values is quadratic in them. Features get an absorbing indicator, and visitations count absorbing steps
up to the horizon. So the reward of absorption is learned like any state's.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy import optimize

from envs.models import Model
from methods.base import Array, Episodes, Learned, Policy, Rng, World
from methods.ranges import Between, Count, Positive, Weight
from methods.rewards import LinearReward
from methods.tabular.maxent import log_likelihood
from methods.tabular.model import demonstrated
from methods.visits import with_absorbing_steps


@dataclass(frozen=True)
class MaxEntLinear:
    """Hyper-parameters of linear maximum-entropy IRL."""

    iterations: Count = 5
    """Reward updates, each followed by reinforcement learning."""
    rl_share: Positive = 0.3
    """Environment steps of each iteration, as a share of a solve from scratch."""
    rollouts: Count = 10
    """Episodes that estimate a policy's mean features."""
    prior: Annotated[Weight, Between(0.05, 5)] = 0.5
    """Inverse variance of the Gaussian prior on reward values, where the model is not known."""
    weight_prior: Annotated[Weight, Between(1e-4, 0.1)] = 1e-3
    """Inverse variance of the Gaussian prior on weights."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Alternate the weights' closed form and reinforcement learning on their reward."""
        if world.model is not None:
            return self.maximise(demos, world, world.model, rng)
        mean_demo, moment_demo = moments(demos, world)
        policy: Policy = lambda obs: world.random_actions(len(obs), rng)  # noqa: E731
        means: list[Array] = []
        second: list[Array] = []
        agent = world.agent(rng)
        for _ in range(self.iterations):
            mean, moment = moments(world.rollout(policy, self.rollouts, rng), world)
            means.append(mean)
            second.append(moment)
            gap = mean_demo - np.mean(means, axis=0)
            precision = self.prior * (moment_demo + np.mean(second, axis=0))
            w = np.linalg.solve(precision + self.weight_prior * np.eye(len(gap)), gap)
            world.log({"mean reward, demonstrations minus rollouts": float(w @ gap)})
            reward = LinearReward(world.phi, w)
            agent.learn(math.ceil(self.rl_share * world.solve_steps), reward)
            policy = agent.best(reward)
        return Learned(policy, reward)

    def maximise(self, demos: Episodes, world: World, model: Model, rng: Rng) -> Learned:
        """Maximise the posterior density of the weights where the model is known."""
        states, actions = model.P.shape[:2]
        every = np.repeat(model.obs, actions, axis=0), np.tile(np.eye(actions), (states, 1))
        phi = world.phi(*every).reshape(states, actions, -1)
        mu_demo = demonstrated(demos, model)

        def loss(w: Array) -> tuple[float, Array]:
            likelihood, gradient = log_likelihood(model, phi @ w, mu_demo, world.gamma)
            world.log({"log-likelihood of a step": likelihood})
            value = 0.5 * self.weight_prior * float(w @ w) - likelihood
            return value, self.weight_prior * w - np.tensordot(gradient, phi, axes=2)

        w = optimize.minimize(loss, np.zeros(phi.shape[2]), jac=True, method="L-BFGS-B").x
        reward = LinearReward(world.phi, np.append(w, 0.0))
        policy = world.solve(reward, rng, world.solve_steps)
        return Learned(policy, reward)


def moments(episodes: Episodes, world: World) -> tuple[Array, Array]:
    """Return the features' mean (K + 1,) and second moments (K + 1, K + 1) over all steps up to the horizon.
    The last feature is the absorbing indicator."""
    phi = with_absorbing_steps(world.phi(*episodes.pairs()), episodes, world.horizon - episodes.lengths)
    return phi.mean(axis=0), phi.T @ phi / len(phi)
