"""Behaviour cloning (Pomerleau 1991; Bain & Sammut 1999): regression from observations to actions. The error
is squared, in units of each action's standard deviation sigma over the demonstrations.

    min over pi of E_D |(a - pi(s)) / sigma|^2

It learns no reward, so it has no pi_R.
"""

from dataclasses import dataclass

import torch

from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import Network, Regression, begin_with, mlp, standardiser
from methods.ranges import Hidden


@dataclass(frozen=True)
class BehaviourCloning(Regression):
    """Hyper-parameters of cloning, besides those of `Regression`."""

    layers: Hidden = (64, 64)
    """Hidden layers of the policy."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Clone the demonstrations, without the environment."""
        policy, losses = self.clone(*demos.pairs(), rng)
        return Learned(policy, None, {"loss": losses})

    def clone(self, obs: Array, act: Array, rng: Rng) -> tuple[Network, list[float]]:
        """Fit a policy to actions (N, A) at observations (N, O), and return it with its falling loss. Errors
        are in units of the actions' standard deviation, because an expert that balances well hardly moves."""
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
