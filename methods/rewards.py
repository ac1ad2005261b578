"""The forms that rewards take in several places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from methods.base import Array, Episodes, Reward
from methods.network import ROWS, MeanNetwork, Network


@dataclass(frozen=True)
class Constant:
    """Pays `value` while alive."""

    value: float
    absorbing: float

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.full(len(obs), self.value)


@dataclass(frozen=True)
class LinearReward:
    """w^T phi(s, a), of weights w (K + 1,); the last is what the absorbing state pays. phi: the world's."""

    phi: Callable[[Array, Array], Array]
    w: Array

    @property
    def absorbing(self) -> float:
        return float(self.w[-1])

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        starts = range(0, max(1, len(obs)), ROWS)  # features of a million rows are gigabytes
        return np.concatenate([self.phi(obs[i : i + ROWS], act[i : i + ROWS]) @ self.w[:-1] for i in starts])


@dataclass(frozen=True)
class StateReward:
    """A network of the observation alone, for environments without an absorbing state."""

    network: Network
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.network(obs)[:, 0]


@dataclass(frozen=True)
class NetworkReward:
    """`size` times a network of (observation, action, absorbing indicator), or, where it sees no `actions`,
    of (observation, absorbing indicator)."""

    network: Network
    size: float
    absorbing: float
    actions: bool = True

    @classmethod
    def of(
        cls,
        layers: torch.nn.Module,
        mean: Array,
        std: Array,
        *,
        bound: float | None = None,
        actions: bool = True,
    ) -> NetworkReward:
        """From torch layers on standardised observations (`mean`, `std`), actions and the indicator. bound:
        what it is times the layers' tanh; None where it is what they give."""
        linear = [m for m in layers.modules() if isinstance(m, torch.nn.Linear)]
        rest = linear[0].in_features - len(mean)
        shift, scale = np.append(mean, np.zeros(rest)), np.append(std, np.ones(rest))
        network = Network.from_torch(layers, shift, scale, tanh=bound is not None)
        absorbed, size = np.append(mean, np.zeros(rest)), 1.0 if bound is None else bound
        absorbed[-1] = 1
        return cls(network, size, size * float(network(absorbed[None])[0, 0]), actions)

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.size * self.network(self.inputs(obs, act))[:, 0]

    def inputs(self, obs: Array, act: Array) -> Array:
        """Return what the network sees of living steps."""
        seen = [obs, act] if self.actions else [obs]
        return np.concatenate([*seen, np.zeros((len(obs), 1))], axis=1)

    @cached_property
    def compiled(self) -> Reward:
        """A form in float32, which is faster for many rows; a subclass's is itself."""
        return CompiledReward((self,)) if type(self) is NetworkReward else self


def deterred(reward: NetworkReward, demos: Episodes, random: Episodes, most: float) -> NetworkReward:
    """The reward, whose absorption pays at most `most` where demonstrations terminate less often than random
    actions do: an end that nobody shows is worth no more."""
    if np.mean(demos.terminated) >= np.mean(random.terminated):
        return reward
    return replace(reward, absorbing=min(reward.absorbing, most))


def paid(reward: Reward, episodes: Episodes) -> Array:
    """(N,): what a reward that does not see the next observation pays each step that is shown."""
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
        """A form in float32, if all are rewards of networks that differ in numbers alone; else itself."""
        networks = tuple(reward for reward in self.rewards if type(reward) is NetworkReward)
        forms = {(reward.actions, *reward.network.form) for reward in networks}
        stack = type(self) is MeanReward and len(networks) == len(self.rewards) and len(forms) == 1
        return CompiledReward(networks) if stack else self


def fast(reward: Reward) -> Reward:
    """Return the reward in float32 where it is of networks, else itself."""
    return reward.compiled if isinstance(reward, MeanReward | NetworkReward) else reward


@dataclass(frozen=True)
class CompiledReward:
    """The mean of rewards, whose networks differ in numbers alone, in float32."""

    rewards: tuple[NetworkReward, ...]

    @property
    def absorbing(self) -> float:
        return float(np.mean([reward.absorbing for reward in self.rewards]))

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self._network(self.rewards[0].inputs(obs, act))[:, 0]

    @cached_property
    def _network(self) -> MeanNetwork:
        networks, sizes = zip(*((reward.network, reward.size) for reward in self.rewards), strict=True)
        return MeanNetwork(networks, sizes)
