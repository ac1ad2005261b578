"""A feed-forward network as plain arrays: what a fitted torch network becomes, to be run fast, stored
without pickle and sent between processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import torch
from torch.autograd.function import once_differentiable

from methods.base import Array
from methods.soap import Soap

torch.set_num_threads(1)

ADAM: dict[str, Any] = {"fused": True}
"""Options of torch's Adam. Its default is slower, and takes square roots that each maker's processors round
otherwise."""
NEAR = 0.1
"""Over which slopes are measured, in standard deviations."""
LARGEST_MEAN = 0.999
"""The size of mean actions that networks begin with, at most."""
ROWS = 1024
"""Rows that a network answers at a time: their activations fit into a processor's cache."""
COMPILED_ROWS = 512
"""Rows that a compiled mean of networks answers at a time."""


@dataclass(frozen=True)
class Network:
    """x -> standardise -> (linear -> ReLU)* -> linear -> optional tanh, on batches (B, I) to (B, K)."""

    mean: Array
    std: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    tanh: bool = False

    def __post_init__(self) -> None:
        # Products of other layouts are rounded otherwise, and what is stored has this one.
        for name in ("mean", "std"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        for name in ("weights", "biases"):
            arrays = tuple(np.ascontiguousarray(array, np.float64) for array in getattr(self, name))
            object.__setattr__(self, name, arrays)

    def __call__(self, x: Array, /) -> Array:
        if len(x) > ROWS:
            return np.concatenate([self(x[start : start + ROWS]) for start in range(0, len(x), ROWS)])
        x = (x - self.mean) / self.std
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weight + bias, 0)
        x = x @ self.weights[-1] + self.biases[-1]
        return np.tanh(x) if self.tanh else x

    @property
    def form(self) -> tuple[Any, ...]:
        """All but weights and biases, which networks of one `MeanNetwork` have alike."""
        shapes = tuple(weight.shape for weight in self.weights)
        return self.mean.tobytes(), self.std.tobytes(), shapes, self.tanh

    @classmethod
    def from_torch(cls, layers: torch.nn.Module, mean: Array, std: Array, tanh: bool = False) -> Network:
        """From a stack of Linear and ReLU layers (any Tanh at its end to be named by `tanh`)."""
        linear = [m for m in layers.modules() if isinstance(m, torch.nn.Linear)]
        weights = tuple(m.weight.detach().cpu().double().numpy().T.copy() for m in linear)
        biases = tuple(m.bias.detach().cpu().double().numpy().copy() for m in linear)
        return cls(mean, std, weights, biases, tanh)

    @classmethod
    def from_flax(
        cls, layers: Mapping[str, Mapping[str, Any]], mean: Array, std: Array, tanh: bool = False
    ) -> Network:
        """From the parameters of layers Dense_0, Dense_1, ..., with ReLU between them."""
        dense = [layers[f"Dense_{i}"] for i in range(len(layers))]
        weights = tuple(np.array(layer["kernel"], np.float64) for layer in dense)
        biases = tuple(np.array(layer["bias"], np.float64) for layer in dense)
        return cls(mean, std, weights, biases, tanh)

    def scaled(self, factors: Array) -> Network:
        """The network whose outputs, before any tanh, are `factors` (K,) times as large."""
        weights, biases = (
            (*self.weights[:-1], self.weights[-1] * factors),
            (*self.biases[:-1], self.biases[-1] * factors),
        )
        return replace(self, weights=weights, biases=biases)

    def arrays(self) -> dict[str, Array]:
        """Its numbers by name, for storage; `from_arrays` is the inverse."""
        named = {"mean": self.mean, "std": self.std, "tanh": np.array(float(self.tanh))}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named |= {f"weight{i}": weight, f"bias{i}": bias}
        return named

    @classmethod
    def from_arrays(cls, named: Mapping[str, Array]) -> Network:
        """Raises KeyError where an array is missing."""
        layers = range((len(named) - 3) // 2)
        return cls(
            named["mean"],
            named["std"],
            tuple(named[f"weight{i}"] for i in layers),
            tuple(named[f"bias{i}"] for i in layers),
            bool(named["tanh"]),
        )


@dataclass(frozen=True)
class MeanNetwork:
    """The mean of networks of one `form`, each times its size, compiled in float32: (B, I) to (B, K).
    A few rows are answered in float64, which is faster for those."""

    networks: tuple[Network, ...]
    sizes: tuple[float, ...]

    def __call__(self, x: Array, /) -> Array:
        if 2 * len(x) < COMPILED_ROWS:
            parts = [size * network(x) for size, network in zip(self.sizes, self.networks, strict=True)]
            return np.asarray(np.mean(parts, axis=0))
        first = self.networks[0]
        padded = np.zeros((-(-len(x) // COMPILED_ROWS), COMPILED_ROWS, x.shape[1]), np.float32)
        padded.reshape(-1, x.shape[1])[: len(x)] = (x - first.mean) / first.std
        parts = [np.asarray(_mean(*self._stacked, rows, first.tanh)) for rows in padded]
        return np.concatenate(parts)[: len(x)].astype(np.float64)

    @cached_property
    def _stacked(self) -> Any:
        parts = [(n.weights, n.biases, size) for n, size in zip(self.networks, self.sizes, strict=True)]
        return jax.tree.map(lambda *each: jnp.asarray(np.stack(each), jnp.float32), *parts)


@partial(jax.jit, static_argnames="tanh")
def _mean(weights: Any, biases: Any, sizes: Any, x: Any, tanh: bool) -> Any:
    def add(total: Any, network: Any) -> tuple[Any, None]:
        *hidden, (weight, bias) = zip(*network[:2], strict=True)
        y = x
        for inner, shift in hidden:
            y = jax.nn.relu(y @ inner + shift)
        y = y @ weight + bias
        return total + network[2] * (jnp.tanh(y) if tanh else y), None

    start = jnp.zeros((len(x), biases[-1].shape[1]), jnp.float32)
    return jax.lax.scan(add, start, (weights, biases, sizes))[0] / len(sizes)


class _Product(torch.autograd.Function):
    """x (N, I) @ weight (K, I)^T + bias (K,), by NumPy: its BLAS, held to instructions that all processors
    have, is faster than torch's."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(x, weight)
        y = x.detach().numpy() @ weight.detach().numpy().T
        y += bias.detach().numpy()
        return torch.from_numpy(y)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        x, weight = (saved.detach().numpy() for saved in ctx.saved_tensors)
        g = grad.numpy()
        to_x = torch.from_numpy(g @ weight) if ctx.needs_input_grad[0] else None
        # Of many rows, a product is faster than a sum.
        to_bias = np.ones(len(g), g.dtype) @ g
        return to_x, torch.from_numpy(g.T @ x), torch.from_numpy(to_bias)


class Linear(torch.nn.Linear):
    """torch's, on the processor; it can be differentiated once."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        product: torch.Tensor = _Product.apply(x, self.weight, self.bias)  # type: ignore[no-untyped-call]
        return product


def mlp(*sizes: int, generator: torch.Generator) -> torch.nn.Sequential:
    """Linear layers with ReLU between them, initialised by torch's rule for them, from the generator."""
    layers: list[torch.nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        linear = Linear(inputs, outputs)
        for parameter in linear.parameters():
            torch.nn.init.uniform_(parameter, -(inputs**-0.5), inputs**-0.5, generator=generator)
        layers += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])


def begin_with(layers: torch.nn.Module, act: Array, spread: Array) -> None:
    """Have tanh(spread * layers(x)) be about the mean of actions (N, A) at first: where the spread (A,) is
    small, an optimizer would take long to go there."""
    *_, bias = layers.parameters()
    outputs = np.arctanh(act.mean(axis=0).clip(-LARGEST_MEAN, LARGEST_MEAN)) / spread
    bias.data += torch.as_tensor(outputs, dtype=bias.dtype)


def standardiser(x: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of each column of (N, I); 1 where a column does not vary."""
    std = x.std(axis=0)
    return x.mean(axis=0), np.where(std > 1e-8, std, 1.0)


class Contrast(NamedTuple):
    """What a network says of two batches of rows, (B, 1) each, and its mean squared slope between them."""

    a: torch.Tensor
    b: torch.Tensor
    squared_slope: torch.Tensor


def contrast(
    network: torch.nn.Module,
    a: torch.Tensor,
    b: torch.Tensor,
    generator: torch.Generator,
    among: torch.Tensor | None = None,
) -> Contrast:
    """Return what a network says of rows a (B, K) and b (B, K), and its slope between each two of them.

    The slope is |gradient|^2 on average over places there, by differences over `NEAR` in random directions
    (Gulrajani et al. 2017 penalise what it is more than 1). among (B,): which of the pairs count for it, by
    default all; 0 where none does. One pass of the network answers all.
    """
    share = torch.rand(len(a), 1, generator=generator)
    middle, step = share * a + (1 - share) * b, NEAR / 2 * torch.randn(a.shape, generator=generator)
    of_a, of_b, before, after = network(torch.cat([a, b, middle - step, middle + step])).chunk(4)
    slopes = ((after - before) / NEAR).square()[:, 0]
    if among is None:
        return Contrast(of_a, of_b, slopes.mean())
    return Contrast(of_a, of_b, (slopes * among).sum() / among.sum().clamp(min=1))


def descend(
    loss: Callable[..., torch.Tensor],
    optimizer: torch.optim.Optimizer,
    data: Sequence[Array],
    steps: int,
    batch: int,
    rng: np.random.Generator,
    points: int = 100,
) -> list[float]:
    """Minimise `loss(*minibatch)`, at a rate that falls from the optimizer's to 0 by a half cosine.

    data: arrays of equal length. Returns the mean loss of each of `points` equal stretches.
    """
    tensors = [torch.as_tensor(array, dtype=torch.float32) for array in data]
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    values = np.zeros(steps)
    for step in range(steps):
        rows = torch.as_tensor(rng.integers(len(tensors[0]), size=batch))
        value = loss(*(tensor[rows] for tensor in tensors))
        optimizer.zero_grad()
        value.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        values[step] = value.item()
    return [float(stretch.mean()) for stretch in np.array_split(values, min(points, steps))]


@dataclass(frozen=True)
class Regression:
    """Hyper-parameters of fits to demonstrations, by SOAP."""

    learning_rate: float = 1e-2
    """At the start; it falls to 0."""
    batch: int = 512
    """Rows of each step."""
    steps: int = 2000
    """Gradient steps."""

    def minimise(
        self,
        loss: Callable[..., torch.Tensor],
        networks: Sequence[torch.nn.Module],
        data: Sequence[Array],
        rng: np.random.Generator,
        shares: Sequence[float] | None = None,
    ) -> list[float]:
        """Fit the networks' parameters to `data`, as in `descend`, and return the loss as it falls.

        shares: of each network, what share of the learning rate is its own, by default all.
        """
        rates = [self.learning_rate * share for share in shares or [1.0] * len(networks)]
        return descend(loss, Soap(networks, rates), data, self.steps, self.batch, rng)
