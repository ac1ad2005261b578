"""Scoring a policy in the original environment by its true reward."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.learn.simulator import Simulator, Trajectory
from methods.base import Array, Policy


@dataclass(frozen=True)
class Evaluation:
    """True returns and lengths (N,) of N episodes, how many ended why, and the first one."""

    returns: Array
    discounted: Array
    lengths: Array
    endings: dict[str, int]
    first: Trajectory

    def columns(self) -> dict[str, Any]:
        """The columns of scores.csv that it fills."""
        columns: dict[str, Any] = {"episodes": len(self.returns)}
        measures = {"return": self.returns, "discounted": self.discounted, "length": self.lengths}
        for name, values in measures.items():
            columns |= {f"{name}_mean": float(values.mean()), f"{name}_std": float(values.std())}
        return columns


def evaluate(spec: EnvSpec, policy: Policy, seeds: Sequence[int]) -> Evaluation:
    """Native episodes of the policy, one for each seed."""
    episodes = Simulator(spec).run(policy, seeds)
    return Evaluation(
        returns=np.array([e.rewards.sum() for e in episodes]),
        discounted=np.array([e.rewards @ spec.gamma ** np.arange(len(e.rewards)) for e in episodes]),
        lengths=np.array([float(len(e.act)) for e in episodes]),
        endings=dict(sorted(Counter(e.ending for e in episodes).items())),
        first=episodes[0],
    )
