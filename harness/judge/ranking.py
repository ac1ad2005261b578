"""Whether a reward ranks whole policies as the true one does: Spearman's correlation of their mean returns
under the two, over policies from bad to good."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from envs import EnvSpec
from harness.judge.statistics import rank_correlation
from harness.judge.stretches import Stretches
from harness.learn.simulator import Simulator
from methods.base import Array, Policy, Reward
from methods.stochastic import roughened

POLICIES = 20
"""That a reward must rank."""
ROUGHEST = 0.5
"""Share of random actions in the worst of them that are made from one policy."""


@dataclass(frozen=True)
class Ranked(Stretches):
    """Episodes of policies, as many of each, one after the other. true: (P,), their mean true returns."""

    true: Array

    def ranking(self, reward: Reward | None) -> float:
        """In [-1, 1]; NaN where one of the two says the same of all. None: of the true reward."""
        own = self.true if reward is None else self.returns(reward, 1.0).reshape(len(self.true), -1).mean(1)
        if np.ptp(own) <= 1e-9 * np.abs(own).max() or np.ptp(self.true) == 0:
            return math.nan
        return rank_correlation(own, self.true)


def ranked(
    spec: EnvSpec, policies: Sequence[Policy], seeds: Sequence[int], rng: np.random.Generator
) -> Ranked:
    """Each policy as it is and, so that there are `POLICIES`, with shares of random actions."""
    shares = np.linspace(0, ROUGHEST, POLICIES // len(policies))
    executed = [lambda obs, its=policy: spec.executed(its(obs)) for policy in policies]
    rough = [roughened(policy, share, spec.random_actions, rng) for policy in executed for share in shares]
    episodes = [e for its in Simulator(spec).run_each(rough, seeds) for e in its]
    true = np.array([e.rewards.sum() for e in episodes]).reshape(len(rough), -1).mean(axis=1)
    return Ranked(**vars(Stretches.of(episodes, [0] * len(episodes))), true=true)
