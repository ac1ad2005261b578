"""The leaderboard of a run's rows: normalized scores, and their means over seeds."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from harness.judge.rows import LOWER, by_shown, is_rival, mean, role_of, scales_of, scores_of
from harness.judge.standings import Standing, standings_of
from harness.judge.statistics import interquartile_mean, mean_interval, share_interval
from harness.records import CONTROLS, NOMINAL, REFERENCE, Cell, CellResult, Row, Shown
from harness.registry import Demonstrator
from harness.registry.bounds import usable

_POLICIES = ("expert", "demonstrations", "random", "pi_star", "pi_R")
LEAST_TRUE = 0.1
"""Smallest score of `control_true` that others are a share of."""
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
    without experts. In a variant, RL on the true reward scores 1. They are of the seeds whose reward RL
    solved, or where that is unknown. Costs and returns are means over ok seeds. Unknown numbers are NaN.
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
    seeds_scored: int
    """Seeds whose scores the next columns are of."""
    score_mean: float
    score_low: float
    score_high: float
    score_iqm: float
    """Interquartile mean of the scores."""
    share: float
    """Share of these seeds that reach 0.9."""
    share_low: float
    """Lower end of the interval of `share` (Clopper & Pearson 1934)."""
    share_high: float
    """Upper end of the interval of `share`."""
    unsolved: int
    """Seeds whose reward RL did not solve. Their scores say nothing about the reward."""
    score_unsolved: float
    """Mean score of these seeds."""
    best: bool
    """True for the method with the highest mean (`best_of`)."""
    same_policy_as: str
    """The method whose pi_star this one is, too: it is compared under that name."""
    behind: float
    """Methods: the gap to the best method's policy of the same name, paired by seed."""
    behind_p: float
    """The p-value of this gap, adjusted over all comparisons on the board (`harness.judge.comparisons`)."""
    better_than: str
    """Methods and controls whose scores are significantly lower, paired by seed."""
    worse_than: str
    """Methods and controls whose scores are significantly higher."""
    detectable: float
    """The smallest difference to a method that always succeeds that the pair with the fewest shared seeds
    shows with power 0.8. Empty where it shows none."""
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
    discounted_mean: float
    fit_seconds: float
    env_steps: float
    check_steps: float
    rl_solves: float
    note: str
    """The baseline it comes from, if any, and the seeds that were skipped, failed or not scored, and why."""

    @property
    def is_unsolved(self) -> bool:
        """True where RL solved R* on no seed: no score says anything about R*."""
        return not math.isfinite(self.score_mean) and self.unsolved > 0

    @property
    def drawn_score(self) -> float:
        """The mean score; where RL solved R* on no seed, that of all seeds."""
        return self.score_unsolved if self.is_unsolved else self.score_mean

    @property
    def interactions(self) -> float:
        """Environment steps, those that check checkpoints included."""
        return self.env_steps + self.check_steps

    @property
    def incomparable(self) -> bool:
        """True for a method with a score that shares no seed with the best one."""
        scored = is_rival(self.method) and not self.same_policy_as and math.isfinite(self.score_mean)
        return scored and not self.best and not math.isfinite(self.behind)

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
    return [
        entry
        for _, of_task in sorted(tasks.items())
        for shown, mine in by_shown(of_task, lambda row: row).items()
        for entry in _board(mine, shown)
    ]


def _board(rows: Sequence[Row], shown: Shown) -> list[Entry]:
    """Return the lines of one board."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.method, row.policy), []).append(row)
    seeds = {key: scores_of(group) for key, group in groups.items()}
    score = {key: mean([*its.values()]) for key, its in seeds.items()}
    lower = [(name, "pi_R") for name in CONTROLS if role_of(name, rows[0].protocol) == LOWER]

    def common(*keys: tuple[str, str]) -> list[float]:
        """Return the mean score of each over the seeds that all have."""
        known = [seeds.get(key, {}) for key in keys]
        shared = set(known[0]).intersection(*known[1:])
        return [mean([one[seed] for seed in shared]) for one in known]

    standings: dict[tuple[str, str], Standing] = {}
    for policy in _POLICIES:
        standings |= standings_of({m: its for (m, p), its in sorted(seeds.items()) if p == policy}, policy)

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
            share = mine / true if true >= LEAST_TRUE else math.nan
        entries.append(_entry(groups[key], shown, above, share, standings.get(key, Standing())))
    return entries


def _entry(rows: list[Row], shown: Shown, above: float, share: float, standing: Standing) -> Entry:
    first = rows[0]
    ok = [row for row in rows if row.status == "ok"]
    scores = [*scores_of(ok).values()]
    unsolved = [row.normalized_score for row in ok if row.solved == 0]
    # The reference scores 0 and 1 by definition.
    vary = scores if first.method != REFERENCE or len({*scores}) > 1 else []
    score_low, score_high = mean_interval(vary)
    reached, share_low, share_high = share_interval(vary)
    to_best = standing.differences.get(standing.best)
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
        seeds_scored=len(scores),
        score_mean=mean(scores),
        score_low=score_low,
        score_high=score_high,
        score_iqm=interquartile_mean(scores),
        share=reached,
        share_low=share_low,
        share_high=share_high,
        unsolved=len(unsolved),
        score_unsolved=mean(unsolved),
        best=standing.best == first.method,
        same_policy_as=standing.same_policy_as,
        behind=-to_best.mean if to_best else math.nan,
        behind_p=to_best.p if to_best else math.nan,
        better_than=standing.names(1),
        worse_than=standing.names(-1),
        detectable=standing.detectable,
        above_best_lower_control=above,
        share_of_true=share,
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
