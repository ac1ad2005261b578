"""Forms of rewards that several methods share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from torch import nn

from methods.base import Array, Episodes, Phi, RandomActions, Reward, Rng
from methods.network import ROWS, Network

COMPILED_ROWS = 512  # rows that a compiled mean of networks answers at a time


@dataclass(frozen=True)
class Constant:
    """A reward of `value` for each living step."""

    value: float
    absorbing: float

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.full(len(obs), self.value)


@dataclass(frozen=True)
class LinearReward:
    """The reward w^T phi(s, a) of features `phi`. `absorbing` is the last of the weights w (K + 1,)."""

    phi: Phi
    w: Array

    @property
    def absorbing(self) -> float:
        return float(self.w[-1])

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        starts = range(0, max(1, len(obs)), ROWS)  # a million rows of features are gigabytes
        return np.concatenate([self.phi(obs[i : i + ROWS], act[i : i + ROWS]) @ self.w[:-1] for i in starts])


@dataclass(frozen=True)
class StateReward:
    """A network of observations alone, for tasks without an absorbing state."""

    network: Network
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.network(obs)[:, 0]


@dataclass(frozen=True)
class NetworkReward:
    """A network of (observation, action, absorbing indicator), times `size`. Without `actions` it is one of
    (observation, absorbing indicator), and with `next_obs` the next observation follows the observation."""

    network: Network
    size: float
    absorbing: float
    actions: bool = True
    next_obs: bool = False

    @classmethod
    def of(
        cls,
        layers: nn.Module,
        mean: Array,
        std: Array,
        *,
        bound: float | None = None,
        actions: bool = True,
        next_obs: bool = False,
    ) -> NetworkReward:
        """Return the reward of torch layers on standardised observations (`mean`, `std`), actions and the
        indicator. `bound`: factor of the layers' tanh, None for their output as it is."""
        if next_obs:
            mean, std = np.tile(mean, 2), np.tile(std, 2)
        linear = [m for m in layers.modules() if isinstance(m, nn.Linear)]
        rest = linear[0].in_features - len(mean)
        shift, scale = np.append(mean, np.zeros(rest)), np.append(std, np.ones(rest))
        network = Network.from_torch(layers, shift, scale, tanh=bound is not None)
        absorbed, size = np.append(mean, np.zeros(rest)), 1.0 if bound is None else bound
        absorbed[-1] = 1
        return cls(network, size, size * float(network(absorbed[None])[0, 0]), actions, next_obs)

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.size * self.network(self.inputs(obs, act, next_obs))[:, 0]

    def inputs(self, obs: Array, act: Array, next_obs: Array) -> Array:
        """Return the network's input for living steps."""
        seen = ((obs, True), (next_obs, self.next_obs), (act, self.actions), (np.zeros((len(obs), 1)), True))
        return np.concatenate([column for column, is_seen in seen if is_seen], axis=1)

    @cached_property
    def compiled(self) -> Reward:
        """The reward in float32, which is faster for many rows. A subclass's is itself."""
        return CompiledReward((self,)) if type(self) is NetworkReward else self


def deterred(reward: NetworkReward, demos: Episodes, random: Episodes, most: float) -> NetworkReward:
    """Return the reward. If demonstrations terminate less often than random actions, its `absorbing` becomes
    at most `most`, because no demonstration shows what an end is worth."""
    if np.mean(demos.terminated) >= np.mean(random.terminated):
        return reward
    return replace(reward, absorbing=min(reward.absorbing, most))


def paid(reward: Reward, episodes: Episodes) -> Array:
    """Return the rewards of all steps shown, (N,), by a reward that does not see next observations."""
    obs, act = episodes.pairs()
    return reward(obs, act, obs)


@dataclass(frozen=True)
class MeanReward:
    """The mean of several rewards."""

    rewards: tuple[Reward, ...]

    @property
    def absorbing(self) -> float:
        return float(np.mean([reward.absorbing for reward in self.rewards]))

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.asarray(np.mean([reward(obs, act, next_obs) for reward in self.rewards], axis=0))

    @cached_property
    def compiled(self) -> Reward:
        """The reward in float32 if all parts are networks that differ in numbers alone, else itself."""
        networks = tuple(reward for reward in self.rewards if type(reward) is NetworkReward)
        forms = {(reward.actions, reward.next_obs, *reward.network.form) for reward in networks}
        stack = type(self) is MeanReward and len(networks) == len(self.rewards) and len(forms) == 1
        return CompiledReward(networks) if stack else self


def fast(reward: Reward) -> Reward:
    """Return the reward in float32 if it is of networks, else itself."""
    return reward.compiled if isinstance(reward, MeanReward | NetworkReward) else reward


@dataclass(frozen=True)
class CompiledReward:
    """The mean of rewards whose networks differ in numbers alone, compiled in float32. A few rows are
    answered in float64, which is faster for them."""

    rewards: tuple[NetworkReward, ...]

    @property
    def absorbing(self) -> float:
        return float(np.mean([reward.absorbing for reward in self.rewards]))

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        if 2 * len(obs) < COMPILED_ROWS:
            return np.asarray(np.mean([reward(obs, act, next_obs) for reward in self.rewards], axis=0))
        x, first = self.rewards[0].inputs(obs, act, next_obs), self.rewards[0].network
        padded = np.zeros((-(-len(x) // COMPILED_ROWS), COMPILED_ROWS, x.shape[1]), np.float32)
        padded.reshape(-1, x.shape[1])[: len(x)] = (x - first.mean) / first.std
        parts = [np.asarray(_mean(*self._stacked, rows, first.tanh)) for rows in padded]
        return np.concatenate(parts)[: len(x), 0].astype(np.float64)

    @cached_property
    def _stacked(self) -> Any:
        parts = [(one.network.weights, one.network.biases, one.size) for one in self.rewards]
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


def default_absorbing(reward: Reward, demos: Episodes, random_actions: RandomActions, rng: Rng) -> float:
    """Return `absorbing` for a reward learned from expert pairs only, such that an uninformed agent gains
    from neither staying alive nor dying.

    It is the mean reward of demonstrated states with uniform actions, or of the demonstrated pairs if all
    demonstrations terminate and have actions.
    """
    obs, act = demos.pairs()
    if not (all(demos.terminated) and demos.has_actions):
        act = random_actions(len(act), rng)
    return float(reward(obs, act, obs).mean())
