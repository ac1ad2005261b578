"""Networks: plain arrays, which are fast, stored without pickle and sent between processes; and torch layers,
which are fitted and become plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import softplus

from methods.base import Array, Rng
from methods.ranges import Between, Count, Positive
from methods.soap import Soap

torch.set_num_threads(1)

ADAM: dict[str, Any] = {"fused": True}
"""Options of torch's Adam. Its default is slower, and differs between makers of processors."""
NEAR = 0.1  # distance over which slopes are measured, in standard deviations
LARGEST_MEAN = 0.999  # largest mean action, in size, that networks begin with
ROWS = 1024
"""Rows that a network answers at a time. Their activations fit into a processor's cache."""


@dataclass(frozen=True)
class Network:
    """A feed-forward network of batches (B, I) to (B, K): standardise, linear layers with ReLU between them,
    and an optional tanh. `mean`, `std`: (I,). `weights`: (inputs, outputs) of each layer. `biases`:
    (outputs,). Arrays are float64, row by row, as stored ones are. Products of other layouts round
    differently, so `of` brings any arrays into this one. Raises TypeError for other arrays."""

    mean: Array
    std: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    tanh: bool = False

    def __post_init__(self) -> None:
        for array in (self.mean, self.std, *self.weights, *self.biases):
            if array.dtype != np.float64 or not array.flags.c_contiguous:
                raise TypeError("arrays of a Network are float64, row by row: Network.of takes any others")

    @classmethod
    def of(
        cls, mean: Any, std: Any, weights: Iterable[Any], biases: Iterable[Any], tanh: bool = False
    ) -> Network:
        """Return the network of any arrays of numbers, such as views, float32 or JAX's."""
        mean, std, *layers = (
            np.asarray(array, np.float64, order="C") for array in (mean, std, *weights, *biases)
        )
        count = len(layers) // 2
        return cls(mean, std, tuple(layers[:count]), tuple(layers[count:]), tanh)

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
        """All but weights and biases, which networks of one `MeanNetwork` share."""
        shapes = tuple(weight.shape for weight in self.weights)
        return self.mean.tobytes(), self.std.tobytes(), shapes, self.tanh

    @classmethod
    def from_torch(cls, layers: nn.Module, mean: Array, std: Array, tanh: bool = False) -> Network:
        """Return the network of a stack of Linear and ReLU layers. `tanh`: True if a tanh follows them."""
        linear = [m for m in layers.modules() if isinstance(m, nn.Linear)]
        weights = [m.weight.detach().cpu().double().numpy().T.copy() for m in linear]
        biases = [m.bias.detach().cpu().double().numpy().copy() for m in linear]
        return cls.of(mean, std, weights, biases, tanh)

    @classmethod
    def from_flax(
        cls, layers: Mapping[str, Mapping[str, Any]], mean: Array, std: Array, tanh: bool = False
    ) -> Network:
        """Return the network of the parameters of layers Dense_0, Dense_1, ..., with ReLU between them."""
        dense = [layers[f"Dense_{i}"] for i in range(len(layers))]
        kernels, biases = ([layer[part] for layer in dense] for part in ("kernel", "bias"))
        return cls.of(mean, std, kernels, biases, tanh)

    def scaled(self, factors: Array) -> Network:
        """Return the network with outputs times `factors` (K,), before any tanh."""
        weights = (*self.weights[:-1], self.weights[-1] * factors)
        biases = (*self.biases[:-1], self.biases[-1] * factors)
        return replace(self, weights=weights, biases=biases)

    def arrays(self) -> dict[str, Array]:
        """Return all numbers by name, for storage. `from_arrays` is the inverse."""
        named = {"mean": self.mean, "std": self.std, "tanh": np.array(float(self.tanh))}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named |= {f"weight{i}": weight, f"bias{i}": bias}
        return named

    @classmethod
    def from_arrays(cls, named: Mapping[str, Array]) -> Network:
        """Return the network of these arrays. Raises KeyError where one is missing."""
        layers = range((len(named) - 3) // 2)
        weights, biases = ([named[f"{part}{i}"] for i in layers] for part in ("weight", "bias"))
        return cls.of(named["mean"], named["std"], weights, biases, bool(named["tanh"]))


class _Product(torch.autograd.Function):
    """The product x (N, I) @ weight (K, I)^T + bias (K,), by NumPy. Its BLAS, restricted to instructions that
    all processors have, is faster than torch's."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        y = x.detach().numpy() @ weight.detach().numpy().T
        y += bias.detach().numpy()
        return torch.from_numpy(y)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        x, weight = (saved.detach().numpy() for saved in ctx.saved_tensors)
        g = grad.numpy()
        to_x = torch.from_numpy(g @ weight) if ctx.needs_input_grad[0] else None
        # A product is faster than a sum of many rows.
        to_bias = np.ones(len(g), g.dtype) @ g
        return to_x, torch.from_numpy(g.T @ x), torch.from_numpy(to_bias)


class Linear(nn.Linear):
    """A layer of torch on the CPU, which can be differentiated once."""

    def forward(self, x: Tensor) -> Tensor:
        product: Tensor = _Product.apply(x, self.weight, self.bias)  # type: ignore[no-untyped-call]
        return product


def mlp(*sizes: int, generator: torch.Generator) -> nn.Sequential:
    """Return linear layers with ReLU between them, initialised by torch's rule from the generator."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        linear = Linear(inputs, outputs)
        for parameter in linear.parameters():
            nn.init.uniform_(parameter, -(inputs**-0.5), inputs**-0.5, generator=generator)
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def begin_with(layers: nn.Module, act: Array, spread: Array) -> None:
    """Set the last bias such that tanh(spread * layers(x)) begins near the mean of actions (N, A). An
    optimizer would take long to get there where the spread (A,) is small."""
    *_, bias = layers.parameters()
    outputs = np.arctanh(act.mean(axis=0).clip(-LARGEST_MEAN, LARGEST_MEAN)) / spread
    bias.data += torch.as_tensor(outputs, dtype=bias.dtype)


def standardiser(x: Array) -> tuple[Array, Array]:
    """Return the mean and standard deviation of each column of (N, I), the latter 1 for constant columns."""
    std = x.std(axis=0)
    return x.mean(axis=0), np.where(std > 1e-8, std, 1.0)


class Contrast(NamedTuple):
    """A network's outputs for two batches of rows, (B, 1) each, and its mean squared slope between them."""

    a: Tensor
    b: Tensor
    squared_slope: Tensor


def contrast(
    network: nn.Module, a: Tensor, b: Tensor, generator: torch.Generator, among: Tensor | None = None
) -> Contrast:
    """Return a network's outputs for rows a (B, K) and b (B, K), and its slope between the rows of each pair.

    The slope is the mean |gradient|^2 at random places between them, by differences over `NEAR` in random
    directions. (Gulrajani et al. 2017 penalise its distance from 1.) `among` (B,): pairs that count for it,
    by default all. It is 0 if there are none. One pass of the network computes everything.
    """
    share = torch.rand(len(a), 1, generator=generator)
    middle, step = share * a + (1 - share) * b, NEAR / 2 * torch.randn(a.shape, generator=generator)
    of_a, of_b, before, after = network(torch.cat([a, b, middle - step, middle + step])).chunk(4)
    slopes = ((after - before) / NEAR).square()[:, 0]
    if among is None:
        return Contrast(of_a, of_b, slopes.mean())
    return Contrast(of_a, of_b, (slopes * among).sum() / among.sum().clamp(min=1))


def preference_loss(network: nn.Module, better: Tensor, worse: Tensor) -> Tensor:
    """Return the mean negative log-likelihood that the better of two stretches (B, T, I) is preferred. The
    logit is the difference of their sums of tanh(network) (Bradley & Terry 1952; Brown et al. 2019)."""
    paid = [torch.tanh(network(rows.flatten(0, 1))).view(rows.shape[:2]) for rows in (better, worse)]
    loss: Tensor = softplus((paid[1] - paid[0]).sum(1)).mean()
    return loss


def descend(
    loss: Callable[..., Tensor],
    optimizer: torch.optim.Optimizer,
    data: Sequence[Array],
    steps: int,
    batch: int,
    rng: Rng,
    points: int = 100,
) -> list[float]:
    """Minimise `loss(*minibatch)`, and return the mean loss of each of `points` equal stretches.

    The learning rate falls from the optimizer's to 0 by a half cosine. `data`: arrays of equal length.
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
    """Hyper-parameters of fits to demonstrations by SOAP."""

    learning_rate: Annotated[Positive, Between(1e-3, 0.1)] = 1e-2
    """Learning rate at the start. It falls to 0."""
    batch: Count = 512
    """Rows of each gradient step."""
    steps: Count = 2000
    """Gradient steps."""

    def minimise(
        self,
        loss: Callable[..., Tensor],
        networks: Sequence[nn.Module],
        data: Sequence[Array],
        rng: Rng,
        shares: Sequence[float] | None = None,
    ) -> list[float]:
        """Fit the networks' parameters to `data`, as in `descend`, and return the falling loss. `shares`:
        each network's learning rate, as a share of `learning_rate`."""
        rates = [self.learning_rate * share for share in shares or [1.0] * len(networks)]
        return descend(loss, Soap(networks, rates), data, self.steps, self.batch, rng)
