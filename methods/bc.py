"""Behaviour cloning (Pomerleau 1991; Bain & Sammut 1999): regression from observations to actions.

It learns no reward, so there is no pi_R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Episodes, Learned, World
from methods.network import Network, Regression, mlp, standardiser


@dataclass(frozen=True)
class BehaviourCloning(Regression):
    """Its hyper-parameters, besides those of `Regression`."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the policy."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Minimise the squared error of the policy's actions, in units of their standard deviation: one who
        balances well hardly moves. Touches no environment."""
        obs, act = demos.pairs()
        mean, std = standardiser(obs)
        spread = standardiser(act)[1]
        unit = torch.as_tensor(spread, dtype=torch.float32)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        policy = mlp(world.obs_size, *self.layers, world.act_size, generator=generator)

        def loss(s: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
            return ((a - torch.tanh(unit * policy(s))) / unit).square().mean()

        data = ((obs - mean) / std, act)
        curve = self.minimise(loss, [policy], data, rng)
        fitted = Network.from_torch(policy, mean, std, tanh=True).scaled(spread)
        return Learned(fitted, None, {"loss": curve})
