"""What differs between runs: how they were computed, and what their methods score."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from harness.judge.leaderboard import Entry, is_on, leaderboard, scored_rows
from harness.judge.numbers import as_text
from harness.judge.results import REFERENCE, CellResult, Conditions, Row
from harness.judge.statistics import mean_interval, probability_of_improvement
from harness.show.tables import interval

HEADINGS = (
    "Task",
    "Method",
    "Policy",
    "Seeds",
    "Score",
    "Score there",
    "Difference [95 %]",
    "P(better there)",
)


@dataclass(frozen=True)
class Run:
    """A run that was read: its name, the conditions of its request, and its cells."""

    name: str
    conditions: Conditions
    results: Sequence[CellResult]


@dataclass(frozen=True)
class Difference:
    """A policy of a method in two runs, over the seeds that both have; scores are normalized, each by its own
    run. low, high: 95 % interval of the mean of the paired differences, NaN with one seed. better: the
    probability that a seed there scores more than one here (Agarwal et al. 2021)."""

    board: str
    method: str
    policy: str
    seeds: int
    here: float
    there: float
    difference: float
    low: float
    high: float
    better: float


def differing(one: Run, other: Run) -> list[str]:
    """In what else than their scores the runs differ, a line each."""
    lines = []
    for field in dataclasses.fields(Conditions):
        a, b = (run.conditions.in_words(field.name) for run in (one, other))
        if a != b:
            lines.append(f"{field.name}: {a}, there {b}")
    facts = [_facts(run) for run in (one, other)]
    for name in dict.fromkeys([*facts[0], *facts[1]]):
        a, b = (", ".join(sorted(its.get(name, {"unknown"}))) for its in facts)
        if a != b:
            lines.append(f"{name}: {a}, there {b}")
    for what, names in (("methods", "method"), ("tasks", "task")):
        held = [{getattr(result.cell, names) for result in run.results} for run in (one, other)]
        for where, its in (("here", held[0] - held[1]), ("there", held[1] - held[0])):
            lines += [f"{what} only {where}: {', '.join(sorted(its))}"] if its else []
    methods = [
        {(r.cell.method, r.cell.task, r.cell.shown): r.key for r in run.results} for run in (one, other)
    ]
    for name, task, shown in sorted(methods[0].keys() & methods[1].keys()):
        a, b = (its[name, task, shown].partition(":")[2] for its in methods)
        if a != b:
            lines.append(f"{name} in {task}: the source or the settings of the method")
    return list(dict.fromkeys(lines))


def _facts(run: Run) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for result in run.results:
        for name, value in result.origin.items():
            found.setdefault(name, set()).add(value)
    return found


def other_versions(one: Run, other: Run) -> list[str]:
    """Environments whose scores cannot be compared, for their task, its experts or the way of scoring are not
    known to be the same."""
    versions = [
        {result.cell.env: (result.task_version, result.key.partition(":")[0]) for result in run.results}
        for run in (one, other)
    ]
    return sorted(
        env
        for env in versions[0].keys() & versions[1].keys()
        if not any(a == b != "" for a, b in zip(versions[0][env], versions[1][env], strict=True))
    )


def is_other_scale(one: Run, other: Run) -> bool:
    """Whether a score of 1 is what demonstrations return in one of them, and something else in the other."""
    scales = [(run.conditions.experts, run.conditions.demonstrations) for run in (one, other)]
    return scales[0] != scales[1] and "none" in (one.conditions.experts, other.conditions.experts)


def differences(one: Run, other: Run) -> list[Difference]:
    """Of every policy that both have, in the order of the first run's leaderboard; none where scores are of
    different scales."""
    if is_other_scale(one, other):
        return []
    apart = other_versions(one, other)
    here, there = (scored_rows(run.results) for run in (one, other))
    groups = [_grouped(rows) for rows in (here, there)]
    found = []
    for entry in leaderboard(here):
        mine, theirs = (_of(its, entry) for its in groups)
        seeds = sorted(mine.keys() & theirs.keys())
        if entry.env in apart or entry.method == REFERENCE or not seeds:
            continue
        pairs = [(mine[seed], theirs[seed]) for seed in seeds]
        gained = [b - a for a, b in pairs]
        a, b = ([pair[i] for pair in pairs] for i in (0, 1))
        found.append(
            Difference(
                *(entry.board, entry.method, entry.policy, len(seeds)),
                *(math.fsum(a) / len(a), math.fsum(b) / len(b), math.fsum(gained) / len(gained)),
                *mean_interval(gained),
                probability_of_improvement(b, a),
            )
        )
    return found


Group = tuple[str, str, str, str, str]


def _group(item: Row | Entry) -> Group:
    return item.env, item.dynamics, item.method, item.policy, item.protocol


def _grouped(rows: Sequence[Row]) -> dict[Group, list[Row]]:
    groups: dict[Group, list[Row]] = {}
    for row in rows:
        groups.setdefault(_group(row), []).append(row)
    return groups


def _of(groups: Mapping[Group, Sequence[Row]], entry: Entry) -> dict[int, float]:
    """By seed, the scores that the entry is of."""
    return {
        row.seed: row.normalized_score
        for row in groups.get(_group(entry), ())
        if is_on(row, entry.shown) and math.isfinite(row.normalized_score)
    }


def as_lines(found: Sequence[Difference]) -> list[list[str]]:
    """Of the table with `HEADINGS`."""
    return [
        [
            *(d.board, d.method, d.policy, str(d.seeds), as_text(d.here, "z.2f"), as_text(d.there, "z.2f")),
            str(interval(d.difference, d.low, d.high, "+.2f")),
            f"{d.better:.2f}",
        ]
        for d in found
    ]
