"""Means of many networks, compiled by JAX: rewards that reinforcement learning asks for millions of steps."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from methods.base import Array
from methods.network import Network

COMPILED_ROWS = 512  # rows that a compiled mean of networks answers at a time


@dataclass(frozen=True)
class MeanNetwork:
    """The mean of networks of one `form`, each times its size, (B, I) to (B, K), compiled in float32. A few
    rows are answered in float64, which is faster for them."""

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
