"""Rows of results: roles of their methods, the boards that they are on, and methods seed by seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeVar

from harness.records import ALL_SHOWN, LOWER_CONTROLS, NOMINAL, REFERENCE, UNSHOWN, Row, Shown
from harness.registry import ASKING, RANKED, base
from methods.parts import BEGINS_WITH

T = TypeVar("T")

LOWER, SURVIVAL = "lower control", "survival control"
ASKS, SEES_RANKS = "asks the expert", "sees ranked demonstrations"
BESIDE = (ASKS, SEES_RANKS)
"""Roles of methods that know more than others, and are not ranked."""
_ROLES = {
    REFERENCE: "reference",
    "control_true": "upper control",
    "control_survival": SURVIVAL,
    "control_shuffled": "shuffled control",
    "control_clone": "clone control",
    **dict.fromkeys(LOWER_CONTROLS, LOWER),
    **dict.fromkeys(ASKING, ASKS),
    **dict.fromkeys(RANKED, SEES_RANKS),
}
UNINFORMED = (LOWER, SURVIVAL, "shuffled control")
"""Roles of controls without information about the task."""
ONE_STAR = BEGINS_WITH | {"shaped_thesis_end": "shaped_thesis"}
"""Methods whose pi_star is that of another one."""
Scales = Mapping[tuple[str, int], tuple[float, float]]
"""The random policy's return, and the expert's return above it, by task and seed."""


def role_of(method: str, protocol: str) -> str:
    """Return the role under a protocol; 'method' for those that are compared with each other.

    Under the protocols native and state an end pays nothing. There control_plus1 means "stay alive", and
    control_survival pays 0 everywhere; under the others it is the reverse (docs/termination.md).
    """
    if protocol in ("native", "state"):
        swapped = {"control_plus1": SURVIVAL, "control_survival": LOWER}.get(method)
        return swapped or _ROLES.get(base(method), "method")
    return _ROLES.get(base(method), "method")


def is_rival(method: str) -> bool:
    """Return whether the method competes with others, unlike controls and the reference."""
    return base(method) not in _ROLES


def scales_of(rows: Sequence[Row]) -> Scales:
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
        scale = next((known[task, seed, *top] for top in tops if (task, seed, *top) in known), math.nan) - low
        if scale > 0:
            scales[task, seed] = low, scale
    return scales


def by_shown(items: Sequence[T], row: Callable[[T], Row]) -> dict[Shown, list[T]]:
    """Return a task's items by the demonstrations of each board. `row`: gives an item's row."""
    boards: dict[Shown, list[T]] = {shown: [] for shown in shown_in([row(item) for item in items])}
    for item in items:
        one = row(item)
        for board in boards.values() if one.method in UNSHOWN else (boards[one.shown],):
            board.append(item)
    return boards


def shown_in(rows: Sequence[Row]) -> list[Shown]:
    """Return the demonstrations of all boards; the budget's own number comes first."""
    return sorted({row.shown for row in rows if row.method not in UNSHOWN}) or [ALL_SHOWN]


def is_on(row: Row, shown: Shown) -> bool:
    """Return whether the row is on the board of these demonstrations."""
    return row.method in UNSHOWN or row.shown == shown


def mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values, NaN where there are none."""
    known = [value for value in values if math.isfinite(value)]
    return math.fsum(known) / len(known) if known else math.nan


def counts(row: Row) -> bool:
    """Return whether its score is known, and not of a policy of RL that did not solve the reward."""
    return math.isfinite(row.normalized_score) and row.solved != 0


def scores_of(rows: Sequence[Row]) -> dict[int, float]:
    """Return the scores that count, by seed."""
    return {row.seed: row.normalized_score for row in rows if counts(row)}


def same_stars(methods: Collection[str]) -> dict[str, str]:
    """Return the methods whose pi_star is that of another one of these, by which it counts."""
    first: dict[str, str] = {}
    for method in sorted(methods, key=lambda name: (name in ONE_STAR, name)):
        first.setdefault(ONE_STAR.get(method, method), method)
    counted = {method: first[ONE_STAR.get(method, method)] for method in methods}
    return {method: other for method, other in counted.items() if method != other}


def best_of(ordered: Mapping[str, Mapping[int, float]]) -> str:
    """Return the first method that no method with as many seeds beats where both have a score; '' for none.

    `ordered`: scores by seed of each method, by falling mean. A mean over easy seeds alone is not the best.
    """
    unbeaten = (m for m, its in ordered.items() if not any(_beats(other, its) for other in ordered.values()))
    return next(unbeaten, next(iter(ordered), ""))


def _beats(mine: Mapping[int, float], theirs: Mapping[int, float]) -> bool:
    """Return whether it has at least as many seeds and a higher score on the shared ones, or more seeds where
    none are shared."""
    if mine.keys() == theirs.keys() or len(mine) < len(theirs):
        return False
    shared = mine.keys() & theirs.keys()
    if not shared:
        return len(mine) > len(theirs)
    return math.fsum(mine[seed] - theirs[seed] for seed in shared) > 0
