"""The model of "Faster Apprenticeship Learning Through Inverse Optimal Control" to the letter of its figures
4.3 and 4.4, and the arms that lead from it to `methods.shaped`, which explains the model.

    R(s, a) = -(a - f(s))^T (L(s) L(s)^T + I) (a - f(s))     (eq. 4.3)

f has 32 and 16 units, L has 32 and 32, and f is not squashed. Both outputs have the absolute loss of Keras:
f's target is the demonstrated action, R's is its bound, 0. Observations are as they are, and an end pays
nothing. Figure 4.3 needs both `keras.layers.add` and `keras.layers.merge`, so Keras is 2.0 or 2.1. Its
defaults there: weights of `glorot_uniform`, biases of 0, batches of 32, and RMSprop with learning rate 0.001,
rho 0.9 and epsilon 1e-8.

Figure 4.4 builds one matrix of a whole batch, of B examples with one action each. With d_i = a_i - f(s_i) and
l_i = L(s_i) it returns one number.

    R = -(sum_i l_i^2 (sum_i d_i)^2 + sum_i d_i^2)

That is eq. 4.3 for one example. With two actions it multiplies shapes that do not fit.

Deviates from the thesis: the number of epochs, which its text lacks, is assumed. pi* is f, clipped to the
range of actions.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import torch
from torch import nn

from methods.base import Array, Episodes, Learned, Policy, Rng, Unsuitable, World
from methods.network import LARGEST_MEAN, Network, Regression, mlp, standardiser
from methods.ranges import Count, CountOrNone, Hidden, Positive, Rate
from methods.rewards import default_absorbing
from methods.shaped import FIRST_L, SHARE_OF_L, ShapedReward, shaped_reward

Parameters = tuple[tuple[Any, Any], tuple[Any, Any]]
"""Weights and biases of each layer of f, and of L."""


@dataclass(frozen=True)
class Clipped:
    """A policy (B, O) to (B, A) that clips a network's outputs to [-1, 1]."""

    network: Network

    def __call__(self, obs: Array, /) -> Array:
        return np.clip(self.network(obs), -1, 1)


@dataclass(frozen=True)
class ShapedThesis:
    """Hyper-parameters. The last eight are arms: `shaped` is all of them but the first."""

    epochs: Count = 10
    """Passes of RMSprop through the demonstrations."""
    learning_rate: Rate = 1e-3
    """Learning rate of RMSprop."""
    epsilon: Positive = 1e-8
    """Term added to the root of RMSprop's mean squared gradient."""
    batch: Count = 32
    """Rows of each gradient step of RMSprop."""
    f_layers: Hidden = (32, 16)
    """Hidden layers of f."""
    l_layers: Hidden = (32, 32)
    """Hidden layers of L."""
    batch_matrix: bool = False
    """True for figure 4.4's number of a batch as R, False for the mean of eq. 4.3."""
    small_start: bool = False
    """True for the first weights of `shaped`, with L near 0, and its lower learning rate of L."""
    squashed: bool = False
    """True if f passes through tanh."""
    squared: bool = False
    """True if f's loss is squared."""
    units: bool = False
    """True if errors and f are in units of the actions' standard deviation, and f begins at their mean."""
    standardised: bool = False
    """True if observations are standardised."""
    soap_steps: CountOrNone = 0
    """Gradient steps of SOAP, in batches of its own, in place of RMSprop's epochs. 0 for RMSprop."""
    default_end: bool = False
    """True if an end pays the default of `shaped` (`default_absorbing`), not 0."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Minimise both losses over the demonstrated pairs. Raises Unsuitable for figure 4.4 with several
        actions."""
        if self.batch_matrix and world.act_size > 1:
            raise Unsuitable("figure 4.4 multiplies matrices of shapes that only fit one action dimension")
        obs, act = demos.pairs()
        mean, std = np.zeros(world.obs_size), np.ones(world.obs_size)
        if self.standardised:
            mean, std = standardiser(obs)
        spread = standardiser(act)[1] if self.units else np.ones(world.act_size)
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        f = mlp(world.obs_size, *self.f_layers, world.act_size, generator=generator)
        chol = mlp(world.obs_size, *self.l_layers, world.act_size**2, generator=generator)
        self._begin(f, chol, act, spread, generator)
        unit, data = torch.as_tensor(spread, dtype=torch.float32), ((obs - mean) / std, act)
        if self.soap_steps:
            soap, shares = Regression(steps=self.soap_steps), [1.0, self._share_of_l]
            loss = lambda s, a: self.loss(torch, a, f(s), chol(s), unit)  # noqa: E731
            curve = soap.minimise(loss, [f, chol], data, rng, shares)
        networks = [Network.from_torch(layers, mean, std) for layers in (f, chol)]
        if not self.soap_steps:
            networks, curve = self._by_rmsprop(networks, data, unit.numpy(), rng)
        scaled = networks[0].scaled(spread)
        star = Network.of(mean, std, scaled.weights, scaled.biases, tanh=self.squashed)
        policy: Policy = star if self.squashed else Clipped(star)
        reward = ShapedReward(star, networks[1])
        if self.default_end:
            end = default_absorbing(reward, demos, world.random_actions, rng)
            reward = ShapedReward(star, networks[1], end)
        return Learned(policy, reward, {"loss": curve}, reward.size_of_l(obs))

    @property
    def _share_of_l(self) -> float:
        return SHARE_OF_L if self.small_start else 1.0

    def _begin(
        self, f: nn.Module, chol: nn.Module, act: Array, spread: Array, generator: torch.Generator
    ) -> None:
        """Set the first weights and biases, which are torch's before."""
        if self.small_start:
            for parameter in [*chol.parameters()][-2:]:
                parameter.data *= FIRST_L
        else:
            for parameter in [*f.parameters(), *chol.parameters()]:
                if parameter.ndim == 2:
                    nn.init.xavier_uniform_(parameter, generator=generator)
                else:
                    nn.init.zeros_(parameter)
        if self.units:
            centre = act.mean(axis=0)
            if self.squashed:
                centre = np.arctanh(centre.clip(-LARGEST_MEAN, LARGEST_MEAN))
            *_, bias = f.parameters()
            bias.data += torch.as_tensor(centre / spread, dtype=bias.dtype)

    def loss(self, xp: Any, a: Any, f: Any, chol: Any, unit: Any) -> Any:
        """Return the loss of actions (B, A), outputs f (B, A) and L (B, A * A), a number. `xp`: the library
        of these arrays, torch or JAX. `unit`: (A,)."""
        f = xp.tanh(unit * f) if self.squashed else unit * f
        reward = batch_reward(xp, a, f, chol) if self.batch_matrix else shaped_reward(a, f, chol)
        errors = (a - f) / unit
        error = (errors**2).sum(1).mean() if self.squared else abs(errors).mean()
        return error - reward.mean() / (unit**2).mean()

    def _by_rmsprop(
        self, networks: list[Network], data: tuple[Array, Array], unit: Any, rng: Rng
    ) -> tuple[list[Network], list[float]]:
        """Return the networks after all epochs, and each epoch's mean loss. `data` is shuffled each time."""
        params: Any = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.float32), tuple((net.weights, net.biases) for net in networks)
        )
        rows = tuple(jnp.asarray(column, jnp.float32) for column in data)
        state, curve = (params, self._optimizer.init(params)), []
        for _ in range(self.epochs):
            state, losses = _epoch(self, state, rows, rng.permutation(len(data[0])), unit)
            curve.append(float(losses.mean()))
        return [
            Network.of(net.mean, net.std, *own) for net, own in zip(networks, state[0], strict=True)
        ], curve

    @property
    def _optimizer(self) -> optax.GradientTransformationExtraArgs:
        return optax.rmsprop(self.learning_rate, decay=0.9, eps=self.epsilon, eps_in_sqrt=False)

    def step(self, state: Any, batch: Any, unit: Any) -> tuple[Any, Any]:
        """Return parameters and RMSprop's state after a step on a batch of observations (B, O) and actions
        (B, A), and its loss before."""

        def loss(params: Parameters) -> Any:
            f, chol = (_outputs(*own, batch[0]) for own in params)
            return self.loss(jnp, batch[1], f, chol, unit)

        (params, moments), share = state, self._share_of_l
        value, gradient = jax.value_and_grad(loss)(params)
        (of_f, of_l), moments = self._optimizer.update(gradient, moments)
        updates = of_f, jax.tree.map(lambda x: share * x, of_l)
        return (optax.apply_updates(params, updates), moments), value


@partial(jax.jit, static_argnums=0)
def _epoch(method: ShapedThesis, state: Any, rows: Any, order: Any, unit: Any) -> tuple[Any, Any]:
    """Return the state after a pass through rows in this order, and each batch's loss. The last batch is
    smaller where rows are left."""
    whole = len(order) - len(order) % method.batch
    batches = tuple(x[order[:whole].reshape(-1, method.batch)] for x in rows)
    state, losses = jax.lax.scan(lambda old, new: method.step(old, new, unit), state, batches)
    if whole < len(order):
        state, last = method.step(state, tuple(x[order[whole:]] for x in rows), unit)
        losses = jnp.append(losses, last)
    return state, losses


def _outputs(weights: Any, biases: Any, x: Any) -> Any:
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        x = jax.nn.relu(x @ weight + bias)
    return x @ weights[-1] + biases[-1]


def batch_reward(xp: Any, a: Any, f: Any, chol: Any) -> Any:
    """Return figure 4.4's number for actions (B, A), f(s) (B, A) and L(s) (B, A * A), (1, 1). Raises what the
    library `xp` raises for shapes that do not fit, which those of two actions are."""
    d, size = a - f, a.shape[1]
    matrix = chol.reshape(size, -1)
    return -(d.T @ (matrix @ matrix.T + xp.eye(math.prod(chol.shape))) @ d)
