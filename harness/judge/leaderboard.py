"""The leaderboard of a run's rows: normalized scores, and their means over seeds."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from harness.judge.rows import (
    LOWER,
    Scales,
    behind,
    best_of,
    by_shown,
    is_rival,
    mean,
    role_of,
    scales_of,
    scores_of,
    standard_error,
)
from harness.judge.statistics import mean_interval, normal_interval
from harness.records import CONTROLS, NOMINAL, REFERENCE, Cell, CellResult, Row, Shown
from harness.registry import Demonstrator
from harness.registry.bounds import usable

_POLICIES = ("expert", "demonstrations", "random", "pi_star", "pi_R")
NEGLIGIBLE = 0.005
"""The largest difference of scores that counts as equal."""
UNSCORED = ("not scored", "what would score 1 is missing, or no better than a random policy")
MEANS = (
    *("reward_distance", "reward_floor", "reward_rank", "policy_ranking", "own_return", "own_return_shown"),
    *("solved", "return_mean", "discounted_mean", "fit_seconds", "env_steps", "check_steps", "rl_solves"),
)
"""Fields of entries that are means over ok seeds of the rows' fields of the same names."""


@dataclass(frozen=True)
class Entry:
    """One line of the leaderboard: a method's policy in a task with its demonstrations, over its ok seeds.

    Scores are normalized. The random policy scores 0. The expert scores 1, or the demonstrations in a run
    without experts. In a variant, RL on the true reward scores 1. Fields named low and high bound a mean's 95
    % interval. Costs are means over seeds. Unknown numbers are NaN.
    """

    env: str
    dynamics: str
    demos: int
    every: int
    demonstrator: Demonstrator
    """As in `Row`. The last three also stand in lines of methods without demonstrations."""
    method: str
    role: str
    policy: str
    protocol: str
    status: str
    """'ok' where every seed is, or else 'failed' where one is, or else 'skipped'."""
    seeds: int
    seeds_ok: int
    score_mean: float
    score_low: float
    score_high: float
    varies: str
    """The source of intervals: 'seeds', or 'episodes' for a single seed, whose luck is left out."""
    best: bool
    """True for the method that others' policies of the same name are compared with (`best_of`)."""
    behind_mean: float
    """Methods: the gap to the best method's policy of the same name, paired by seed."""
    behind_low: float
    behind_high: float
    tied: bool
    """True where that interval reaches down to a negligible gap: it is not significantly worse."""
    above_best_lower_control: float
    """pi_R rows: mean score minus the best mean score of lower controls, over the seeds that all have."""
    share_of_true: float
    """pi_R rows: mean score divided by that of one RL solve of the true reward, over the seeds that both
    have."""
    reward_distance: float
    reward_floor: float
    reward_rank: float
    policy_ranking: float
    own_return: float
    own_return_shown: float
    solved: float
    """Share of the seeds whose reward RL solved (`is_solved`), in pi_R rows of methods."""
    return_mean: float
    return_low: float
    return_high: float
    discounted_mean: float
    fit_seconds: float
    env_steps: float
    check_steps: float
    rl_solves: float
    note: str
    """The baseline it comes from, if any, and the seeds that were skipped, failed or not scored, and why."""

    @property
    def unsolved(self) -> bool:
        """True where RL failed to solve R* on some seed: the score there says nothing about R*."""
        return self.solved < 1

    @property
    def incomparable(self) -> bool:
        """True for a method with a score that shares no seed with the best one."""
        scored = is_rival(self.method) and math.isfinite(self.score_mean)
        return scored and not self.best and not math.isfinite(self.behind_mean)

    @property
    def task(self) -> str:
        """As in `Cell`."""
        return Cell(self.env, self.method, 0, dynamics=self.dynamics).task

    @property
    def shown(self) -> Shown:
        """As in `Cell`."""
        return Shown(self.demos, self.every, self.demonstrator)

    @property
    def board(self) -> str:
        """The task and its demonstrations, within which lines can be compared."""
        shown = str(self.shown)
        return f"{self.task}, {shown}" if shown else self.task


def scored_rows(results: Sequence[CellResult]) -> list[Row]:
    """Return all rows with normalized scores, by task, method (reference first, controls last), seed, policy.

    In a run without experts, the demonstrations' row replaces the expert's. The score is NaN where the
    policies that score 0 and 1 in that task and seed are not both known, or the second is not better than the
    first.
    """
    rows = []
    for result in results:
        settings = json.dumps(result.settings, separators=(",", ":")) if result.settings else ""
        rows += [dataclasses.replace(row, settings=settings) for row in result.rows]
    scales = scales_of(rows)

    def scored(row: Row) -> Row:
        if row.policy == "expert" and row.expert.startswith("file:"):
            row = dataclasses.replace(row, policy="demonstrations")
        low, scale = scales.get((row.task, row.seed), (math.nan, math.nan))
        score = (row.return_mean - low) / scale if row.status == "ok" else math.nan
        return dataclasses.replace(row, normalized_score=score if usable(score) else math.nan)

    return sorted(map(scored, rows), key=_order)


def _order(row: Row) -> tuple[Any, ...]:
    rank = 0 if row.method == REFERENCE else 2 + CONTROLS.index(row.method) if row.method in CONTROLS else 1
    nominal_first = row.env, row.dynamics != NOMINAL, row.dynamics
    return *nominal_first, rank, row.method, row.shown, row.seed, _POLICIES.index(row.policy), row.protocol


def leaderboard(rows: Sequence[Row]) -> list[Entry]:
    """Return the lines of every board from rows with scores.

    Methods stand from the best to the worst pi_R, those without a reward after them by their pi_star, then
    controls, then the reference. Methods without demonstrations are on every board of their task.
    """
    tasks: dict[tuple[str, bool, str, str], list[Row]] = {}
    for row in rows:
        tasks.setdefault((row.env, row.dynamics != NOMINAL, row.dynamics, row.protocol), []).append(row)
    scales = scales_of(rows)
    return [
        entry
        for _, of_task in sorted(tasks.items())
        for shown, mine in by_shown(of_task, lambda row: row).items()
        for entry in _board(mine, shown, scales)
    ]


def _board(rows: Sequence[Row], shown: Shown, scales: Scales) -> list[Entry]:
    """Return the lines of one board."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.method, row.policy), []).append(row)
    score = {key: mean([row.normalized_score for row in group]) for key, group in groups.items()}
    seeds = {key: scores_of(group) for key, group in groups.items()}
    lower = [(name, "pi_R") for name in CONTROLS if role_of(name, rows[0].protocol) == LOWER]

    def common(*keys: tuple[str, str]) -> list[float]:
        """Return the mean score of each over the seeds that all have."""
        known = [seeds.get(key, {}) for key in keys]
        shared = set(known[0]).intersection(*known[1:])
        return [mean([one[seed] for seed in shared]) for one in known]

    best = {}  # rows of the best method, by policy
    for policy in _POLICIES:
        rivals = [key for key in sorted(groups) if key[1] == policy and is_rival(key[0])]
        scored = [key for key in rivals if math.isfinite(score[key])]
        best[policy] = best_of([groups[key] for key in sorted(scored, key=lambda key: -score[key])])

    def place(key: tuple[str, str]) -> tuple[Any, ...]:
        method, policy = key
        section = 2 if method == REFERENCE else 1 if method in CONTROLS else 0
        scores = [score.get((method, p), math.nan) for p in ("pi_R", "pi_star")]
        descending = tuple(-s if math.isfinite(s) else math.inf for s in scores)
        return section, *descending, method, _POLICIES.index(policy)

    entries = []
    for key in sorted(groups, key=place):
        above = share = math.nan
        if key[1] == "pi_R":
            mine, *bars = common(key, *lower)
            above = mine - max(bars)
            mine, true = common(key, ("control_true", "pi_R"))
            share = mine / true if true > 0 else math.nan
        of_best = best[key[1]] if is_rival(key[0]) else []
        entries.append(_entry(groups[key], shown, score[key], above, share, of_best, scales))
    return entries


def _entry(
    rows: list[Row],
    shown: Shown,
    score: float,
    above: float,
    share: float,
    best: list[Row],
    scales: Scales,
) -> Entry:
    first = rows[0]
    ok = [row for row in rows if row.status == "ok"]
    scored = [row for row in ok if math.isfinite(row.normalized_score)]
    if len(ok) == 1:
        varies = "episodes"
        errors = [standard_error(row, scales) for row in scored]
        low, high = normal_interval(score, math.hypot(*errors))
        returns = normal_interval(ok[0].return_mean, standard_error(ok[0], {}))
    else:
        varies = "seeds" if ok else ""
        low, high = mean_interval([row.normalized_score for row in scored])
        returns = mean_interval([row.return_mean for row in ok if math.isfinite(row.return_mean)])
    behind_mean, behind_low, behind_high = behind(scored, best, scales)
    means: dict[str, Any] = {name: mean([getattr(row, name) for row in ok]) for name in MEANS}
    statuses = {row.status for row in rows}
    return Entry(
        env=first.env,
        dynamics=first.dynamics,
        demos=shown.demos,
        every=shown.every,
        demonstrator=shown.demonstrator,
        method=first.method,
        role=role_of(first.method, first.protocol),
        policy=first.policy,
        protocol=first.protocol,
        status=next(status for status in ("failed", "skipped", "ok") if status in statuses),
        seeds=len(rows),
        seeds_ok=len(ok),
        score_mean=score,
        score_low=low,
        score_high=high,
        varies=varies,
        best=bool(best) and best[0].method == first.method,
        behind_mean=behind_mean,
        behind_low=behind_low,
        behind_high=behind_high,
        tied=behind_low <= NEGLIGIBLE,
        above_best_lower_control=above,
        share_of_true=share,
        return_low=returns[0],
        return_high=returns[1],
        note=_note(rows),
        **means,
    )


def _note(rows: Sequence[Row]) -> str:
    """Return where rows come from, and which were skipped, failed or not scored, and why."""
    sources: dict[str, list[int]] = {}
    reasons: dict[tuple[str, str], list[int]] = {}
    for row in rows:
        sources.setdefault(row.source, []).append(row.seed)
        if row.status != "ok":
            reasons.setdefault((row.status, row.reason), []).append(row.seed)
        elif not math.isfinite(row.normalized_score):
            reasons.setdefault(UNSCORED, []).append(row.seed)
    parts = [
        f"{source} ({_seeds(seeds)})" if len(sources) > 1 else source
        for source, seeds in sorted(sources.items())
        if source
    ]
    parts += [f"{status} ({_seeds(seeds)}): {reason}" for (status, reason), seeds in reasons.items()]
    return "; ".join(parts)


def _seeds(seeds: Sequence[int]) -> str:
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"
