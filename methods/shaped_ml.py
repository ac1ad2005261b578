"""The shaped-reward model of eq. 4.3 with L fitted by maximum likelihood. The thesis's objective, eq. 4.4, is
indifferent to L wherever f meets the demonstrations.

Under maximum entropy an expert whose advantage is eq. 4.3 acts with Gaussian noise around f(s). Its
covariance is in proportion to M(s)^-1, with M(s) = L(s) L(s)^T + I. With a covariance C added, the negative
log-likelihood of its actions is, up to constants, a sum.

    (a - f(s))^T M(s) (a - f(s)) + tr(M(s) C) - log det M(s)

It is least where M(s)^-1 is C plus the actions' covariance. So noise in demonstrations determines M, and C
does where there is little or none, and bounds M. C^-1 is in proportion to the Hessian of the action value,
the cost of an action itself and of where it leads. It is that of an inverse linear-quadratic problem (Kalman
1964), solved by the residuals of its optimality condition (Keshavarz, Wang & Boyd 2011).

Demonstrations without noise leave M open. C^-1 is right if dynamics are linear, and the true cost is a
weighted sum of squares of single observations and actions about any target. Other costs may share dynamics
and optimal policy and differ in M. Then it is a guess.

Deviates from the thesis: the objective of L, and the rollouts, to which the dynamics are fitted. The policy f
is fitted as in `methods.shaped`, because the likelihood would trade the accuracy of one action against that
of another.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from scipy import linalg, optimize
from torch import Tensor

from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import Network, mlp, standardiser
from methods.ranges import Between, Count, Positive, Weight
from methods.rewards import default_absorbing
from methods.shaped import Shaped, ShapedReward, shaped_reward

CONDITION = 100  # largest condition number of C, about
STABLE = 0.999  # largest eigenvalue of a discounted closed loop


@dataclass(frozen=True)
class ShapedML(Shaped):
    """Hyper-parameters, besides those of `Shaped`. L gets as many steps as f."""

    rollouts: Count = 10
    """Episodes of f with noise, to which the dynamics are fitted."""
    exploration: Annotated[Positive, Between(0.1, 1)] = 0.3
    """Standard deviation of that noise."""
    softness: Annotated[Positive, Between(0.01, 0.9)] = 0.1
    """Standard deviation of C, below 1, in the direction in which actions matter least."""
    prior: Annotated[Weight, Between(1e-5, 0.1)] = 1e-3
    """Inverse variance of the Gaussian prior on the weights of costs, whose mean is 1."""

    def go_on(self, first: Learned, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Fit L by maximum likelihood."""
        assert isinstance(first.policy, Network)
        f, size = first.policy, world.act_size
        precision = self._precision(demos, world, f, rng)
        C = torch.as_tensor(np.linalg.inv(precision), dtype=torch.float32)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        chol = mlp(world.obs_size, *self.l_layers, size**2, generator=generator)
        start = np.linalg.cholesky(precision - np.eye(size))
        *_, bias = chol.parameters()
        bias.data = torch.as_tensor(start.flatten(), dtype=torch.float32)

        def loss(s: Tensor, d: Tensor) -> Tensor:
            L = chol(s).view(-1, size, size)
            M = L @ L.mT + torch.eye(size)
            quadratic: Tensor = (M * C).sum((1, 2)) - shaped_reward(d, torch.zeros_like(d), L)
            return (quadratic - torch.logdet(M)).mean()

        obs, act = demos.pairs()
        data = ((obs - f.mean) / f.std, act - f(obs))
        curve = self.minimise(loss, [chol], data, rng)
        reward = ShapedReward(f, Network.from_torch(chol, f.mean, f.std))
        absorbing = default_absorbing(reward, demos, world.random_actions, rng)
        curves = {**first.curves, "negative log-likelihood": curve}
        return Learned(f, replace(reward, absorbing=absorbing), curves, reward.size_of_l(demos.pairs()[0]))

    def _precision(self, demos: Episodes, world: World, f: Network, rng: Rng) -> Array:
        """Return C^-1 (A, A). `softness` sets its smallest eigenvalue."""

        def noisy(obs: Array) -> Array:
            return np.clip(f(obs) + self.exploration * rng.normal(size=(len(obs), world.act_size)), -1, 1)

        obs, act = demos.pairs()
        centre, spread = standardiser(act)
        x, u = (obs - f.mean) / f.std, (act - centre) / spread
        both = (demos, world.rollout(noisy, self.rollouts, rng))
        steps = [episodes.transitions() for episodes in both]
        before, acts, after = (np.concatenate(parts) for parts in zip(*steps, strict=True))
        moved = np.concatenate([(before - f.mean) / f.std, (acts - centre) / spread], axis=1)
        dynamics = linear_fit(moved, (after - f.mean) / f.std)
        A, B = np.split(dynamics, [world.obs_size], axis=1)
        hessian = inverse_lqr(A, B, -linear_fit(x, u), x, world.gamma, self.prior)
        hessian /= np.outer(spread, spread)
        hessian += np.eye(len(hessian)) * np.trace(hessian) / CONDITION
        smallest: float = np.linalg.eigvalsh(hessian)[0]
        return hessian / (smallest * self.softness**2)


def linear_fit(x: Array, y: Array) -> Array:
    """Return the slopes of y (N, K) on x (N, I) by least squares, (K, I)."""
    return np.asarray(np.linalg.lstsq(x - x.mean(axis=0), y - y.mean(axis=0))[0].T)


def inverse_lqr(A: Array, B: Array, K: Array, x: Array, gamma: float, prior: float) -> Array:
    """Return the Hessian of the action value, up to sign and scale, for which the feedback u = -K x is best,
    (U, U).

    Dynamics are A x + B u, with A (X, X) and B (X, U). The cost is x^T diag(q) x + u^T diag(r) u, with q and
    r at least 0. The action value's gradient at u = -K x is linear in q and r, and 0 for the true ones. The
    estimates minimise its mean square over states x (N, X), plus `prior` times their squared distance from 1.
    An unstable closed loop is shrunk until it is stable.
    """
    states, actions = B.shape
    closed = np.sqrt(gamma) * (A - B @ K)
    closed *= min(1.0, STABLE / max(np.abs(np.linalg.eigvals(closed)).max(), STABLE))
    root = np.linalg.qr(x).R.T / np.sqrt(len(x))
    hessians, gradients = [], []
    for cost in np.eye(states + actions):
        Q, R = np.diag(cost[:states]), np.diag(cost[states:])
        P = linalg.solve_discrete_lyapunov(closed.T, Q + K.T @ R @ K)
        hessians.append(R + gamma * B.T @ P @ B)
        gradients.append(((R @ K - np.sqrt(gamma) * B.T @ P @ closed) @ root).ravel())
    ridge = np.sqrt(prior) * np.eye(states + actions)
    equations = np.concatenate([np.stack(gradients, axis=1), ridge])
    weights = optimize.nnls(equations, np.append(np.zeros(len(gradients[0])), ridge.sum(axis=0)))[0]
    return np.asarray(np.tensordot(weights, np.stack(hessians), axes=1))
