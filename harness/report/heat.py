"""The heat map of a report: the scores of methods by board, and cautions about each board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.roles import ASKS
from harness.records import NOMINAL, REFERENCE
from harness.report.columns import INCOMPARABLE, NAMES, NO_SCORE, score
from harness.report.model import Board

MOST_COLUMNS = 16
"""Boards of each group."""
MOST_METHODS = 60
SHADES = 10
BEST, TIED, UNSOLVED = "★", "≈", "†"
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
class Group:
    """Columns of one policy in tasks or in variants. cautions: pairs of a word and a sentence, by column.
    tiles: by column, one for each method of the map."""

    title: str
    boards: Sequence[Board]
    names: Sequence[str]
    cautions: Sequence[Sequence[tuple[str, str]]]
    tiles: Sequence[Sequence[Tile]]


@dataclass(frozen=True)
class HeatMap:
    """Methods by boards. roles: by method, in order. boards_left, methods_left: numbers of those left out."""

    roles: dict[str, str]
    groups: Sequence[Group]
    boards_left: int
    methods_left: int


def heat_map(boards: Sequence[Board]) -> HeatMap:
    """Return the map of these boards. Rows are methods by their mean pi_R, those without one by their mean
    pi_star after them, then controls."""
    entries = {(b.name, e.method, e.policy): e for b in boards for e in b.entries if e.method != REFERENCE}
    roles = _ordered(list(entries.values()))
    methods = list(roles)[:MOST_METHODS]
    tasks, variants = [b for b in boards if b.is_nominal], [b for b in boards if not b.is_nominal]
    names = _short_names(boards)
    groups = []
    for beginning, mine in (("", tasks), ("Transfer: ", variants)):
        for policy, title in NAMES.items():
            drawn = [b for b in mine[:MOST_COLUMNS] if any((b.name, m, policy) in entries for m in methods)]
            tiles = [[_tile(entries.get((b.name, method, policy))) for method in methods] for b in drawn]
            cautions = [_cautions(b, policy) for b in drawn]
            if drawn:
                groups.append(
                    Group(beginning + title, drawn, [names[b.name] for b in drawn], cautions, tiles)
                )
    left = sum(max(0, len(mine) - MOST_COLUMNS) for mine in (tasks, variants))
    return HeatMap({m: roles[m] for m in methods}, groups, left, len(roles) - len(methods))


def _ordered(entries: Sequence[Entry]) -> dict[str, str]:
    """Return the role of each method, in the order of the map's rows."""
    roles = {entry.method: entry.role for entry in entries}
    scores: dict[tuple[str, str], list[float]] = {}
    for entry in entries:
        if entry.dynamics == NOMINAL and math.isfinite(entry.score_mean):
            scores.setdefault((entry.method, entry.policy), []).append(entry.score_mean)

    def place(method: str) -> tuple[int | float | str, ...]:
        section = {"method": 0, ASKS: 1}.get(roles[method], 2)
        mine = [scores.get((method, policy), [-math.inf]) for policy in ("pi_R", "pi_star")]
        return section, *(-sum(values) / len(values) for values in mine), method

    return {method: roles[method] for method in sorted(roles, key=place)}


def anchor(board: str) -> str:
    """Return the id of a board's part of the page."""
    return "board-" + board.replace(" ", "_")


def _short_names(boards: Sequence[Board]) -> dict[str, str]:
    """Return the boards' names without the parts that all of them share."""
    same_demos = len({b.shown for b in boards}) == 1
    one_env = len({b.env for b in boards}) == 1
    names = {}
    for board in boards:
        first = board.entries[0]
        task = first.dynamics if one_env and not board.is_nominal else first.task
        names[board.name] = task if same_demos or not str(board.shown) else f"{task}, {board.shown}"
    return names


def _tile(entry: Entry | None) -> Tile:
    if entry is None:
        return Tile()
    name = f"{entry.method}, {NAMES[entry.policy]}, {entry.board}: "
    if not math.isfinite(entry.score_mean):
        reason = " ".join(entry.note.split())[:LONGEST_REASON] or NO_SCORE
        return Tile("failed" if entry.status == "failed" else "none", tip=name + reason)
    parts = [f"{score(entry)}, {entry.seeds_ok} of {entry.seeds} seeds"]
    parts += ["interval over episodes"] * (entry.varies == "episodes")
    mark = BEST if entry.best else TIED if entry.tied else ""
    parts += [{BEST: "the best", TIED: "not significantly worse than the best"}[mark]] if mark else []
    parts += [f"{INCOMPARABLE} with the best"] * entry.incomparable
    if entry.unsolved:
        mark += UNSOLVED
        parts.append(f"RL solved R* on {as_text(entry.solved, '.0%')} of seeds")
    shade = round(SHADES * min(1.0, max(0.0, entry.score_mean)))
    return Tile(as_text(entry.score_mean, "z.2f"), mark, shade, name + "; ".join(parts))


def _cautions(board: Board, policy: str) -> list[tuple[str, str]]:
    """Return cautions about a board's scores of a policy: a word and a sentence each."""
    cautions = [("not a result", f"{board.name} is not a result: {board.flag}.")] if board.flag else []
    if {e.varies for e in board.entries} <= {"episodes", ""}:
        over = "One seed: intervals are over its episodes, and say nothing of another seed."
        cautions.append(("one seed", over))
    if policy == "pi_R" and board.tie:
        says = (
            f"An uninformed control does as well: {board.tie}. This cannot show whether a reward was learned."
        )
        cautions.append(("controls tie", says))
    failed = [e.method for e in board.entries if e.policy == policy and e.status == "failed"]
    if failed:
        cautions.append((f"{len(failed)} failed", f"Seeds failed of {', '.join(dict.fromkeys(failed))}."))
    return cautions


def winners(board: Board) -> str:
    """Return which methods are best on a board, in a sentence; an empty text where none has a score."""
    parts = []
    for policy, name in NAMES.items():
        standing = board.standing(policy)
        if standing.best:
            tied, apart = len(standing.tied), len(standing.apart)
            counts = [f"{tied} other{'s' * (tied > 1)} not significantly worse"] * bool(tied)
            counts += [f"{apart} with {INCOMPARABLE}"] * bool(apart)
            others = f" ({', '.join(counts)})" if counts else ""
            parts.append(f"best {name} {standing.best.method} {score(standing.best)}{others}")
    return f"{board.name}: {'; '.join(parts)}" if parts else ""
