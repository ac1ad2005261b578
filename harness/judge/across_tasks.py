"""Scores over all tasks that distinguish rewards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.rows import UNINFORMED
from harness.judge.statistics import interquartile_interval, interquartile_mean
from harness.records import REFERENCE, Row
from harness.registry import ASKING

NO_BETTER = 0.05
"""The gap of scores to the best method's pi_R within which an uninformed control shows that the task cannot
distinguish rewards."""
GOOD = 0.95
"""The score below which runs are counted."""


@dataclass(frozen=True)
class Overall:
    """A method's policy over all envs that distinguish rewards: the interquartile mean of its scores with its
    95 % interval, and the share of runs that score less than `GOOD`."""

    method: str
    policy: str
    envs: int
    runs: int
    score: float
    low: float
    high: float
    below: float


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

    Policies without a score in some env are left out, because it could be a hard one, and so are methods that
    ask the expert.
    """
    scores: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in rows:
        counts = row.method not in (REFERENCE, *ASKING) and row.env not in without
        if counts and math.isfinite(row.normalized_score):
            by_env = scores.setdefault((row.method, row.policy), {})
            by_env.setdefault(row.env, []).append(row.normalized_score)
    envs = {row.env for row in rows} - {*without}
    lines = []
    for (method, policy), by_env in scores.items():
        if by_env.keys() == envs and len(envs) > 1:
            pooled = [score for runs in by_env.values() for score in runs]
            low, high = interquartile_interval(list(by_env.values()))
            below = sum(score < GOOD for score in pooled) / len(pooled)
            middle = interquartile_mean(pooled)
            lines.append(Overall(method, policy, len(envs), len(pooled), middle, low, high, below))
    return sorted(lines, key=lambda line: (-line.score, line.method, line.policy))
