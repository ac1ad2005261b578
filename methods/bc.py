"""Behaviour cloning (Pomerleau 1991; Bain & Sammut 1999): regression from observations to actions.

It learns no reward, so there is no pi_R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Episodes, Learned, World
from methods.network import Network, converge, descend, mlp, standardiser


@dataclass(frozen=True)
class BehaviourCloning:
    """Its hyper-parameters."""

    layers: tuple[int, ...] = (64, 64)
    """Hidden layers of the policy."""
    learning_rate: float = 3e-3
    batch: int = 256
    steps: int = 5000
    """Gradient steps."""
    iterations: int = 300
    """Of L-BFGS after them."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Minimise the squared error of the policy's actions, by Adam and then L-BFGS, for the last percent
        of it decides where a cloned balancer drifts to. Actions are in units of their standard deviation: one
        who balances well hardly moves. Touches no environment."""
        obs, act = demos.pairs()
        mean, std = standardiser(obs)
        spread = standardiser(act)[1]
        unit = torch.as_tensor(spread, dtype=torch.float32)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        policy = mlp(world.obs_size, *self.layers, world.act_size, generator=generator)

        def loss(s: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
            return ((a - torch.tanh(unit * policy(s))) / unit).square().mean()

        data = ((obs - mean) / std, act)
        curve = descend(loss, [policy], data, self.learning_rate, self.steps, self.batch, rng)
        curve.append(converge(loss, [policy], data, self.iterations))
        fitted = Network.from_torch(policy, mean, std, tanh=True).scaled(spread)
        return Learned(fitted, None, {"loss": curve})
