"""From the rows of a run to its leaderboard: normalized scores, and what they come to over seeds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from harness.codec import usable
from harness.results import CONTROLS, LOWER_CONTROLS, REFERENCE, CellResult, Row
from harness.statistics import interquartile_interval, interquartile_mean, mean_interval

_POLICIES = ("expert", "random", "pi_star", "pi_R")
_ROLES = {
    REFERENCE: "reference",
    "control_true": "upper control",
    "control_survival": "survival control",
    "control_shuffled": "shuffled control",
    **dict.fromkeys(LOWER_CONTROLS, "lower control"),
}


UNSCORED = ("not scored", "no expert better than a random policy to measure by")


@dataclass(frozen=True)
class Entry:
    """One line of the leaderboard: a policy of a method in an env, over its seeds that are ok.

    score: normalized, 0 the random policy and 1 the expert. low and high bound the mean's 95 % interval.
    Costs are means over seeds. Numbers are NaN where nothing is known.
    """

    env: str
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
    above_best_lower_control: float
    """Of pi_R rows: score_mean minus the best score_mean of the three lower controls."""
    advantage_correlation: float
    """Of pi_R rows: Spearman's, of the reward with the true advantage; the mean over seeds."""
    return_mean: float
    return_low: float
    return_high: float
    discounted_mean: float
    fit_seconds: float
    env_steps: float
    rl_steps: float
    rl_solves: float
    note: str
    """Which seeds were skipped, failed or not scored, and why."""


@dataclass(frozen=True)
class Overall:
    """A policy of a method over all envs: the interquartile mean of its scores and its 95 % interval."""

    method: str
    policy: str
    envs: int
    runs: int
    score: float
    low: float
    high: float


def scored_rows(results: Sequence[CellResult]) -> list[Row]:
    """All rows with their normalized scores, by env, method (reference first, controls last), seed, policy.

    The score is NaN where the expert or the random policy of that env and seed is missing, or where the
    expert is no better than the random policy, which leaves no scale.
    """
    rows = [row for result in results for row in result.rows]
    known = {
        (row.env, row.seed, row.policy): row.return_mean
        for row in rows
        if row.method == REFERENCE and row.status == "ok"
    }

    def scored(row: Row) -> Row:
        low = known.get((row.env, row.seed, "random"), math.nan)
        scale = known.get((row.env, row.seed, "expert"), math.nan) - low
        score = (row.return_mean - low) / scale if scale > 0 and row.status == "ok" else math.nan
        score = score if usable(score) else math.nan
        return dataclasses.replace(row, normalized_score=score)

    return sorted(map(scored, rows), key=_order)


def _order(row: Row) -> tuple[Any, ...]:
    rank = 0 if row.method == REFERENCE else 2 + CONTROLS.index(row.method) if row.method in CONTROLS else 1
    return row.env, rank, row.method, row.seed, _POLICIES.index(row.policy), row.protocol


def leaderboard(rows: Sequence[Row]) -> list[Entry]:
    """The lines of every env: methods from the best to the worst pi_R, those without a reward by their
    pi_star after them, then controls, then the reference."""
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.env, row.protocol, row.method, row.policy), []).append(row)
    score = {key: _mean([row.normalized_score for row in group]) for key, group in groups.items()}

    def above(key: tuple[str, str, str, str]) -> float:
        env, protocol, _, policy = key
        if policy != "pi_R":
            return math.nan
        bars = [score.get((env, protocol, control, "pi_R"), math.nan) for control in LOWER_CONTROLS]
        return score[key] - max(bars) if all(map(math.isfinite, bars)) else math.nan

    def place(key: tuple[str, str, str, str]) -> tuple[Any, ...]:
        env, protocol, method, policy = key
        section = 2 if method == REFERENCE else 1 if method in CONTROLS else 0
        scores = [score.get((env, protocol, method, p), math.nan) for p in ("pi_R", "pi_star")]
        descending = tuple(-s if math.isfinite(s) else math.inf for s in scores)
        return env, protocol, section, *descending, method, _POLICIES.index(policy)

    return [_entry(groups[key], score[key], above(key)) for key in sorted(groups, key=place)]


def _entry(rows: list[Row], score: float, above: float) -> Entry:
    first = rows[0]
    ok = [row for row in rows if row.status == "ok"]
    scores = [row.normalized_score for row in ok if math.isfinite(row.normalized_score)]
    score_low, score_high = mean_interval(scores)
    return_low, return_high = mean_interval([row.return_mean for row in ok if math.isfinite(row.return_mean)])
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.status != "ok":
            reasons.setdefault((row.status, row.reason), []).append(str(row.seed))
        elif not math.isfinite(row.normalized_score):
            reasons.setdefault(UNSCORED, []).append(str(row.seed))
    statuses = {row.status for row in rows}
    return Entry(
        env=first.env,
        method=first.method,
        role=_ROLES.get(first.method, "method"),
        policy=first.policy,
        protocol=first.protocol,
        status=next(status for status in ("failed", "skipped", "ok") if status in statuses),
        seeds=len(rows),
        seeds_ok=len(ok),
        score_mean=score,
        score_low=score_low,
        score_high=score_high,
        above_best_lower_control=above,
        advantage_correlation=_mean([row.advantage_correlation for row in ok]),
        return_mean=_mean([row.return_mean for row in ok]),
        return_low=return_low,
        return_high=return_high,
        discounted_mean=_mean([row.discounted_mean for row in ok]),
        fit_seconds=_mean([row.fit_seconds for row in ok]),
        env_steps=_mean([row.env_steps for row in ok]),
        rl_steps=_mean([row.rl_steps for row in ok]),
        rl_solves=_mean([row.rl_solves for row in ok]),
        note="; ".join(
            f"{status} ({'seeds' if len(seeds) > 1 else 'seed'} {', '.join(seeds)}): {reason}"
            for (status, reason), seeds in reasons.items()
        ),
    )


def _mean(values: Sequence[float]) -> float:
    """The mean of the values that are known, NaN where none is."""
    known = [value for value in values if math.isfinite(value)]
    return math.fsum(known) / len(known) if known else math.nan


def overall(rows: Sequence[Row]) -> list[Overall]:
    """Every policy over all envs, best first; empty where there is one env only.

    Only policies with a score in every env, since those left out could be the hard ones.
    """
    scores: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in rows:
        if math.isfinite(row.normalized_score) and row.method != REFERENCE:
            by_env = scores.setdefault((row.method, row.policy), {})
            by_env.setdefault(row.env, []).append(row.normalized_score)
    envs = {row.env for row in rows}
    lines = []
    for (method, policy), by_env in scores.items():
        if by_env.keys() == envs and len(envs) > 1:
            pooled = [score for runs in by_env.values() for score in runs]
            low, high = interquartile_interval(list(by_env.values()))
            lines.append(
                Overall(method, policy, len(envs), len(pooled), interquartile_mean(pooled), low, high)
            )
    return sorted(lines, key=lambda line: (-line.score, line.method, line.policy))
