"""The leaderboard of a run's rows: normalized scores, and their means over seeds."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from harness.judge.roles import LOWER, is_rival, role_of
from harness.judge.statistics import (
    mean_interval,
    normal_interval,
)
from harness.records import ALL_SHOWN, CONTROLS, NOMINAL, REFERENCE, UNSHOWN, Cell, CellResult, Row, Shown
from harness.registry import Demonstrator
from harness.registry.bounds import Settings, usable

T = TypeVar("T")

_POLICIES = ("expert", "demonstrations", "random", "pi_star", "pi_R")
NEGLIGIBLE = 0.005
"""The largest difference of scores that counts as equal."""
UNSCORED = ("not scored", "what would score 1 is missing, or no better than a random policy")
Scales = Mapping[tuple[str, int], tuple[float, float]]
"""The random policy's return, and the expert's return above it, by env and seed."""


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
    """True for the method that others' policies of the same name are compared with (`_best`)."""
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
    """Share of the seeds whose reward RL solved (`harness.judge.solved`), in pi_R rows of methods."""
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
        """Return whether RL failed to solve R* on some seed: the score there says nothing about R*."""
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
    rows = [
        dataclasses.replace(row, settings=_in_one_line(result.settings))
        for result in results
        for row in result.rows
    ]
    scales = _scales(rows)

    def scored(row: Row) -> Row:
        if row.policy == "expert" and row.expert.startswith("file:"):
            row = dataclasses.replace(row, policy="demonstrations")
        low, scale = scales.get((row.task, row.seed), (math.nan, math.nan))
        score = (row.return_mean - low) / scale if row.status == "ok" else math.nan
        return dataclasses.replace(row, normalized_score=score if usable(score) else math.nan)

    return sorted(map(scored, rows), key=_order)


def _in_one_line(settings: Settings) -> str:
    return json.dumps(settings, separators=(",", ":")) if settings else ""


def _scales(rows: Sequence[Row]) -> Scales:
    """Return the scales of all tasks and seeds whose policies that score 0 and 1 are known."""
    known: dict[tuple[str, int, str, str], float] = {
        (row.task, row.seed, row.method, row.policy): row.return_mean
        for row in rows
        if row.method in (REFERENCE, "control_true") and row.status == "ok"
    }
    scales = {}
    for task, seed, dynamics in {(row.task, row.seed, row.dynamics) for row in rows}:
        tops = [(REFERENCE, "expert"), (REFERENCE, "demonstrations")]
        if dynamics != NOMINAL:
            tops = [("control_true", "pi_R")]
        low = known.get((task, seed, REFERENCE, "random"), math.nan)
        found = [known[key] for top in tops if (key := (task, seed, *top)) in known]
        scale = found[0] - low if found else math.nan
        if scale > 0:
            scales[task, seed] = low, scale
    return scales


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
    scales = _scales(rows)
    return [
        entry
        for _, its in sorted(tasks.items())
        for shown, mine in by_shown(its, lambda row: row).items()
        for entry in _board(mine, shown, scales)
    ]


def by_shown(items: Sequence[T], row: Callable[[T], Row]) -> dict[Shown, list[T]]:
    """Return a task's items by the demonstrations of each board. `row`: gives an item's row."""
    boards: dict[Shown, list[T]] = {shown: [] for shown in shown_in([row(item) for item in items])}
    for item in items:
        its = row(item)
        for board in boards.values() if its.method in UNSHOWN else (boards[its.shown],):
            board.append(item)
    return boards


def shown_in(rows: Sequence[Row]) -> list[Shown]:
    """Return the demonstrations of all boards; the budget's own number comes first."""
    return sorted({row.shown for row in rows if row.method not in UNSHOWN}) or [ALL_SHOWN]


def is_on(row: Row, shown: Shown) -> bool:
    """Return whether the row is on the board of these demonstrations."""
    return row.method in UNSHOWN or row.shown == shown


def _board(rows: Sequence[Row], shown: Shown, scales: Scales) -> list[Entry]:
    """Return the lines of one board."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.method, row.policy), []).append(row)
    score = {key: _mean([row.normalized_score for row in group]) for key, group in groups.items()}
    seeds = {key: set(_scores(group)) for key, group in groups.items()}
    protocol = rows[0].protocol
    lower = [(control, "pi_R") for control in CONTROLS if role_of(control, protocol) == LOWER]

    def common(*keys: tuple[str, str]) -> list[float]:
        """The mean score of each over the seeds that all have."""
        shared = set.intersection(*(seeds.get(key, set()) for key in keys))
        known = [_scores(groups.get(key, [])) for key in keys]
        return [_mean([one[seed] for seed in shared]) for one in known]

    best: dict[str, list[Row]] = {}  # rows of the best method, by policy
    for policy in _POLICIES:
        rivals = [
            key for key in groups if key[1] == policy and is_rival(key[0]) and math.isfinite(score[key])
        ]
        best[policy] = _best([groups[key] for key in sorted(sorted(rivals), key=lambda key: -score[key])])

    def place(key: tuple[str, str]) -> tuple[Any, ...]:
        method, policy = key
        section = 2 if method == REFERENCE else 1 if method in CONTROLS else 0
        scores = [score.get((method, p), math.nan) for p in ("pi_R", "pi_star")]
        descending = tuple(-s if math.isfinite(s) else math.inf for s in scores)
        return section, *descending, method, _POLICIES.index(policy)

    entries = []
    for key in sorted(groups, key=place):
        trained = key[1] == "pi_R"
        mine, *bars = common(key, *lower)
        above = mine - max(bars) if trained else math.nan
        mine, true = common(key, ("control_true", "pi_R"))
        share = mine / true if trained and true > 0 else math.nan
        theirs = best[key[1]] if is_rival(key[0]) else []
        entries.append(_entry(groups[key], shown, score[key], above, share, theirs, scales))
    return entries


def _scores(rows: Sequence[Row]) -> dict[int, float]:
    """Return the scores that are known, by seed."""
    return {row.seed: row.normalized_score for row in rows if math.isfinite(row.normalized_score)}


def _best(ordered: Sequence[list[Row]]) -> list[Row]:
    """Return the rows of the first method that no method with as many seeds beats where both have a score.

    `ordered`: rows of each method, by falling mean score. A mean over easy seeds alone is not the best.
    """
    unbeaten = (rows for rows in ordered if not any(_beats(other, rows) for other in ordered))
    return next(unbeaten, ordered[0] if ordered else [])


def _beats(rows: list[Row], others: list[Row]) -> bool:
    """Return whether it has at least as many seeds and a higher score on the shared ones, or more seeds where
    none are shared."""
    mine, theirs = _scores(rows), _scores(others)
    if mine.keys() == theirs.keys() or len(mine) < len(theirs):
        return False
    shared = mine.keys() & theirs.keys()
    if not shared:
        return len(mine) > len(theirs)
    return math.fsum(mine[seed] - theirs[seed] for seed in shared) > 0


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
    known = [row for row in ok if math.isfinite(row.return_mean)]
    if len(ok) == 1:
        varies = "episodes"
        score_low, score_high = normal_interval(score, math.hypot(*(_error(r, scales) for r in scored)))
        returns = normal_interval(ok[0].return_mean, _error(ok[0], {}))
    else:
        varies = "seeds" if ok else ""
        score_low, score_high = mean_interval([row.normalized_score for row in scored])
        returns = mean_interval([row.return_mean for row in known])
    behind, behind_low, behind_high = _behind(scored, best, scales)
    sources: dict[str, list[int]] = {}
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        sources.setdefault(row.source, []).append(row.seed)
        if row.status != "ok":
            reasons.setdefault((row.status, row.reason), []).append(str(row.seed))
        elif not math.isfinite(row.normalized_score):
            reasons.setdefault(UNSCORED, []).append(str(row.seed))
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
        score_low=score_low,
        score_high=score_high,
        varies=varies,
        best=bool(best) and best[0].method == first.method,
        behind_mean=behind,
        behind_low=behind_low,
        behind_high=behind_high,
        tied=behind_low <= NEGLIGIBLE,
        above_best_lower_control=above,
        share_of_true=share,
        reward_distance=_mean([row.reward_distance for row in ok]),
        reward_floor=_mean([row.reward_floor for row in ok]),
        reward_rank=_mean([row.reward_rank for row in ok]),
        policy_ranking=_mean([row.policy_ranking for row in ok]),
        own_return=_mean([row.own_return for row in ok]),
        own_return_shown=_mean([row.own_return_shown for row in ok]),
        solved=_mean([row.solved for row in ok]),
        return_mean=_mean([row.return_mean for row in ok]),
        return_low=returns[0],
        return_high=returns[1],
        discounted_mean=_mean([row.discounted_mean for row in ok]),
        fit_seconds=_mean([row.fit_seconds for row in ok]),
        env_steps=_mean([row.env_steps for row in ok]),
        check_steps=_mean([row.check_steps for row in ok]),
        rl_solves=_mean([row.rl_solves for row in ok]),
        note="; ".join(
            [
                *(
                    _from(source, seeds, len(sources) > 1)
                    for source, seeds in sorted(sources.items())
                    if source
                ),
                *(
                    f"{status} ({'seeds' if len(seeds) > 1 else 'seed'} {', '.join(seeds)}): {reason}"
                    for (status, reason), seeds in reasons.items()
                ),
            ]
        ),
    )


def _from(source: str, seeds: list[int], in_part: bool) -> str:
    """Return the source of these seeds. `in_part`: True where others come from elsewhere."""
    return (
        f"{source} ({'seeds' if len(seeds) > 1 else 'seed'} {', '.join(map(str, seeds))})"
        if in_part
        else source
    )


def _behind(rows: list[Row], best: list[Row], scales: Scales) -> tuple[float, float, float]:
    """Return the mean gap to the best method's rows over the seeds that both have, and its 95 % interval.

    With one such seed, the interval is over episodes, as if they were not paired.
    """
    theirs = {row.seed: row for row in best if math.isfinite(row.normalized_score)}
    pairs = [(theirs[row.seed], row) for row in rows if row.seed in theirs]
    differences = [one.normalized_score - other.normalized_score for one, other in pairs]
    if not pairs or best[0].method == rows[0].method:
        return math.nan, math.nan, math.nan
    if len(pairs) > 1:
        return _mean(differences), *mean_interval(differences)
    errors = [_error(row, scales) for row in pairs[0]]
    return differences[0], *normal_interval(differences[0], math.hypot(*errors))


def _error(row: Row, scales: Scales) -> float:
    """Return the standard error of its mean score over evaluation episodes, or, without scales, of its
    return."""
    if row.episodes < 2:
        return math.nan
    error = row.return_std / math.sqrt(row.episodes)
    return error / scales[row.task, row.seed][1] if scales else error


def _mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values, NaN where there are none."""
    known = [value for value in values if math.isfinite(value)]
    return math.fsum(known) / len(known) if known else math.nan
