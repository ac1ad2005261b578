"""Behaviour cloning (Pomerleau 1991; Bain & Sammut 1999): regression from observations to actions.
The error is squared, in units of each action's standard deviation over the demonstrations, sigma.

    min over pi of E_D |(a - pi(s)) / sigma|^2

It learns no reward, so there is no pi_R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Array, Episodes, Learned, World
from methods.network import Network, Regression, begin_with, mlp, standardiser


@dataclass(frozen=True)
class BehaviourCloning(Regression):
    """Its hyper-parameters, besides those of `Regression`."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the policy."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Clone what is shown. Touches no environment."""
        policy, losses = self.clone(*demos.pairs(), rng)
        return Learned(policy, None, {"loss": losses})

    def clone(self, obs: Array, act: Array, rng: np.random.Generator) -> tuple[Network, list[float]]:
        """Minimise the squared error of the policy's actions act (N, A) at obs (N, O), in units of their
        standard deviation: one who balances well hardly moves. The policy, and the loss as it falls."""
        mean, std = standardiser(obs)
        spread = standardiser(act)[1]
        unit = torch.as_tensor(spread, dtype=torch.float32)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        policy = mlp(obs.shape[1], *self.layers, act.shape[1], generator=generator)
        begin_with(policy, act, spread)

        def loss(s: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
            return ((a - torch.tanh(unit * policy(s))) / unit).square().mean()

        data = ((obs - mean) / std, act)
        curve = self.minimise(loss, [policy], data, rng)
        return Network.from_torch(policy, mean, std, tanh=True).scaled(spread), curve
