"""Scores over all tasks that distinguish rewards."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from harness.judge.comparisons import Difference, pooled
from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.rows import UNINFORMED, counts, is_rival, same_stars
from harness.judge.statistics import SUCCESS, interquartile_interval, interquartile_mean
from harness.records import REFERENCE, Row
from harness.registry import ASKING, RANKED, base

NO_BETTER = 0.05
"""The gap of scores to the best method's pi_R within which an uninformed control shows that the task cannot
distinguish rewards."""


@dataclass(frozen=True)
class Overall:
    """A method's policy over all envs that distinguish rewards.

    `scores`: by env, of seeds that count. `unsolved`: seeds left out, whose reward RL did not solve.
    `score`, `low`, `high`: the interquartile mean and its interval. `reached`: the share of runs that reach
    `SUCCESS`. `beside`: the difference to the mean of the other methods, None without one. `better_than`,
    `worse_than`: the methods that it differs from significantly. `comparisons`: the number of all such pairs.
    """

    method: str
    policy: str
    scores: Mapping[str, Sequence[float]]
    unsolved: int
    score: float
    low: float
    high: float
    reached: float
    beside: Difference | None
    better_than: Sequence[str]
    worse_than: Sequence[str]
    comparisons: int

    @property
    def runs(self) -> int:
        """The number of scores."""
        return sum(map(len, self.scores.values()))


def indistinct(entries: Sequence[Entry]) -> dict[str, str]:
    """Return the envs that cannot distinguish rewards, with the reason: their best uninformed control scores
    about as much as the best method's pi_R, or more. `entries`: of one board an env."""
    boards: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry.policy == "pi_R" and math.isfinite(entry.score_mean):
            boards.setdefault(entry.env, []).append(entry)
    reasons = {}
    for env, mine in boards.items():
        best = max((e.score_mean for e in mine if e.role == "method"), default=math.nan)
        ties = [e for e in mine if e.role in UNINFORMED and e.score_mean >= best - NO_BETTER]
        if ties:
            top = max(ties, key=lambda e: e.score_mean)
            scores = as_text(top.score_mean, ".2f"), as_text(best, ".2f")
            reasons[env] = f"{top.method} scores {scores[0]} there, the best method {scores[1]}"
    return reasons


def overall(rows: Sequence[Row], without: Sequence[str] = ()) -> list[Overall]:
    """Return every policy over all envs but `without`, the best first; nothing for fewer than two envs.

    Policies without a score in some env are left out, because it could be a hard one. Methods that know
    more than others and second names of one pi_star are left out, too. Methods are compared over all envs.
    """
    left_out = (REFERENCE, *ASKING, *RANKED)
    mine = [row for row in rows if base(row.method) not in left_out and row.env not in without]
    envs = sorted({row.env for row in rows} - {*without})
    if len(envs) < 2:
        return []
    lines = []
    for policy in ("pi_star", "pi_R"):
        scores: dict[str, dict[tuple[str, int], float]] = {}
        for row in mine:
            if row.policy == policy and counts(row):
                scores.setdefault(row.method, {})[row.env, row.seed] = row.normalized_score
        same = same_stars([*filter(is_rival, scores)]) if policy == "pi_star" else {}
        whole = {
            m: its for m, its in scores.items() if m not in same and len({e for e, _ in its}) == len(envs)
        }
        rivals = {m: its for m, its in whole.items() if is_rival(m)}
        beside, differences = pooled(rivals)
        significant = {pair: one.mean for pair, one in differences.items() if one.is_significant}
        for method, its in whole.items():
            by_env = {env: [x for (name, _), x in its.items() if name == env] for env in envs}
            low, high = interquartile_interval([*by_env.values()])
            lines.append(
                Overall(
                    method=method,
                    policy=policy,
                    scores=by_env,
                    unsolved=sum(
                        row.solved == 0 for row in mine if (row.method, row.policy) == (method, policy)
                    ),
                    score=interquartile_mean([*its.values()]),
                    low=low,
                    high=high,
                    reached=sum(x >= SUCCESS for x in its.values()) / len(its),
                    beside=beside.get(method),
                    better_than=[b for (a, b), gap in significant.items() if a == method and gap > 0],
                    worse_than=[b for (a, b), gap in significant.items() if a == method and gap < 0],
                    comparisons=len(differences) // 2,
                )
            )
    return sorted(lines, key=lambda line: (-line.score, line.method, line.policy))
