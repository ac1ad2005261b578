"""The first screen: a heat map of methods and boards, the best and what is not told apart from it, and what
to beware of on each board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from harness.judge.across_tasks import indistinct
from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.results import NOMINAL, REFERENCE
from harness.judge.roles import ASKS
from harness.show.boards import Board
from harness.show.tables import INCOMPARABLE, NOTHING, score

MOST_COLUMNS = 16
"""Boards of each group."""
MOST_METHODS = 60
SHADES = 10
BEST, TIED, UNSOLVED = "★", "≈", "†"


@dataclass(frozen=True)
class Tile:
    """One policy of a method on a board. shade: 0 for a score of 0 or less, `SHADES` for 1 or more; -1 for
    none. told: what the pointer or the keyboard brings up."""

    text: str
    mark: str
    shade: int
    told: str


@dataclass(frozen=True)
class Warned:
    """short: a few words. long: a sentence."""

    short: str
    long: str


@dataclass(frozen=True)
class Column:
    name: str
    anchor: str
    warned: list[Warned]
    tiles: list[Tile]
    """A tile for each method of the map."""


@dataclass(frozen=True)
class Map:
    """groups: a title, and its columns. methods: names and roles. found: what is best where, a sentence each.
    left: how many boards are left out."""

    methods: list[tuple[str, str]]
    groups: list[tuple[str, list[Column]]]
    found: list[str]
    left: int
    left_methods: int


def summary(boards: Sequence[Board]) -> Map:
    """Of all boards. Rows are methods by their mean pi_R, those without one by their mean pi_star after them,
    then controls."""
    by_line = {(b.name, e.method, e.policy): e for b in boards for e in b.entries if e.method != REFERENCE}
    roles = {e.method: e.role for e in by_line.values()}
    nominal: dict[tuple[str, str], list[float]] = {}
    for entry in by_line.values():
        if entry.dynamics == NOMINAL and math.isfinite(entry.score_mean):
            nominal.setdefault((entry.method, entry.policy), []).append(entry.score_mean)

    def place(method: str) -> tuple[int | float | str, ...]:
        scores = [nominal.get((method, policy), [-math.inf]) for policy in ("pi_R", "pi_star")]
        section = {"method": 0, ASKS: 1}.get(roles[method], 2)
        return section, *(-sum(its) / len(its) for its in scores), method

    every = sorted(roles, key=place)
    methods = every[:MOST_METHODS]
    same = len({b.shown for b in boards}) == 1
    alone = len({b.env for b in boards}) == 1
    tasks = [b for b in boards if b.is_nominal]
    variants = [b for b in boards if not b.is_nominal]
    groups = []
    for title, policy, its in (
        ("π*", "pi_star", tasks),
        ("π_R", "pi_R", tasks),
        ("Transfer: π*", "pi_star", variants),
        ("Transfer: π_R", "pi_R", variants),
    ):
        columns = [
            Column(
                _short(b, same, alone),
                anchor(b.name),
                _warned(b, policy),
                [_tile(by_line.get((b.name, method, policy))) for method in methods],
            )
            for b in its[:MOST_COLUMNS]
            if any((b.name, m, policy) in by_line for m in methods)
        ]
        if columns:
            groups.append((title, columns))
    return Map(
        [(method, roles[method]) for method in methods],
        groups,
        [found for b in tasks[:3] if (found := _found(b))],
        sum(max(0, len(its) - MOST_COLUMNS) for its in (tasks, variants)),
        len(every) - len(methods),
    )


def anchor(board: str) -> str:
    """The id of its part of the page."""
    return "board-" + board.replace(" ", "_")


def _short(board: Board, same: bool, alone: bool) -> str:
    """Its name, without what all have: what is shown, and of variants the environment."""
    task = board.env if board.is_nominal else board.entries[0].dynamics if alone else board.entries[0].task
    return task if same or not str(board.shown) else f"{task}, {board.shown}"


def _tile(entry: Entry | None) -> Tile:
    if entry is None:
        return Tile("", "", -1, "")
    name = f"{entry.method}, {'π*' if entry.policy == 'pi_star' else 'π_R'}, {entry.board}: "
    if not math.isfinite(entry.score_mean):
        why = " ".join(entry.note.split())[:300] or NOTHING
        failed = "failed" if entry.status == "failed" else "none"
        return Tile(failed, "", -1, name + why)
    seeds = f"{entry.seeds_ok} of {entry.seeds} seeds"
    over = "; interval over episodes" if entry.varies == "episodes" else ""
    mark = BEST if entry.best else TIED if entry.tied else ""
    apart = f"; {INCOMPARABLE} with the best" * entry.incomparable
    said = {BEST: "; the best", TIED: "; not told apart from the best", "": apart}[mark]
    shade = round(SHADES * min(1.0, max(0.0, entry.score_mean)))
    if entry.unsolved:
        mark += UNSOLVED
        said += f"; RL solved R* on {as_text(entry.solved, '.0%')} of seeds"
    return Tile(as_text(entry.score_mean, "z.2f"), mark, shade, f"{name}{score(entry)}, {seeds}{over}{said}")


def _warned(board: Board, policy: str) -> list[Warned]:
    """What to beware of on a board."""
    found = [Warned("not a result", f"{board.name} is not a result: {board.flag}.")] if board.flag else []
    if {e.varies for e in board.entries} <= {"episodes", ""}:
        found.append(
            Warned("one seed", "One seed: intervals are over its episodes, and say nothing of another seed.")
        )
    if policy == "pi_R":
        for why in indistinct(board.entries).values():
            found.append(
                Warned(
                    "controls tie",
                    f"A control that knows nothing does as well: {why}. It tells no reward from none.",
                )
            )
    failed = [e.method for e in board.entries if e.policy == policy and e.status == "failed"]
    if failed:
        found.append(Warned(f"{len(failed)} failed", f"Seeds failed of {', '.join(dict.fromkeys(failed))}."))
    return found


def _found(board: Board) -> str:
    """What is best on a board, in a sentence."""
    said = []
    for policy, name in (("pi_star", "π*"), ("pi_R", "π_R")):
        its = [e for e in board.entries if e.policy == policy]
        best = next((e for e in its if e.best), None)
        if best:
            tied, apart = sum(e.tied for e in its), sum(e.incomparable for e in its)
            counts = [f"{tied} other{'s' * (tied > 1)} not told apart"] * bool(tied)
            counts += [f"{apart} with {INCOMPARABLE}"] * bool(apart)
            others = f" ({', '.join(counts)})" if counts else ""
            said.append(f"best {name} {best.method} {score(best)}{others}")
    return f"{board.name}: {'; '.join(said)}" if said else ""
