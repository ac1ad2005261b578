"""Boards: what is compared with each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, islice

from harness.judge.leaderboard import Entry, by_shown, is_on, shown_in
from harness.judge.results import NOMINAL, CellResult, Row, Shown


@dataclass(frozen=True)
class Board:
    """What is compared with each other: lines, and what they are of. flag: why they are no result, '' where
    they are."""

    name: str
    entries: list[Entry]
    rows: list[Row]
    results: list[CellResult]
    flag: str

    @property
    def env(self) -> str:
        return self.entries[0].env

    @property
    def is_nominal(self) -> bool:
        return self.entries[0].dynamics == NOMINAL

    @property
    def shown(self) -> Shown:
        return self.entries[0].shown


def boards_of(
    entries: Sequence[Entry], rows: Sequence[Row], results: Sequence[CellResult], flags: Mapping[str, str]
) -> list[Board]:
    """All of them. flags: by environment."""
    by_name: dict[str, list[Entry]] = {}
    for entry in entries:
        by_name.setdefault(entry.board, []).append(entry)
    by_task: dict[str, tuple[list[Row], list[CellResult]]] = {}
    for row in rows:
        by_task.setdefault(row.task, ([], []))[0].append(row)
    for result in results:
        by_task[result.cell.task][1].append(result)
    of_task = {
        task: (by_shown(its_rows, lambda row: row), by_shown(its_results, lambda result: result.rows[0]))
        for task, (its_rows, its_results) in by_task.items()
    }
    boards = []
    for name, its in by_name.items():
        its_rows, its_results = of_task[its[0].task]
        shown = its[0].shown
        boards.append(Board(name, its, its_rows[shown], its_results[shown], flags[its[0].env]))
    return boards


def first(boards: Sequence[Board], most: int) -> list[Board]:
    """Those that have so many lines together, and one at least."""
    lines = list(accumulate(len(board.entries) for board in boards))
    fit = max(1, sum(count <= most for count in lines))
    return list(islice(boards, fit))


def compared_across(rows: Sequence[Row]) -> tuple[Shown, list[Row]]:
    """What is shown to those that are compared across envs, the first that is shown anywhere; and their rows,
    in dynamics as they are."""
    nominal = [row for row in rows if row.dynamics == NOMINAL]
    shown = shown_in(nominal)[0]
    return shown, [row for row in nominal if is_on(row, shown)]
