"""SOAP (Vyas et al. 2024): Adam in the axes along which a layer's gradients vary.

Deviates from the paper: a layer's bias is one more column of its weights. Axes and moments have one decay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from methods.base import Array

DECAY = 0.95  # decay of the running means in each step
EVERY = 10  # steps between updates of the axes
TINY = 1e-8  # term added to the root of the second moment


@dataclass
class Moments:
    """Running means of one layer's gradients (K, I + 1), and the axes along which they vary: (K, K) on the
    left and (I + 1, I + 1) on the right."""

    first: Array
    second: Array
    sides: tuple[Array, Array]
    axes: tuple[Array, Array]
    count: int = 0

    @classmethod
    def of(cls, gradient: Array) -> Moments:
        """Return moments before the first step, with the axes of this gradient."""
        sides = squares(gradient)
        left, right = (np.linalg.eigh(side)[1] for side in sides)
        return cls(np.zeros_like(gradient), np.zeros_like(gradient), sides, (left, right))

    def step(self, gradient: Array) -> Array:
        """Add a gradient (K, I + 1), and return the step's direction, (K, I + 1)."""
        left, right = self.axes
        self.count += 1
        self.first += (1 - DECAY) * (gradient - self.first)
        self.second += (1 - DECAY) * (np.square(left.T @ gradient @ right) - self.second)
        started = 1 - DECAY**self.count
        along = (left.T @ self.first @ right) / started
        along /= np.sqrt(self.second / started) + TINY
        for mean, square in zip(self.sides, squares(gradient), strict=True):
            np.add(mean, (1 - DECAY) * (square - mean), out=mean)
        if self.count % EVERY == 0:
            products = [side @ axes for side, axes in zip(self.sides, self.axes, strict=True)]
            self.axes = np.linalg.qr(products[0])[0], np.linalg.qr(products[1])[0]
        return np.asarray(left @ along @ right.T)


def squares(gradient: Array) -> tuple[Array, Array]:
    """Return the products of a gradient (K, I) with itself from the left and right, (K, K) and (I, I)."""
    return gradient @ gradient.T, gradient.T @ gradient


class Soap(torch.optim.Optimizer):
    """SOAP for networks of linear layers alone. The first step moves nothing, as in the paper, because its
    gradient gives the axes."""

    def __init__(self, networks: Sequence[torch.nn.Module], rates: Sequence[float]) -> None:
        """Set up networks and rates. A step moves weights about as far as the rate along each axis."""
        groups = [
            {"params": [layer.weight, layer.bias], "lr": rate}
            for network, rate in zip(networks, rates, strict=True)
            for layer in network.modules()
            if isinstance(layer, torch.nn.Linear)
        ]
        super().__init__(groups, {})
        self._moments: dict[int, Moments] = {}

    def step(self) -> None:  # type: ignore[override]
        """Move all weights once, by their gradients."""
        for number, group in enumerate(self.param_groups):
            weight, bias = (p.detach().numpy() for p in group["params"])
            slopes, slope = (p.grad.numpy() for p in group["params"])
            gradient = np.concatenate([slopes, slope[:, None]], axis=1)
            if number not in self._moments:
                self._moments[number] = Moments.of(gradient)
                continue
            change = np.float32(group["lr"]) * self._moments[number].step(gradient)
            weight -= change[:, :-1]
            bias -= change[:, -1]
