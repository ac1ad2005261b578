"""A feed-forward network as plain arrays: what a fitted torch network becomes, to be run fast, stored
without pickle and sent between processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Array

torch.set_num_threads(1)


@dataclass(frozen=True)
class Network:
    """x -> standardise -> (linear -> ReLU)* -> linear -> optional tanh, on batches (B, I) to (B, K)."""

    mean: Array
    std: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    tanh: bool = False

    def __call__(self, x: Array, /) -> Array:
        x = (x - self.mean) / self.std
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weight + bias, 0)
        x = x @ self.weights[-1] + self.biases[-1]
        return np.tanh(x) if self.tanh else x

    @classmethod
    def from_torch(cls, layers: torch.nn.Module, mean: Array, std: Array, tanh: bool = False) -> Network:
        """From a stack of Linear and ReLU layers (any Tanh at its end to be named by `tanh`)."""
        linear = [m for m in layers.modules() if isinstance(m, torch.nn.Linear)]
        weights = tuple(m.weight.detach().cpu().double().numpy().T.copy() for m in linear)
        biases = tuple(m.bias.detach().cpu().double().numpy().copy() for m in linear)
        return cls(mean, std, weights, biases, tanh)

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


def mlp(*sizes: int, generator: torch.Generator) -> torch.nn.Sequential:
    """Linear layers with ReLU between them, initialised (He uniform, zero biases) from the generator."""
    layers: list[torch.nn.Module] = []
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        linear = torch.nn.Linear(inputs, outputs)
        torch.nn.init.kaiming_uniform_(linear.weight, nonlinearity="relu", generator=generator)
        torch.nn.init.zeros_(linear.bias)
        layers += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])
