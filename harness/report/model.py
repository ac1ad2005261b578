"""The report of a run as one value, computed once from rows and results."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from harness.judge.across_tasks import Overall, indistinct, overall
from harness.judge.comparisons import ALPHA, POWER, detectable
from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.numbers import as_text
from harness.judge.rows import BESIDE, UNINFORMED, by_shown, is_on, shown_in
from harness.judge.statistics import SUCCESS
from harness.records import NOMINAL, CellResult, Row
from harness.report import facts
from harness.report.columns import INCOMPARABLE, METHOD, NAMES, POLICY, difference, score
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
FEW_NAMES = 4
"""Names of a list in a sentence."""
OVERALL = (
    METHOD,
    POLICY,
    Column("envs", "Environments", "The number of environments.", lambda x: number(len(x.scores), ".0f")),
    Column("runs", "Runs", "Scores: environments times seeds.", lambda x: number(x.runs, ".0f")),
    Column(
        "middle",
        "Interquartile mean",
        "Mean of the middle half of all runs; interval of the stratified bootstrap (Agarwal et al. 2021).",
        lambda x: interval(x.score, x.low, x.high),
        "interval",
    ),
    Column("reached", f"Reach {SUCCESS}", "Share of the runs.", lambda x: number(x.reached, ".0%")),
    Column(
        "unsolved",
        "Not solved",
        "Seeds left out, whose reward RL did not solve.",
        lambda x: number(x.unsolved, ".0f"),
    ),
    Column(
        "beside",
        "Beside the others",
        "Mean over tasks of the difference to the other methods' mean, by permutation of methods within task "
        "and seed, adjusted for the number of methods (Holm 1979). 'ns': not significant; in parentheses the "
        f"smallest difference that would have been found with power {POWER}.",
        lambda x: difference(x.beside.mean, x.beside.p, x.beside.detectable) if x.beside else Value(""),
    ),
    Column(
        "better_than",
        "Better than",
        "Methods with a significantly lower score, pair by pair over all tasks and seeds (Holm 1979).",
        lambda x: ", ".join(x.better_than),
        "text",
    ),
)


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
    def heading(self) -> str:
        """The name, with the flag if there is one."""
        return f"{self.name}: {facts.NO_RESULT}, {self.flag}" if self.flag else self.name

    @property
    def is_nominal(self) -> bool:
        """True where the dynamics are the environment's own."""
        return self.entries[0].dynamics == NOMINAL

    @property
    def methods(self) -> list[str]:
        """Names of methods, then of controls, then the reference."""
        return list(dict.fromkeys(entry.method for entry in self.entries))

    @property
    def has_one_seed(self) -> bool:
        """True where no method has a second seed, and so none can be ranked."""
        return max((e.seeds_ok for e in self.entries if e.role in ("method", *BESIDE)), default=0) == 1

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

    def ranked(self, policy: str) -> list[Entry]:
        """Return the scored methods by this policy, best first."""
        return sorted((e for e in self.scored(policy) if e.role == "method"), key=lambda e: -e.score_mean)

    def drawn(self, policy: str) -> list[Entry]:
        """Return the entries of this policy that have a score, or a reward that RL did not solve."""
        return [e for e in self.entries if e.policy == policy and math.isfinite(e.drawn_score)]

    def best(self, policy: str) -> Entry | None:
        """Return the method with the highest mean by this policy."""
        return next((e for e in self.entries if e.policy == policy and e.best), None)

    def winner(self, policy: str) -> str:
        """Return the highest mean by this policy, and which methods are significantly worse, in words; an
        empty text where none has a score."""
        best = self.best(policy)
        if best is None:
            return ""
        most = max(e.seeds_ok for e in self.entries)
        seeds = f" ({best.seeds_scored} of {most} seeds)" if best.seeds_scored < most else ""
        others = [e for e in self.entries if e.policy == policy]
        compared = [e for e in others if math.isfinite(e.behind)]
        lists = {
            "significantly worse": [e.method for e in compared if e.behind_p <= ALPHA],
            INCOMPARABLE: [e.method for e in others if e.incomparable],
        }
        words = [f", {title}: {some(names)}" for title, names in lists.items() if names]
        return f"{best.method} {score(best)}{seeds}{''.join(words)}"

    def equals(self, policy: str) -> str:
        """Return that no method is significantly worse by this policy, with the least that would have shown.
        It is empty where one is, or none is compared."""
        best = self.best(policy)
        compared = [e for e in self.entries if e.policy == policy and math.isfinite(e.behind)]
        if best is None or not compared or any(e.behind_p <= ALPHA for e in compared):
            return ""
        seen, least = math.isfinite(best.detectable), as_text(best.detectable, ".2f")
        shows = f"show {least} or more" if seen else "cannot show any"
        count = min(e.seeds_scored for e in (best, *compared))
        return f"no significant difference ({count} seed{'s' * (count > 1)} {shows})"


@dataclass(frozen=True)
class Across:
    """Comparison over environments. `without`: reasons to leave environments out. `notes`: lines on the
    choice. `lines`: a policy each, best first."""

    without: Mapping[str, str]
    notes: Sequence[str]
    lines: Sequence[Overall]

    @property
    def table(self) -> Table:
        """The lines as a table."""
        return Table("across", OVERALL, self.lines)


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
    lines = accumulate(len(board.entries) for board in boards)
    shown = boards[: max(1, sum(count <= MOST_LINES for count in lines))]
    many = len(rows) > MANY_ROWS
    drawn = shown[: MOST_DRAWN_OF_MANY if many else MOST_DRAWN]
    left_out = []
    if len(shown) < len(boards):
        files = "leaderboard.csv has the lines of all, scores.csv their rows"
        left_out.append(f"the first {len(shown):,} of {len(boards):,} boards are shown; {files}")
    if len(drawn) < len(shown):
        left_out.append(f"figures are of the first {len(drawn):,} boards")
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
        facts=facts.conditions(request, results) + left_out,
        command=facts.command(request, results),
        warnings=facts.warnings(results, rows, request.conditions.budget),
        origins=facts.origins(results),
        spent=facts.spent(results),
        recordings=facts.recordings(request, results, recorded),
    )


def _boards(
    entries: Sequence[Entry], rows: Sequence[Row], results: Sequence[CellResult], request: Request
) -> list[Board]:
    by_board: dict[str, list[Entry]] = {}
    rows_of: dict[str, list[Row]] = {}
    results_of: dict[str, list[CellResult]] = {}
    for entry in entries:
        by_board.setdefault(entry.board, []).append(entry)
    for row in rows:
        rows_of.setdefault(row.task, []).append(row)
    for result in results:
        results_of.setdefault(result.cell.task, []).append(result)
    all_rows = {task: by_shown(mine, lambda row: row) for task, mine in rows_of.items()}
    all_results = {task: by_shown(results_of[task], lambda result: result.rows[0]) for task in rows_of}
    flags = {env: facts.why_no_result(env, request, results) for env in {entry.env for entry in entries}}
    boards = []
    for name, mine in by_board.items():
        task, shown = mine[0].task, mine[0].shown
        place = {method: at for at, method in enumerate(dict.fromkeys(e.method for e in mine))}
        ordered = sorted(all_results[task][shown], key=lambda result: place[result.cell.method])
        boards.append(Board(name, mine, all_rows[task][shown], ordered, flags[mine[0].env]))
    return boards


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
    lines = overall(compared, tuple(without))
    for policy, name in NAMES.items():
        if pairs := [line for line in lines if line.policy == policy and line.comparisons]:
            runs, comparisons = min(line.runs for line in pairs), pairs[0].comparisons
            least = as_text(detectable(runs, comparisons), ".2f")
            notes.append(f"{name}: {runs} runs or more each, {comparisons} pairs; {least} would show in one")
    return Across(without, notes, lines)


def some(names: Sequence[str], between: str = ", ") -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - FEW_NAMES} more" if len(names) > FEW_NAMES else ""
    return between.join(names[:FEW_NAMES]) + more
