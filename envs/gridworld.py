"""The tabular family: grid worlds whose model is known exactly, after Ng & Russell 2000 (`grid`) and
Levine, Popovic & Koltun 2011, "Nonlinear Inverse Reinforcement Learning with Gaussian Processes"
(`objectworld`).

Cell (x, y), x to the right and y up, is state y * size + x. A state pays its reward when an action is
taken in it, whatever the action, so a return over T steps counts the states at times 0 to T-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.spec import Array

ACTIONS = ("right", "up", "left", "down", "stay")
MOVES = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0, 0]])  # cells, in the order of ACTIONS
ROUNDING = 1e-9  # how far from 1 probabilities may sum


@dataclass(frozen=True)
class Tabular:
    """A Markov decision process without terminal states, and the features a learner sees. Its arrays are
    read-only. Raises ValueError where shapes disagree, a distribution is none or a feature leaves [-1, 1].
    """

    P: Array
    """(S, A, S): probability of each next state, given state and action."""
    reward: Array
    """(S,): the true reward."""
    start: Array
    """(S,): distribution of the first state."""
    features: Array
    """(S, K), within [-1, 1]."""

    def __post_init__(self) -> None:
        states = len(self.reward)
        if self.P.ndim != 3 or self.P.shape[::2] != (states, states) or self.P.size == 0:
            raise ValueError(f"tabular: P must be (S, A, S) with S = {states}, not {self.P.shape}")
        if self.reward.shape != (states,) or self.start.shape != (states,):
            raise ValueError(
                f"tabular: reward and start must be (S,), not {self.reward.shape}, {self.start.shape}"
            )
        if self.features.ndim != 2 or len(self.features) != states or self.features.size == 0:
            raise ValueError(f"tabular: features must be (S, K) with S = {states}, not {self.features.shape}")
        for name, rows in (("P", self.P), ("start", self.start)):
            if not (rows.min() >= 0 and np.abs(rows.sum(axis=-1) - 1).max() <= ROUNDING):
                raise ValueError(f"tabular: {name} must hold probabilities that sum to 1")
        if not np.isfinite(self.reward).all():
            raise ValueError("tabular: reward must be finite")
        if not np.abs(self.features).max() <= 1:
            raise ValueError("tabular: features must lie in [-1, 1]")
        for array in (self.P, self.reward, self.start, self.features):
            array.flags.writeable = False


@dataclass(frozen=True)
class ObjectWorld(Tabular):
    """A `Tabular` that remembers its objects, M of them."""

    cells: NDArray[np.int64]
    """(M,): the state that each lies in."""
    inner: NDArray[np.int64]
    """(M,): its inner colour."""
    outer: NDArray[np.int64]
    """(M,): its outer colour."""


def grid(size: int, slip: float) -> Tabular:
    """Reward 1 in the top right corner and 0 elsewhere; starts anywhere; the features are one indicator a
    state. Ng & Russell's grid is size 5, without `stay`, and slips with probability 0.3."""
    model = transitions(size, slip)
    states = len(model)
    reward = np.zeros(states)
    reward[-1] = 1
    return Tabular(model, reward, np.full(states, 1 / states), np.eye(states))


def objectworld(
    size: int, objects: int, colours: int, slip: float, rng: np.random.Generator, continuous: bool
) -> ObjectWorld:
    """Objects in distinct random cells, each of a random inner and a random outer colour; starts anywhere.

    Reward: 1 nearer than 3 cells to outer colour 0 and nearer than 2 to outer colour 1, -1 nearer than 3 to
    outer colour 0 only, else 0; other colours distract. Distances are Euclidean, to the nearest such object,
    and the grid's diagonal where there is none. The paper says "within"; strictly nearer is how its
    authors' code reads it, and makes the reward a function of the discrete features.

    continuous: (S, 2C) distances to the inner, then the outer colours, scaled to [-1, 1]; otherwise
    (S, 2CN) indicators of each distance being less than 1, ..., N cells.

    The paper has N = 32 and 30 % chance of a *different* random action, which is slip = 0.375 here; its
    authors' code puts an object in a cell with probability 0.05. Raises ValueError for fewer than two
    colours, or objects that are none or do not fit.
    """
    if colours < 2 or not 1 <= objects <= size**2:
        raise ValueError(
            f"objectworld: needs 2 colours or more and 1 to {size**2} objects, not {colours}, {objects}"
        )
    model = transitions(size, slip)
    states = len(model)
    cells = rng.choice(states, objects, replace=False)
    inner, outer = rng.integers(colours, size=(2, objects))
    diagonal = size * np.sqrt(2)
    to_objects = np.linalg.norm(positions(size)[:, None] - positions(size)[cells], axis=2)
    nearest = np.stack(
        [
            np.where(kind == colour, to_objects, diagonal).min(axis=1)
            for kind in (inner, outer)
            for colour in range(colours)
        ],
        axis=1,
    )
    near_0, near_1 = nearest[:, colours] < 3, nearest[:, colours + 1] < 2
    reward = np.where(near_0, np.where(near_1, 1.0, -1.0), 0.0)
    if continuous:
        features = 2 * nearest / diagonal - 1
    else:
        features = (nearest[:, :, None] < np.arange(1, size + 1)).reshape(states, -1).astype(np.float64)
    return ObjectWorld(model, reward, np.full(states, 1 / states), features, cells, inner, outer)


def positions(size: int) -> NDArray[np.int64]:
    """(S, 2): x and y of each state [cells]."""
    y, x = np.divmod(np.arange(size**2), size)
    return np.stack([x, y], axis=1)


def transitions(size: int, slip: float) -> Array:
    """(S, A, S): each of `ACTIONS` does what it says, or with probability `slip` what one of all five, drawn
    uniformly, says; moves into a wall stay. Raises ValueError for a size below 2 or a slip outside [0, 1]."""
    if size < 2 or not 0 <= slip <= 1:
        raise ValueError(f"grid: needs a size of 2 or more and a slip in [0, 1], not {size}, {slip}")
    x, y = np.moveaxis(np.clip(positions(size)[:, None] + MOVES, 0, size - 1), 2, 0)
    sure = np.zeros((size**2, len(ACTIONS), size**2))
    np.put_along_axis(sure, (y * size + x)[:, :, None], 1, axis=2)
    model: Array = (1 - slip) * sure + slip * sure.mean(axis=1, keepdims=True)
    return model


class GridWorld(gym.Env[NDArray[np.float32], np.int64]):
    """A `Tabular` to act in. Observation (K,): the features of the state, which `state` and `info["state"]`
    tell too. Never terminates. Reward: that of the state in which the action was taken."""

    def __init__(self, tabular: Tabular) -> None:
        self.tabular = tabular
        self.action_space = spaces.Discrete(tabular.P.shape[1])
        self.observation_space = spaces.Box(-1.0, 1.0, (tabular.features.shape[1],), np.float32)
        self.state = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        return self._arrive(self.tabular.start)

    def step(self, action: np.int64) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        reward = float(self.tabular.reward[self.state])
        obs, info = self._arrive(self.tabular.P[self.state, action])
        return obs, reward, False, False, info

    def _arrive(self, distribution: Array) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """In a state drawn from (S,) probabilities."""
        self.state = int(self.np_random.choice(len(distribution), p=distribution))
        return self.tabular.features[self.state].astype(np.float32), {"state": self.state}
