"""The standing of each method among those on its board."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from harness.judge.comparisons import CONTROLS, Difference, compare
from harness.judge.rows import best_of, is_rival, mean, same_stars

Seeds = Mapping[int, float]
"""Scores by seed."""


@dataclass(frozen=True)
class Standing:
    """A method among others. `best`: the one with the highest mean. `same_policy_as`: as in `Entry`.
    `differences`: to the others, by their names."""

    best: str = ""
    same_policy_as: str = ""
    differences: Mapping[str, Difference] = field(default_factory=dict)

    @property
    def detectable(self) -> float:
        """The smallest difference that the pair with the fewest shared seeds would have shown."""
        fewest = min(self.differences.values(), key=lambda one: one.pairs, default=None)
        return math.nan if fewest is None else fewest.detectable

    def names(self, sign: int) -> str:
        """Return the names of those that it differs from significantly, with a difference of this sign."""
        its = self.differences.items()
        return " ".join(sorted(name for name, one in its if one.is_significant and sign * one.mean > 0))


def standings_of(scores: Mapping[str, Seeds], policy: str) -> dict[tuple[str, str], Standing]:
    """Return the standings of the methods with scores, by method and policy. `scores`: of all on a board.

    They are compared with each other and with controls; methods with one pi_star are compared once.
    """
    rivals = [method for method, its in scores.items() if its and is_rival(method)]
    same = same_stars(rivals) if policy == "pi_star" else {}
    counted = [method for method in rivals if method not in same]
    best = best_of({m: scores[m] for m in sorted(counted, key=lambda m: -mean([*scores[m].values()]))})
    names = counted + [name for name in CONTROLS if name in scores]
    differences = compare({n: {("", seed): x for seed, x in scores[n].items()} for n in names}, CONTROLS)
    standings = {}
    for method in rivals:
        mine = {other: one for (name, other), one in differences.items() if name == method}
        standings[method, policy] = Standing(best, same.get(method, ""), mine)
    return standings
