"""Stochastic policies as plain arrays. Agents explore with them, and soft actor-critic may begin with one."""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from methods.base import Array, Policy, RandomActions, Rng
from methods.network import Network

LOG_STD = (-20.0, 2.0)
"""Bounds of the log standard deviation, as in Haarnoja et al. 2018."""
LARGEST = 1 - 2.0**-24
"""Largest action below 1 in 32 bits. Larger ones count as this one."""


@dataclass(frozen=True)
class SquashedGaussian:
    """Actions tanh(u), for normal u with independent entries. The network maps (B, O) to (B, 2A): the mean of
    u and its log standard deviation, without a tanh."""

    network: Network

    def sample(self, obs: Array, rng: Rng) -> Array:
        mean, log_std = self._parameters(obs)
        return np.tanh(mean + np.exp(log_std) * rng.standard_normal(mean.shape))

    def log_prob(self, obs: Array, act: Array) -> Array:
        """Return the log density of actions (B, A), on [-1, 1]^A, at observations (B, O), (B,)."""
        mean, log_std = self._parameters(obs)
        act = np.clip(act, -LARGEST, LARGEST)
        z = (np.arctanh(act) - mean) / np.exp(log_std)
        normal = -0.5 * (z**2 + np.log(2 * np.pi)) - log_std
        # d tanh(u) / du = 1 - tanh(u)^2
        return np.asarray((normal - np.log1p(act) - np.log1p(-act)).sum(axis=1))

    @property
    def mean(self) -> Network:
        """The policy whose action is tanh of the mean of u."""
        net, size = self.network, len(self.network.biases[-1]) // 2
        weights, biases = ([*arrays[:-1], arrays[-1][..., :size]] for arrays in (net.weights, net.biases))
        return Network.of(net.mean, net.std, weights, biases, tanh=True)

    def _parameters(self, obs: Array) -> tuple[Array, Array]:
        mean, log_std = np.split(self.network(obs), 2, axis=1)
        return mean, np.clip(log_std, *LOG_STD)


@dataclass(frozen=True)
class EpsilonGreedy:
    """Choices of a policy, except for a share in (0, 1] of uniform ones."""

    mean: Policy
    share: float

    def sample(self, obs: Array, rng: Rng) -> Array:
        greedy = self._greedy(obs)
        uniform = np.eye(greedy.shape[1])[rng.integers(greedy.shape[1], size=len(obs))]
        return np.where(rng.random((len(obs), 1)) < self.share, uniform, greedy)

    def log_prob(self, obs: Array, act: Array) -> Array:
        greedy = self._greedy(obs)
        same = (greedy * act).sum(axis=1)
        return np.asarray(np.log((1 - self.share) * same + self.share / greedy.shape[1]))

    def _greedy(self, obs: Array) -> Array:
        values = self.mean(obs)
        return np.asarray(np.eye(values.shape[1])[values.argmax(axis=1)])


@dataclass(frozen=True)
class Gaussian:
    """Independent normal actions, clipped to [-1, 1]. `log_std` (A,): the same at all observations."""

    mean: Policy
    log_std: Array

    def sample(self, obs: Array, rng: Rng) -> Array:
        mean = self.mean(obs)
        return np.clip(mean + np.exp(self.log_std) * rng.standard_normal(mean.shape), -1, 1)

    def log_prob(self, obs: Array, act: Array) -> Array:
        z = (act - self.mean(obs)) / np.exp(self.log_std)
        return np.asarray((-0.5 * (z**2 + np.log(2 * np.pi)) - self.log_std).sum(axis=1))


@dataclass(frozen=True)
class Softmax:
    """Choices whose probabilities are in proportion to exp(mean(obs))."""

    mean: Policy

    def sample(self, obs: Array, rng: Rng) -> Array:
        values = self.mean(obs)
        return np.asarray(np.eye(values.shape[1])[(values + rng.gumbel(size=values.shape)).argmax(axis=1)])

    def log_prob(self, obs: Array, act: Array) -> Array:
        values = self.mean(obs)
        return np.asarray((values * act).sum(axis=1) - logsumexp(values, axis=1))


def roughened(policy: Policy, share: float, random_actions: RandomActions, rng: Rng) -> Policy:
    """Return the policy with this share of its actions replaced by random ones."""

    def act(obs: Array) -> Array:
        replaced = rng.random((len(obs), 1)) < share
        return np.where(replaced, random_actions(len(obs), rng), policy(obs))

    return act
