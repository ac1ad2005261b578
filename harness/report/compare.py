"""Comparison of runs: how they were computed, and the scores of their methods."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from harness.judge.comparisons import detectable, holm, sign_flips
from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.rows import is_on, scores_of
from harness.judge.statistics import probability_of_improvement
from harness.records import REFERENCE, CellResult, Conditions, Row
from harness.report.columns import MEANINGS, difference
from harness.report.tables import Table, at, number


@dataclass(frozen=True)
class Run:
    """A run that was read: its name, the conditions of its request, and its cells."""

    name: str
    conditions: Conditions
    results: Sequence[CellResult]


COLUMNS = (
    at(0, "board", "Task", "The board.", "text"),
    at(1, "method", "Method", MEANINGS["method"], "choice"),
    at(2, "policy", "Policy", "The policy.", "text"),
    at(3, "seeds", "Seeds", "Seeds that count in both runs."),
    at(4, "here", "Score", "Mean score in the first run."),
    at(5, "there", "Score there", "Mean score in the other run."),
    at(
        6,
        "difference",
        "Difference",
        "Mean of the differences, paired by seed. 'ns': not significant, and in "
        "parentheses the smallest one from steady success that so many seeds show with power 0.8.",
    ),
    at(7, "p", "p", "Its p-value by flips of signs, adjusted for all lines (Holm 1979)."),
    at(8, "better", "P(better there)", "Probability of a higher score (Agarwal et al. 2021)."),
)


def differing(one: Run, other: Run) -> list[str]:
    """Return in what else than their scores the runs differ, a line each."""
    lines = []
    for field in dataclasses.fields(Conditions):
        a, b = (run.conditions.in_words(field.name) for run in (one, other))
        lines += [f"{field.name}: {a}, there {b}"] if a != b else []
    here, there = _origins(one), _origins(other)
    for name in dict.fromkeys([*here, *there]):
        a, b = (", ".join(sorted(origin.get(name, {"unknown"}))) for origin in (here, there))
        lines += [f"{name}: {a}, there {b}"] if a != b else []
    for title, name in (("methods", "method"), ("tasks", "task")):
        mine, others = ({getattr(result.cell, name) for result in run.results} for run in (one, other))
        for where, extra in (("here", mine - others), ("there", others - mine)):
            lines += [f"{title} only {where}: {', '.join(sorted(extra))}"] if extra else []
    sources, other_sources = (
        {(r.cell.method, r.cell.task, r.cell.shown): r.key.partition(":")[2] for r in run.results}
        for run in (one, other)
    )
    for key in sorted(sources.keys() & other_sources.keys()):
        if sources[key] != other_sources[key]:
            lines.append(f"{key[0]} in {key[1]}: the source or the settings of the method")
    return list(dict.fromkeys(lines))


def _origins(run: Run) -> dict[str, set[str]]:
    """Return the machines and versions by name."""
    origins: dict[str, set[str]] = {}
    for result in run.results:
        for name, value in result.origin.items():
            origins.setdefault(name, set()).add(value)
    return origins


def other_versions(one: Run, other: Run) -> list[str]:
    """Return environments whose scores cannot be compared: their task, experts or scoring may differ."""
    here, there = (
        {r.cell.env: (r.task_version, r.key.partition(":")[0]) for r in run.results} for run in (one, other)
    )
    return sorted(
        env
        for env in here.keys() & there.keys()
        if not any(a == b != "" for a, b in zip(here[env], there[env], strict=True))
    )


def is_other_scale(one: Run, other: Run) -> bool:
    """Return whether a score of 1 is the demonstrations' return in one run alone."""
    scales = [(run.conditions.experts, run.conditions.demonstrations) for run in (one, other)]
    return scales[0] != scales[1] and "none" in (one.conditions.experts, other.conditions.experts)


def differences(one: Run, other: Run) -> Table:
    """Return the differences of the policies that both runs have, over the seeds that both have, in the order
    of the first's leaderboard. It is empty where scores are of different scales."""
    groups: list[dict[tuple[str, ...], list[Row]]] = [{}, {}]
    rows = [scored_rows(run.results) for run in (one, other)]
    for mine, by_policy in zip(rows, groups, strict=True):
        for row in mine:
            by_policy.setdefault(_policy(row), []).append(row)
    apart, lines, p_values = other_versions(one, other), [], {}
    for entry in leaderboard(rows[0]) if not is_other_scale(one, other) else ():
        own, theirs = (
            scores_of([row for row in by_policy.get(_policy(entry), ()) if is_on(row, entry.shown)])
            for by_policy in groups
        )
        seeds = sorted(own.keys() & theirs.keys())
        if seeds and entry.env not in apart and entry.method != REFERENCE:
            here, there = ([scores[seed] for seed in seeds] for scores in (own, theirs))
            gained = [b - a for a, b in zip(here, there, strict=True)]
            means = (number(math.fsum(scores) / len(seeds), "z.2f") for scores in (here, there))
            better = number(probability_of_improvement(there, here), ".2f")
            who = entry.board, entry.method, entry.policy
            p_values[who] = sign_flips(gained)
            lines.append((who, (number(len(seeds), ".0f"), *means), gained, better))
    adjusted, items = holm(p_values), []
    for who, numbers, gained, better in lines:
        mean, p = math.fsum(gained) / len(gained), adjusted[who]
        gap = difference(mean, p, detectable(len(gained), len(lines)))
        items.append((*who, *numbers, gap, number(p, ".2g"), better))
    return Table("differences", COLUMNS, items)


def _policy(item: Row | Entry) -> tuple[str, ...]:
    return item.env, item.dynamics, item.method, item.policy, item.protocol
