"""Random Fourier features (Rahimi & Recht 2007): linear rewards of them are smooth functions of any shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from methods.base import Array
from methods.network import standardiser


@dataclass(frozen=True)
class FourierFeatures:
    """A task's features phi (B, K) of (B, O) observations and (B, A) actions, and F cosines of both, whose
    squares sum to 1 on average: inner products of these are nearly a Gaussian kernel's values.

    mean, std: (O,), of observations. frequencies: (O + A, F). phases: (F,).
    """

    phi: Callable[[Array, Array], Array]
    mean: Array
    std: Array
    frequencies: Array
    phases: Array

    @classmethod
    def drawn(
        cls,
        phi: Callable[[Array, Array], Array],
        obs: Array,
        act_size: int,
        count: int,
        width: float,
        rng: np.random.Generator,
    ) -> FourierFeatures:
        """count: F. width: of the kernel, in standard deviations of obs (N, O), and in actions."""
        mean, std = standardiser(obs)
        frequencies = rng.normal(size=(len(mean) + act_size, count)) / width
        return cls(phi, mean, std, frequencies, rng.uniform(0, 2 * np.pi, count))

    def __call__(self, obs: Array, act: Array, /) -> Array:
        x = np.concatenate([(obs - self.mean) / self.std, act], axis=1)
        waves = np.cos(x @ self.frequencies + self.phases) * np.sqrt(2 / len(self.phases))
        return np.concatenate([self.phi(obs, act), waves], axis=1)
