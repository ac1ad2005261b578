"""The shaped-reward model of "Faster Apprenticeship Learning Through Inverse Optimal Control".

    R(s, a) = -(a - f(s))^T (L(s) L(s)^T + I) (a - f(s))     (eq. 4.3)

R is at most 0. Maximising it over the demonstrated pairs (eq. 4.4) learns the policy f and the reward
together, without any reinforcement learning. As in figure 4.3, f is an auxiliary output of the model, fitted
to the demonstrated actions by a loss of its own. The other loss is the distance of R to 0.

Deviates from the paper: f passes through tanh, because actions are bounded, and R must not reward leaving
their range far from demonstrations. The auxiliary loss is squared, because the absolute one fits the median,
which ignores the few steps of a demonstration that recover from its start. Observations are standardised.
Errors are in units of the demonstrated actions' standard deviation, a hundredth of their range where an
expert balances well. SOAP replaces RMSprop. L starts near 0, where R is greatest, and learns at a lower rate.
Nothing determines L beyond the demonstrations, and a large one makes life there worse than its end. Figure
4.4 multiplies the batch into one matrix, eq. 4.3 does not.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import Network, Regression, begin_with, mlp, standardiser
from methods.parts import TwoParts
from methods.ranges import Between, Hidden, Weight
from methods.rewards import default_absorbing

FIRST_L = 0.01  # factor of the last weights of L that torch draws
SHARE_OF_L = 0.03
"""Learning rate of L, as a share of that of f. SOAP's steps do not shrink where L hardly matters, and would
carry it away far from demonstrations."""


@dataclass(frozen=True)
class Shaped(TwoParts, Regression):
    """Hyper-parameters, besides those of `Regression`. The layer sizes are those of figure 4.3."""

    f_layers: Hidden = (32, 16)
    """Hidden layers of f."""
    l_layers: Hidden = (32, 32)
    """Hidden layers of L."""
    weight_decay: Annotated[Weight, Between(1e-6, 1e-2)] = 0.0
    """Weight of the sum of all squared weights of f and L in the loss."""

    def first(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Maximise eq. 4.3 over the demonstrated pairs, without the environment."""
        obs, act = demos.pairs()
        mean, std = standardiser(obs)
        spread = standardiser(act)[1]
        unit = torch.as_tensor(spread, dtype=torch.float32)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        f = mlp(world.obs_size, *self.f_layers, world.act_size, generator=generator)
        begin_with(f, act, spread)
        chol = mlp(world.obs_size, *self.l_layers, world.act_size**2, generator=generator)
        *_, weight, bias = chol.parameters()
        weight.data *= FIRST_L
        bias.data *= FIRST_L
        parameters = [*f.parameters(), *chol.parameters()]

        def loss(s: Tensor, a: Tensor) -> Tensor:
            action = torch.tanh(unit * f(s))
            reward = shaped_reward(a, action, chol(s))
            error = ((a - action) / unit).square().sum(1).mean()
            total: Tensor = error - reward.mean() / unit.square().mean()
            if not self.weight_decay:
                return total
            return total + self.weight_decay * sum(p.square().sum() for p in parameters)

        data = ((obs - mean) / std, act)
        curve = self.minimise(loss, [f, chol], data, rng, shares=[1.0, SHARE_OF_L])
        policy = Network.from_torch(f, mean, std, tanh=True).scaled(spread)
        reward = ShapedReward(policy, Network.from_torch(chol, mean, std))
        absorbing = default_absorbing(reward, demos, world.random_actions, rng)
        return Learned(policy, replace(reward, absorbing=absorbing), {"loss": curve}, reward.size_of_l(obs))


def shaped_reward(a: Tensor, f: Tensor, chol: Tensor) -> Tensor:
    """Return eq. 4.3 for actions (B, A), f(s) (B, A) and L(s) (B, A * A), (B,). Arrays of JAX will do."""
    size = a.shape[1]
    d = (a - f)[:, None]
    projected = d @ chol.reshape(-1, size, size)
    return -((projected**2).sum((1, 2)) + (d**2).sum((1, 2)))


@dataclass(frozen=True)
class ShapedReward:
    """The reward of eq. 4.3: at most 0, and 0 exactly where the action is f(s)."""

    f: Network
    chol: Network
    absorbing: float = 0.0

    def size_of_l(self, obs: Array) -> dict[str, float]:
        """Return the mean and the largest eigenvalue of L L^T over observations. Those of I are 1."""
        flat = self.chol(obs)
        size = math.isqrt(flat.shape[1])
        eigenvalues = np.square(np.linalg.svd(flat.reshape(-1, size, size), compute_uv=False))
        return {
            "eigenvalues of LLᵀ, mean": float(eigenvalues.mean()),
            "eigenvalues of LLᵀ, largest": float(eigenvalues.max()),
        }

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        d = act - self.f(obs)
        size = d.shape[1]
        projected = np.einsum("bi,bij->bj", d, self.chol(obs).reshape(-1, size, size))
        return np.asarray(-(np.square(projected).sum(1) + np.square(d).sum(1)))
