"""Scores of a policy in the original environment under its true reward, and the verdict on RL."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.registry.bounds import usable
from harness.rl.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward

SOLVED = 0.95
"""Share of pi_star's gain over the random policy that RL must reach."""
ROUNDING = 1e-9
"""The largest relative difference of sums that are equal up to rounding."""


@dataclass(frozen=True)
class Evaluation:
    """N episodes, their true returns and lengths, (N,), and the number of endings by their reason.

    `own`: returns under another reward above absorption, (N,), if there is one.
    """

    returns: Array
    discounted: Array
    lengths: Array
    endings: dict[str, int]
    episodes: Sequence[Trajectory]
    own: Array | None = None

    def columns(self) -> dict[str, Any]:
        """Return its columns of scores.csv."""
        columns: dict[str, Any] = {"episodes": len(self.returns)}
        measures = {"return": self.returns, "discounted": self.discounted, "length": self.lengths}
        for name, values in measures.items():
            columns |= {f"{name}_mean": float(values.mean()), f"{name}_std": float(values.std())}
        if math.isfinite(self.own_return):
            columns["own_return"] = self.own_return
        return columns

    @property
    def own_return(self) -> float:
        """The mean return under the other reward; NaN without one, or where it is not finite."""
        return math.nan if self.own is None or not np.isfinite(self.own).all() else float(self.own.mean())


def evaluate(spec: EnvSpec, policy: Policy, seeds: Sequence[int], reward: Reward | None = None) -> Evaluation:
    """Return the scores of the policy in native episodes, one for each seed. `reward`: another reward."""
    episodes = Simulator(spec).run(policy, seeds)
    return Evaluation(
        returns=np.array([e.rewards.sum() for e in episodes]),
        discounted=np.array([e.rewards @ spec.gamma ** np.arange(len(e.rewards)) for e in episodes]),
        lengths=np.array([float(len(e.act)) for e in episodes]),
        endings=dict(sorted(Counter(e.ending for e in episodes).items())),
        episodes=episodes,
        own=None if reward is None else totals(reward, [(e.obs, e.act) for e in episodes]),
    )


def totals(reward: Reward, episodes: Sequence[tuple[Array, Array]]) -> Array:
    """Return the reward's pay above absorption, (E,), for each of E episodes: obs (T+1, O) and act (T, A).
    The reward receives copies, and may write into them."""
    obs, act = zip(*episodes, strict=True)
    before, after = (np.concatenate([one[side] for one in obs]) for side in (slice(-1), slice(1, None)))
    paid = reward(before, np.concatenate(act), after) - reward.absorbing
    starts = np.cumsum([0, *map(len, act[:-1])])
    return np.asarray(np.add.reduceat(paid, starts))


def is_solved(own: float, star: float, random: float) -> float:
    """Return 1 where RL solved R*, 0 where it did not, and NaN where one of the returns is not known.

    `own`, `star`, `random`: mean returns under R* of RL's policy, of pi_star, and of the random policy. Where
    pi_star earns no more than the random policy, RL must earn as much as the random policy.
    """
    if not all(map(usable, (own, star, random))):
        return math.nan
    least = random + SOLVED * max(0.0, star - random)
    return float(own >= least or math.isclose(own, least, rel_tol=ROUNDING, abs_tol=ROUNDING))
