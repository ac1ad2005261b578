"""The report of a run, rebuilt from its results alone: scores, leaderboard, figures and one page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from operator import attrgetter

import pandas as pd

from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.results import COLUMNS, NOMINAL, PROGRAM_NAME, Cell, CellResult, Request, Row
from harness.show import facts, figures, page
from harness.show.axes import draw_axes
from harness.show.boards import Board, boards_of, compared_across, first
from harness.show.spreadsheet import as_csv
from harness.show.tables import (
    COSTS,
    FIRST,
    RETURNS,
    REWARD,
    Table,
    escaped,
    markdown,
    of_entries,
    of_overall,
)

MOST_LINES = 3000
"""Of leaderboards on the page and in leaderboard.md, by whole boards."""
MANY_ROWS = 20_000
"""Of a run with more of them there are fewer figures."""
MOST_DRAWN, MOST_DRAWN_OF_MANY = 100, 6
"""Boards that have figures."""
MOST_PANELS, MOST_PANELS_OF_MANY = 60, 12
"""Of the curves of a board."""
NARROW = {
    "scores": [heading for heading in FIRST if heading not in ("Task", "Dynamics", "Demonstrations")],
    "rewards": ("Method", *REWARD),
    "costs": ("Method", "Policy", "Return [95 %]", *COSTS),
}
"""Columns of the tables of leaderboard.md: eight at most, as wide as GitHub shows them."""


def report_files(
    request: Request, results: Sequence[CellResult], parts: Mapping[str, str], recorded: Collection[str]
) -> dict[str, bytes | str]:
    """scores.csv, leaderboard.csv, leaderboard.md, figures/*.png and report.html, by name. parts: of the
    last, by file name. recorded: names of the recordings that are there.

    A run may be partial: what is not known is an empty field, 'n/a' in tables for people.
    """
    results = sorted(results, key=lambda result: result.cell)
    rows = scored_rows(results)
    entries = leaderboard(rows)
    envs = dict.fromkeys(entry.env for entry in entries)
    flags = {env: facts.why_no_result(env, request, results) for env in envs}
    every = boards_of(entries, rows, results, flags)
    boards = first(every, MOST_LINES)
    many = len(rows) > MANY_ROWS
    drawn = boards[: MOST_DRAWN_OF_MANY if many else MOST_DRAWN]
    shown, compared = compared_across(rows)
    without = indistinct([e for e in entries if e.dynamics == NOMINAL and e.shown == shown])
    several = len({row.env for row in compared}) > 1
    apart = [f"{env} is left out: {why}" for env, why in without.items()] if several else []
    apart += [f"of boards with {shown}"] if several and str(shown) else []
    found = page.Found(
        request=request,
        results=results,
        rows=rows,
        boards=boards,
        drawn=drawn,
        made=facts.made(request, results),
        across=overall(compared, tuple(without)),
        apart=apart,
        compared=compared,
        without=without,
        left_out=_left_out(every, boards, drawn),
        recorded=recorded,
        most_panels=MOST_PANELS_OF_MANY if many else MOST_PANELS,
    )
    pictures = [picture for board in drawn if (picture := figures.draw_scores(board))]
    by_env: dict[str, list[Entry]] = {env: [] for env in dict.fromkeys(board.env for board in drawn)}
    for entry in entries:
        if entry.env in by_env:
            by_env[entry.env].append(entry)
    for env, its in by_env.items():
        pictures += draw_axes(env, its, f"{facts.NO_RESULT}: {flags[env]}" if flags[env] else "")
    return {
        "scores.csv": _scores_csv(rows, request, results),
        "leaderboard.csv": as_csv(frame_of(entries, [f.name for f in dataclasses.fields(Entry)])),
        "leaderboard.md": leaderboard_md(found),
        "report.html": page.render(found, parts),
        **{f"figures/{picture.file}": picture.png for picture in pictures},
    }


def leaderboard_md(found: page.Found) -> str:
    """The leaderboard as GitHub shows it: of each board scores, rewards and costs."""
    flag = f"{facts.NO_RESULT}: " if any(board.flag for board in found.boards) else ""
    parts = [f"# {flag}Leaderboard\n", _listed([*found.made, *found.left_out])]
    if found.across or found.apart:
        table = of_overall(found.across)
        parts.append(f"## Across environments\n\n{_listed(found.apart)}\n{_told(table)}")
    for board in found.boards:
        title = f"## {board.name}{f': {facts.NO_RESULT}, {board.flag}' if board.flag else ''}\n"
        learned = [e for e in board.entries if e.policy == "pi_R" and math.isfinite(e.score_mean)]
        tables = [
            _narrow("scores", board.entries),
            _narrow("rewards", learned),
            _narrow("costs", board.entries),
            facts.details("fits", board.results),
        ]
        parts.append("\n".join([title, *(_told(table) for table in tables if table.lines)]))
    if (spent := facts.spent(found.results)).lines:
        parts.append(f"## Where the time went\n\n{_told(spent)}")
    parts.append("## Computed with\n\n" + _listed(facts.origins(found.results)))
    return "\n".join(parts)


def _narrow(name: str, entries: Sequence[Entry]) -> Table:
    every = {**FIRST, **RETURNS, **REWARD, **COSTS}
    return of_entries(name, {heading: every[heading] for heading in NARROW[name]}, entries)


def _told(table: Table) -> str:
    return markdown(table.headings, table.lines) if table.lines else ""


def _listed(lines: Sequence[str]) -> str:
    return "".join(f"- {escaped(line)}\n" for line in lines)


def _left_out(every: Sequence[Board], shown: Sequence[Board], drawn: Sequence[Board]) -> list[str]:
    """What of all boards is not shown, or not drawn, a line each."""
    lines = []
    if len(shown) < len(every):
        lines.append(
            f"the first {len(shown):,} of {len(every):,} boards are shown; leaderboard.csv has the lines of "
            "all, scores.csv their rows"
        )
    if len(drawn) < len(shown):
        lines.append(f"figures are of the first {len(drawn):,} boards")
    return lines


def _scores_csv(rows: Sequence[Row], request: Request, results: Sequence[CellResult]) -> str:
    """The rows, with what each was computed under."""
    cells = {result.cell: result for result in results}
    frame = frame_of(rows, COLUMNS)
    conditions = request.conditions
    frame["budget"], frame["rl"] = conditions.budget, conditions.rl
    mine = [cells[Cell(row.env, row.method, row.seed, row.shown, row.dynamics)] for row in rows]
    frame["program"] = [result.origin.get(PROGRAM_NAME, "") for result in mine]
    frame["finished"] = [result.finished for result in mine]
    return as_csv(frame)


def frame_of(items: Sequence[Row] | Sequence[Entry], columns: Sequence[str]) -> pd.DataFrame:
    """Return a table of the items, a line each."""
    return pd.DataFrame(map(attrgetter(*columns), items), columns=list(columns))
