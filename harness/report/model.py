"""The report of a run as one value, computed once from rows and results."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import Entry, by_shown, is_on, leaderboard, scored_rows, shown_in
from harness.judge.roles import ASKS, UNINFORMED
from harness.records import NOMINAL, CellResult, Row, Shown
from harness.report import facts
from harness.report.columns import METHOD, POLICY
from harness.report.tables import Column, Table, Value, interval, number
from harness.store.request import Request

MOST_LINES = 3000
"""Lines of leaderboards on the page and in leaderboard.md, by whole boards."""
MANY_ROWS = 20_000
"""Rows of a run from which on it has fewer figures."""
MOST_DRAWN, MOST_DRAWN_OF_MANY = 100, 6
"""Boards that have figures."""
MOST_PANELS, MOST_PANELS_OF_MANY = 60, 12
"""Panels in the curves of a board."""
OVERALL = (
    METHOD,
    POLICY,
    Column("envs", "Environments", "The number of environments.", lambda x: number(x.envs, ".0f")),
    Column("runs", "Runs", "Scores: environments times seeds.", lambda x: number(x.runs, ".0f")),
    Column(
        "middle",
        "Interquartile mean",
        "Mean of the middle half of all runs; interval of the stratified bootstrap (Agarwal et al. 2021).",
        lambda x: interval(x.score, x.low, x.high),
        "interval",
    ),
    Column("below", "Runs below 0.95", "Share of the runs.", lambda x: Value(f"{x.below:.0%}", x.below)),
)


@dataclass(frozen=True)
class Standing:
    """The order of methods on a board by one policy.

    `ranked`: methods with a score, best first. `best`: the method that others are compared with.
    `tied`: methods that are not significantly worse. `apart`: methods that share no seed with the best.
    """

    ranked: Sequence[Entry]
    best: Entry | None
    tied: Sequence[Entry]
    apart: Sequence[Entry]


@dataclass(frozen=True)
class Board:
    """Entries that are compared with each other, best first, their rows, and their cells' results in the
    same order. `flag`: why they are not a result, empty where they are."""

    name: str
    entries: Sequence[Entry]
    rows: Sequence[Row]
    results: Sequence[CellResult]
    flag: str

    @property
    def env(self) -> str:
        """The environment."""
        return self.entries[0].env

    @property
    def is_nominal(self) -> bool:
        """True where the dynamics are the environment's own."""
        return self.entries[0].dynamics == NOMINAL

    @property
    def shown(self) -> Shown:
        """The demonstrations that its methods see."""
        return self.entries[0].shown

    @property
    def methods(self) -> list[str]:
        """Names of methods, then of controls, then the reference."""
        return list(dict.fromkeys(entry.method for entry in self.entries))

    @property
    def has_one_seed(self) -> bool:
        """True where no method has a second seed, and so none can be ranked."""
        return max((e.seeds_ok for e in self.entries if e.role in ("method", ASKS)), default=0) == 1

    @property
    def uninformed(self) -> Entry | None:
        """The uninformed control whose pi_R scores most, where there is one."""
        scored = [e for e in self.scored("pi_R") if e.role in UNINFORMED]
        return max(scored, key=lambda e: e.score_mean, default=None)

    @property
    def tie(self) -> str:
        """The uninformed control that does about as well as the best method, in words; else empty."""
        return indistinct(self.entries).get(self.env, "")

    def scored(self, policy: str) -> list[Entry]:
        """Return the entries of this policy that have a score."""
        return [e for e in self.entries if e.policy == policy and math.isfinite(e.score_mean)]

    def standing(self, policy: str) -> Standing:
        """Return how methods stand by this policy."""
        mine = [e for e in self.entries if e.policy == policy]
        ranked = sorted((e for e in self.scored(policy) if e.role == "method"), key=lambda e: -e.score_mean)
        best = next((e for e in mine if e.best), None)
        return Standing(ranked, best, [e for e in mine if e.tied], [e for e in mine if e.incomparable])


@dataclass(frozen=True)
class Across:
    """Comparison over environments. `rows`: those that are compared. `without`: reasons to leave environments
    out. `notes`: lines on the choice. `table`: a policy each, best first."""

    rows: Sequence[Row]
    without: Mapping[str, str]
    notes: Sequence[str]
    table: Table


@dataclass(frozen=True)
class Report:
    """The content of a report.

    `entries`: lines of all boards. `shown`: boards on the page. `drawn`: boards that have figures.
    `panels`: the most curves of a board. `facts`, `warnings`, `origins`: lines on the run.
    """

    request: Request
    results: Sequence[CellResult]
    rows: Sequence[Row]
    entries: Sequence[Entry]
    boards: Sequence[Board]
    shown: Sequence[Board]
    drawn: Sequence[Board]
    panels: int
    across: Across
    facts: Sequence[str]
    command: str
    warnings: Sequence[str]
    origins: Sequence[str]
    spent: Table
    recordings: Table

    @property
    def title(self) -> str:
        """The beginning of its title: a warning where a board is not a result."""
        return f"{facts.NO_RESULT}: " if any(board.flag for board in self.shown) else ""

    @property
    def top(self) -> str:
        """The policy that scores 1, in words."""
        return "what the demonstrations return" if self.request.conditions.experts == "none" else "the expert"


def build(request: Request, results: Sequence[CellResult], recorded: Collection[str] = ()) -> Report:
    """Return the report of these results, which may be partial. `recorded`: names of existing recordings."""
    results = sorted(results, key=lambda result: result.cell)
    rows = scored_rows(results)
    entries = leaderboard(rows)
    boards = _boards(entries, rows, results, request)
    shown = _first(boards)
    many = len(rows) > MANY_ROWS
    drawn = shown[: MOST_DRAWN_OF_MANY if many else MOST_DRAWN]
    *lines, command = facts.made(request, results)
    return Report(
        request=request,
        results=results,
        rows=rows,
        entries=entries,
        boards=boards,
        shown=shown,
        drawn=drawn,
        panels=MOST_PANELS_OF_MANY if many else MOST_PANELS,
        across=_across(rows, entries),
        facts=lines + _left_out(len(boards), len(shown), len(drawn)),
        command=command,
        warnings=facts.warnings(results, rows, request.conditions.budget),
        origins=facts.origins(results),
        spent=facts.spent(results),
        recordings=facts.recordings(request, results, rows, recorded),
    )


def _boards(
    entries: Sequence[Entry], rows: Sequence[Row], results: Sequence[CellResult], request: Request
) -> list[Board]:
    by_board: dict[str, list[Entry]] = {}
    by_task: dict[str, tuple[list[Row], list[CellResult]]] = {}
    for entry in entries:
        by_board.setdefault(entry.board, []).append(entry)
    for row in rows:
        by_task.setdefault(row.task, ([], []))[0].append(row)
    for result in results:
        by_task[result.cell.task][1].append(result)
    by_shown_rows = {task: by_shown(mine, lambda row: row) for task, (mine, _) in by_task.items()}
    by_shown_results = {task: by_shown(mine, lambda r: r.rows[0]) for task, (_, mine) in by_task.items()}
    flags = {env: facts.why_no_result(env, request, results) for env in {entry.env for entry in entries}}
    boards = []
    for name, mine in by_board.items():
        task, shown = mine[0].task, mine[0].shown
        place = {method: at for at, method in enumerate(dict.fromkeys(e.method for e in mine))}
        ordered = sorted(by_shown_results[task][shown], key=lambda result: place[result.cell.method])
        boards.append(Board(name, mine, by_shown_rows[task][shown], ordered, flags[mine[0].env]))
    return boards


def _first(boards: Sequence[Board]) -> Sequence[Board]:
    """Return the first boards that have at most `MOST_LINES` lines together, and one at least."""
    lines = accumulate(len(board.entries) for board in boards)
    return boards[: max(1, sum(count <= MOST_LINES for count in lines))]


def _left_out(every: int, shown: int, drawn: int) -> list[str]:
    """Return lines on boards that are not shown, or not drawn."""
    files = "leaderboard.csv has the lines of all, scores.csv their rows"
    lines = [f"the first {shown:,} of {every:,} boards are shown; {files}"] if shown < every else []
    return lines + ([f"figures are of the first {drawn:,} boards"] if drawn < shown else [])


def _across(rows: Sequence[Row], entries: Sequence[Entry]) -> Across:
    """Compare policies across environments, on the boards of the demonstrations that are shown first."""
    nominal = [row for row in rows if row.dynamics == NOMINAL]
    shown = shown_in(nominal)[0]
    compared = [row for row in nominal if is_on(row, shown)]
    without = indistinct([e for e in entries if e.dynamics == NOMINAL and e.shown == shown])
    notes = []
    if len({row.env for row in compared}) > 1:
        notes = [f"{env} is left out: {why}" for env, why in without.items()]
        notes += [f"of boards with {shown}"] * bool(str(shown))
    return Across(compared, without, notes, Table("across", OVERALL, overall(compared, tuple(without))))
