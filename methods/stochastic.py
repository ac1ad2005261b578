"""Stochastic policies as plain arrays: what agents explore with, and soft actor-critic may begin with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from methods.base import Array, Policy
from methods.network import Network

LOG_STD = (-20.0, 2.0)
"""Bounds of the logarithm of the standard deviation, as in Haarnoja et al. 2018 and in their followers."""
LARGEST = 1 - 2.0**-24
"""The largest action below 1 in 32 bits. Those that are 1 there lie anywhere beyond, and count as it."""


@dataclass(frozen=True)
class SquashedGaussian:
    """tanh(u), u being normal and its entries independent. The network gives, before any tanh, the mean of u
    and the logarithm of its standard deviation, one after the other: (B, O) to (B, 2A)."""

    network: Network

    def sample(self, obs: Array, rng: np.random.Generator) -> Array:
        """(B, A): an action for each observation (B, O)."""
        mean, log_std = self._parameters(obs)
        return np.tanh(mean + np.exp(log_std) * rng.standard_normal(mean.shape))

    def log_prob(self, obs: Array, act: Array) -> Array:
        """(B,): logarithm of the density of actions (B, A), on [-1, 1]^A, at observations (B, O)."""
        mean, log_std = self._parameters(obs)
        act = np.clip(act, -LARGEST, LARGEST)
        z = (np.arctanh(act) - mean) / np.exp(log_std)
        normal = -0.5 * (z**2 + np.log(2 * np.pi)) - log_std
        # d tanh(u) / du = 1 - tanh(u)^2
        return np.asarray((normal - np.log1p(act) - np.log1p(-act)).sum(axis=1))

    @property
    def mean(self) -> Network:
        """The policy that does tanh of the mean of u."""
        net, size = self.network, len(self.network.biases[-1]) // 2
        weights = (*net.weights[:-1], net.weights[-1][:, :size])
        return replace(net, weights=weights, biases=(*net.biases[:-1], net.biases[-1][:size]), tanh=True)

    def _parameters(self, obs: Array) -> tuple[Array, Array]:
        mean, log_std = np.split(self.network(obs), 2, axis=1)
        return mean, np.clip(log_std, *LOG_STD)


@dataclass(frozen=True)
class EpsilonGreedy:
    """Does what the policy does, which chooses, but for a share of choices that are uniform. share: in
    (0, 1]."""

    mean: Policy
    share: float

    def sample(self, obs: Array, rng: np.random.Generator) -> Array:
        """(B, A): 1 for the choice at each observation (B, O), and 0 for others."""
        greedy = self._greedy(obs)
        uniform = np.eye(greedy.shape[1])[rng.integers(greedy.shape[1], size=len(obs))]
        return np.where(rng.random((len(obs), 1)) < self.share, uniform, greedy)

    def log_prob(self, obs: Array, act: Array) -> Array:
        """(B,): logarithm of the probability of the choices (B, A) at observations (B, O)."""
        greedy = self._greedy(obs)
        same = (greedy * act).sum(axis=1)
        return np.asarray(np.log((1 - self.share) * same + self.share / greedy.shape[1]))

    def _greedy(self, obs: Array) -> Array:
        values = self.mean(obs)
        chosen: Array = np.eye(values.shape[1])[values.argmax(axis=1)]
        return chosen


@dataclass(frozen=True)
class Gaussian:
    """Normal actions about a mean, independent; what lies beyond [-1, 1] counts as the bound. log_std (A,):
    logarithm of the standard deviation, the same at all observations."""

    mean: Policy
    log_std: Array

    def sample(self, obs: Array, rng: np.random.Generator) -> Array:
        """Return an action for each observation (B, O), (B, A)."""
        mean = self.mean(obs)
        return np.clip(mean + np.exp(self.log_std) * rng.standard_normal(mean.shape), -1, 1)

    def log_prob(self, obs: Array, act: Array) -> Array:
        """Return the logarithm of the normal density of actions (B, A) at observations (B, O), (B,)."""
        z = (act - self.mean(obs)) / np.exp(self.log_std)
        return np.asarray((-0.5 * (z**2 + np.log(2 * np.pi)) - self.log_std).sum(axis=1))


@dataclass(frozen=True)
class Softmax:
    """Choices whose probabilities are in proportion to exp(mean(obs))."""

    mean: Policy

    def sample(self, obs: Array, rng: np.random.Generator) -> Array:
        """Return 1 for the choice at each observation (B, O), and 0 for others, (B, A)."""
        values = self.mean(obs)
        chosen: Array = np.eye(values.shape[1])[(values + rng.gumbel(size=values.shape)).argmax(axis=1)]
        return chosen

    def log_prob(self, obs: Array, act: Array) -> Array:
        """Return the logarithm of the probability of the choices (B, A) at observations (B, O), (B,)."""
        values = self.mean(obs)
        return np.asarray((values * act).sum(axis=1) - logsumexp(values, axis=1))
