"""Parts of episodes, which several rewards pay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from harness.rl.simulator import Trajectory
from methods.base import Array, Reward
from methods.rewards import fast


@dataclass(frozen=True)
class Stretches:
    """N parts of episodes, one after the other, in 32 bits.

    `obs`: observations before each of the M steps and at each part's end, (M + N, O). `act`: (M, A).
    `lengths`: steps of each, (N,). `terminated`: whether the episode terminated at its end, (N,).
    """

    obs: NDArray[np.float32]
    act: NDArray[np.float32]
    lengths: NDArray[np.int64]
    terminated: NDArray[np.bool_]

    @classmethod
    def of(cls, episodes: Sequence[Trajectory], starts: Sequence[int]) -> Self:
        """Return each episode from its start step on."""
        both = list(zip(episodes, starts, strict=True))
        return cls(
            np.concatenate([e.obs[t:] for e, t in both]).astype(np.float32),
            np.concatenate([e.act[t:] for e, t in both]).astype(np.float32),
            np.array([len(e.act) - t for e, t in both]),
            np.array([e.terminated for e, _ in both]),
        )

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return its arrays by name, for storage."""
        return dict(vars(self))

    def returns(self, reward: Reward, gamma: float) -> Array:
        """Return the discounted pay of each, (N,), above absorption. After a termination it is 0."""
        before, after = np.ones((2, len(self.obs)), bool)
        before[self._ends] = after[self._ends - self.lengths] = False
        obs, act = self.obs.astype(np.float64), self.act.astype(np.float64)
        paid = fast(reward)(obs[before], act, obs[after]) - reward.absorbing
        first = np.cumsum(self.lengths) - self.lengths
        age = np.arange(len(act)) - np.repeat(first, self.lengths)
        return np.asarray(np.add.reduceat(paid * gamma**age, first))

    @property
    def last(self) -> Array:
        """The observation at each end, (N, O)."""
        return self.obs[self._ends].astype(np.float64)

    @property
    def _ends(self) -> NDArray[np.int64]:
        return np.asarray(np.cumsum(self.lengths + 1) - 1)
