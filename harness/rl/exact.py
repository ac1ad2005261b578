"""Solutions of environments whose model is known, by value iteration."""

from __future__ import annotations

import numpy as np

from envs.models import Model, Tabular
from harness.rl.solving import Solution
from methods.base import Array, Payment, Policy, Reward, StochasticPolicy, Transitions
from methods.tabular.model import TabularPolicy, value_iteration

TIE = 1e-7
"""Values that differ by less, relative to the largest, are equal."""


class ExactSolver:
    """An agent that solves one finite environment without environment steps."""

    env_steps = 0

    def __init__(self, tabular: Tabular, gamma: float, rng: np.random.Generator) -> None:
        self.tabular, self.gamma, self.rng = tabular, gamma, rng
        self._reward: Reward | None = None
        self._has_learned = False

    def whole(self, steps: int) -> int:
        """Return `steps`, which do not matter."""
        return steps

    def learn(self, steps: int, reward: Reward | Payment | None) -> None:
        """Remember the reward. Raises ValueError for a `Payment`."""
        if reward is not None and not isinstance(reward, Reward):
            raise ValueError("where the model is known, an agent learns under rewards alone")
        self._reward, self._has_learned = reward, True

    def best(self, reward: Reward | None) -> Solution:
        """Return an optimal policy under the reward; None is the true one. Chance decides between equal
        actions, because a reward that does not distinguish them teaches nothing.

        Raises ValueError on rewards that are not finite.
        """
        tabular = self.tabular
        r = tabular.reward if reward is None else expected_rewards(tabular, reward)
        q = value_iteration(tabular.P, r, self.gamma)[1]
        best = q >= q.max(axis=1, keepdims=True) - TIE * np.abs(q).max()
        choice = np.where(best, self.rng.random(q.shape), -1).argmax(axis=1)
        return Solution(TabularPolicy(tabular.obs, np.eye(q.shape[1])[choice]), curve=[], true_curve=[])

    def solve(self, reward: Reward | None, steps: int) -> Solution:
        """Do as `learn` and `best`."""
        self.learn(steps, reward)
        return self.best(reward)

    @property
    def policy(self) -> Policy:
        """An optimal policy under the reward of the last `learn`. Raises ValueError before the first one,
        because without a reward it would be the expert's."""
        if not self._has_learned:
            raise ValueError("an agent that has not learned yet has no policy")
        return self.best(self._reward).policy

    @property
    def behaviour(self) -> StochasticPolicy:
        """Nothing. Raises ValueError."""
        raise ValueError("where the model is known, nothing is explored")

    def replay(self) -> Transitions:
        """Raise ValueError."""
        raise ValueError("where the model is known, nothing is seen")


def expected_rewards(model: Model, reward: Reward) -> Array:
    """Return the reward of each state and action, averaged over next states, (S, A)."""
    s, a, after = model.P.nonzero()
    r = np.zeros(model.P.shape)
    r[s, a, after] = reward(model.obs[s], np.eye(model.P.shape[1])[a], model.obs[after])
    return np.asarray((model.P * r).sum(axis=2))
