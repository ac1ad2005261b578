"""Random Fourier features (Rahimi & Recht 2007). Linear rewards of them are smooth functions of any shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.base import Array, Phi, Rng
from methods.network import standardiser


@dataclass(frozen=True)
class FourierFeatures:
    """A task's features phi (B, K) of observations (B, O) and actions (B, A), and F cosines of both.

    The cosines' squares sum to 1 on average, and their inner products are nearly a Gaussian kernel's values.
    `mean`, `std`: of observations, (O,). `frequencies`: (O + A, F). `phases`: (F,).
    """

    phi: Phi
    mean: Array
    std: Array
    frequencies: Array
    phases: Array

    @classmethod
    def drawn(
        cls, phi: Phi, obs: Array, act_size: int, count: int, width: float, rng: Rng
    ) -> FourierFeatures:
        """Return random features with F = `count`. `width`: the kernel's, in standard deviations of
        observations (N, O) and in units of actions."""
        mean, std = standardiser(obs)
        frequencies = rng.normal(size=(len(mean) + act_size, count)) / width
        return cls(phi, mean, std, frequencies, rng.uniform(0, 2 * np.pi, count))

    def __call__(self, obs: Array, act: Array, /) -> Array:
        x = np.concatenate([(obs - self.mean) / self.std, act], axis=1)
        waves = np.cos(x @ self.frequencies + self.phases) * np.sqrt(2 / len(self.phases))
        return np.concatenate([self.phi(obs, act), waves], axis=1)
