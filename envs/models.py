"""Models of finite environments: the dynamics that methods may know, and the whole task."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROUNDING = 1e-9  # largest distance from 1 of a sum of probabilities


@dataclass(frozen=True)
class Model:
    """The dynamics of a Markov decision process without terminal states, which a method may know.

    Arrays are read-only. Raises ValueError where shapes disagree, probabilities do not sum to 1, or
    observations repeat or are not exact in 32 bits, as environments return them.
    """

    P: Array
    """Probability of each next state, given state and action, (S, A, S)."""
    start: Array
    """Distribution of the first state, (S,)."""
    obs: Array
    """Observation of each state, (S, O)."""

    def __post_init__(self) -> None:
        states = len(self.start)
        if self.P.ndim != 3 or self.P.shape[::2] != (states, states) or self.P.size == 0:
            raise ValueError(f"tabular: P must be (S, A, S) with S = {states}, not {self.P.shape}")
        for name, rows in (("P", self.P), ("start", self.start)):
            if not (rows.min() >= 0 and np.abs(rows.sum(axis=-1) - 1).max() <= ROUNDING):
                raise ValueError(f"tabular: {name} must hold probabilities that sum to 1")
        if self.obs.ndim != 2 or len(self.obs) != states or self.obs.size == 0:
            raise ValueError(f"tabular: obs must be (S, O) with S = {states}, not {self.obs.shape}")
        if len(np.unique(self.obs, axis=0)) < states or not np.array_equal(
            self.obs, self.obs.astype(np.float32)
        ):
            raise ValueError("tabular: obs must be different in each state, and 32-bit floats")
        for array in vars(self).values():
            array.flags.writeable = False

    def states(self, obs: Array) -> NDArray[np.int64]:
        """Return the states with the nearest observations to (B, O), (B,)."""
        return np.asarray(self._tree.query(obs)[1], np.int64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree  # takes half a second, which the command line does not need

        return KDTree(self.obs)


@dataclass(frozen=True)
class Tabular(Model):
    """A model with its true reward and features for linear rewards. Raises ValueError as `Model` does."""

    reward: Array
    """Reward of an action in each state, (S,)."""
    features: Array
    """Features of each state in [-1, 1], (S, K)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        states = len(self.start)
        if self.reward.shape != (states,) or not np.isfinite(self.reward).all():
            raise ValueError(f"tabular: reward must be finite and (S,) with S = {states}")
        if self.features.ndim != 2 or len(self.features) != states or self.features.size == 0:
            raise ValueError(f"tabular: features must be (S, K) with S = {states}, not {self.features.shape}")
        if not np.abs(self.features).max() <= 1:
            raise ValueError("tabular: features must lie in [-1, 1]")

    @property
    def model(self) -> Model:
        """The model without its reward."""
        return Model(self.P, self.start, self.obs)
