"""The heat map of a report: the scores of methods by board, and cautions about each board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from harness.judge.comparisons import ALPHA
from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.rows import BESIDE
from harness.records import REFERENCE
from harness.report.columns import INCOMPARABLE, NAMES, NO_SCORE, score, unsolved
from harness.report.model import Board

MOST_COLUMNS = 16
"""Boards of each group."""
MOST_METHODS = 60
SHADES = 10
LONGEST_REASON = 300
"""Characters of the reason for a missing score."""


@dataclass(frozen=True)
class Tile:
    """A policy of a method on a board.

    shade: 0 for a score of 0 or less, `SHADES` for 1 or more, -1 for none. tip: the tooltip.
    """

    text: str = ""
    mark: str = ""
    shade: int = -1
    tip: str = ""


@dataclass(frozen=True)
class Head:
    """The head of a column: a board, its short name, and a word and a sentence for each caution."""

    board: Board
    name: str
    cautions: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class HeatMap:
    """Methods by boards. `roles`: by method, in order. `left_out`: what is not on it, in words.

    `groups`: heads with a tile for each method, by title.
    """

    roles: Mapping[str, str]
    groups: Mapping[str, Sequence[tuple[Head, Sequence[Tile]]]]
    left_out: str


def heat_map(boards: Sequence[Board]) -> HeatMap:
    """Return the map of these boards. Rows are methods by their mean pi_R, those without one by their mean
    pi_star after them, then controls."""
    roles = _ordered(boards)
    methods = list(roles)[:MOST_METHODS]
    kinds = {"": [b for b in boards if b.is_nominal], "Transfer: ": [b for b in boards if not b.is_nominal]}
    groups: dict[str, list[tuple[Head, list[Tile]]]] = {}
    for beginning, mine in kinds.items():
        for policy, title in NAMES.items():
            for board in mine[:MOST_COLUMNS]:
                entries = {e.method: e for e in board.entries if e.policy == policy}
                if entries.keys() & {*methods}:
                    head = Head(board, _short_name(board, boards), _cautions(board, policy))
                    tiles = [_tile(entries.get(method)) for method in methods]
                    groups.setdefault(beginning + title, []).append((head, tiles))
    boards_left = sum(max(0, len(mine) - MOST_COLUMNS) for mine in kinds.values())
    methods_left = len(roles) - len(methods)
    left_out = f"{boards_left} more boards and {methods_left} more methods are in the leaderboard."
    return HeatMap({m: roles[m] for m in methods}, groups, left_out * bool(boards_left or methods_left))


def _ordered(boards: Sequence[Board]) -> dict[str, str]:
    """Return the role of each method, in the order of the map's rows."""
    roles = {e.method: e.role for board in boards for e in board.entries if e.method != REFERENCE}
    scores: dict[tuple[str, str], list[float]] = {}
    for board in (board for board in boards if board.is_nominal):
        for entry in board.entries:
            if math.isfinite(entry.score_mean):
                scores.setdefault((entry.method, entry.policy), []).append(entry.score_mean)

    def place(method: str) -> tuple[int | float | str, ...]:
        section = {"method": 0, **dict.fromkeys(BESIDE, 1)}.get(roles[method], 2)
        mine = [scores.get((method, policy), [-math.inf]) for policy in ("pi_R", "pi_star")]
        return section, *(-sum(values) / len(values) for values in mine), method

    return {method: roles[method] for method in sorted(roles, key=place)}


def _short_name(board: Board, boards: Sequence[Board]) -> str:
    """Return the board's name without the parts that all boards share."""
    first = board.entries[0]
    task = first.task
    if not board.is_nominal and all(other.env == board.env for other in boards):
        task = first.dynamics
    same = all(other.entries[0].shown == first.shown for other in boards)
    return task if same or not str(first.shown) else f"{task}, {first.shown}"


def _tile(entry: Entry | None) -> Tile:
    if entry is None:
        return Tile()
    name = f"{entry.method}, {NAMES[entry.policy]}, {entry.board}: "
    if entry.is_unsolved:
        return Tile("not solved", tip=name + unsolved(entry))
    if not math.isfinite(entry.score_mean):
        reason = " ".join(entry.note.split())[:LONGEST_REASON] or NO_SCORE
        return Tile("failed" if entry.status == "failed" else "none", tip=name + reason)
    parts = [f"{score(entry)}, {entry.seeds_ok} of {entry.seeds} seeds"]
    parts += [f"{INCOMPARABLE} with the best"] * entry.incomparable
    parts += [f"the policy of {entry.same_policy_as}"] * bool(entry.same_policy_as)
    mark = "★" if entry.best else "▼" if entry.behind_p <= ALPHA else ""
    if mark:
        parts.append("the highest mean" if entry.best else "significantly worse than the highest mean")
    if entry.unsolved:
        mark += "†"
        parts.append(unsolved(entry))
    shade = round(SHADES * min(1.0, max(0.0, entry.score_mean)))
    return Tile(as_text(entry.score_mean, "z.2f"), mark, shade, name + "; ".join(parts))


def _cautions(board: Board, policy: str) -> list[tuple[str, str]]:
    """Return cautions about a board's scores of a policy: a word and a sentence each."""
    cautions = [("not a result", f"{board.name} is not a result: {board.flag}.")] if board.flag else []
    if board.has_one_seed:
        cautions.append(("one seed", "One seed ranks no methods."))
    if policy == "pi_R" and board.tie:
        says = "This cannot show whether a reward was learned."
        cautions.append(("controls tie", f"An uninformed control does as well: {board.tie}. {says}"))
    failed = [e.method for e in board.entries if e.policy == policy and e.status == "failed"]
    if failed:
        cautions.append((f"{len(failed)} failed", f"Seeds failed of {', '.join(dict.fromkeys(failed))}."))
    return cautions
