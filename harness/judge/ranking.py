"""Spearman's correlation of policies' mean returns under a reward and the true one, over policies from bad to
good: does the reward rank whole policies as the true one does?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from envs import EnvSpec
from harness.judge.statistics import rank_correlation
from harness.judge.stretches import Stretches
from harness.rl.simulator import Simulator
from methods.base import Array, Policy, Reward
from methods.stochastic import roughened

POLICIES = 20
"""Number of policies that a reward must rank."""
ROUGHEST = 0.5
"""Share of random actions in the worst variant of a policy."""


@dataclass(frozen=True)
class Ranked(Stretches):
    """Episodes of P policies one after the other, equally many of each. `true`: mean true returns, (P,)."""

    true: Array

    def ranking(self, reward: Reward | None) -> float:
        """Return the correlation, in [-1, 1]; NaN where all returns under one of the two are equal. None is
        the true reward."""
        own = self.true if reward is None else self.returns(reward, 1.0).reshape(len(self.true), -1).mean(1)
        if np.ptp(own) <= 1e-9 * np.abs(own).max() or np.ptp(self.true) == 0:
            return math.nan
        return rank_correlation(own, self.true)


def ranked(
    spec: EnvSpec, policies: Sequence[Policy], seeds: Sequence[int], rng: np.random.Generator
) -> Ranked:
    """Return episodes of `POLICIES` policies: the given ones with shares of random actions, from 0 on."""
    shares = np.linspace(0, ROUGHEST, POLICIES // len(policies))
    executed = [lambda obs, policy=policy: spec.executed(policy(obs)) for policy in policies]
    rough = [roughened(policy, share, spec.random_actions, rng) for policy in executed for share in shares]
    episodes = [episode for group in Simulator(spec).run_each(rough, seeds) for episode in group]
    true = np.array([e.rewards.sum() for e in episodes]).reshape(len(rough), -1).mean(axis=1)
    return Ranked(**vars(Stretches.of(episodes, [0] * len(episodes))), true=true)
