"""Files that a report leaves: those in a run's directory, and figures and tables elsewhere."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

from harness.judge.leaderboard import Entry
from harness.records import COLUMNS, PROGRAM_NAME, Cell
from harness.registry import BadInput, choose
from harness.report import charts, facts, html, pareto
from harness.report.columns import visible
from harness.report.figures import as_file, styled
from harness.report.model import Board, Report
from harness.report.tables import Table, as_csv, escaped, frame_of
from harness.store.files import write_atomic

ENTRY_FIELDS = [field.name for field in dataclasses.fields(Entry)]
FIGURES, TABLES = ("pdf", "svg", "png"), ("tex", "md", "csv")
"""Kinds of files of figures and tables, by the ends of their names."""


def recorded_in(directory: Path) -> list[str]:
    """Return the names of the recordings in a run's directory."""
    try:
        return os.listdir(directory / "recordings")
    except OSError:
        return []


def report_files(report: Report) -> dict[str, str]:
    """Return scores.csv, leaderboard.csv, leaderboard.md and report.html, by name.

    A number that is not known is an empty field, or 'n/a' in tables for people.
    """
    return {
        "scores.csv": _scores_csv(report),
        "leaderboard.csv": as_csv(frame_of(report.entries, ENTRY_FIELDS)),
        "leaderboard.md": _leaderboard_md(report),
        "report.html": html.render(report),
    }


def write_report(directory: Path, report: Report) -> list[Path]:
    """Write the report's files into the directory; return their paths."""
    files = report_files(report)
    for name, content in files.items():
        write_atomic(directory / name, content)
    return [directory / name for name in files]


def figure(report: Report, kind: str, env: str | None = None, cost: str | None = None) -> bytes:
    """Return the file of a figure of scores, on each board or on those of one environment.

    `kind`: one of `FIGURES`. `cost`: a key of `pareto.UNITS`. Scores are drawn against it.
    Raises BadInput for an environment without results, and where nothing has that cost.
    """
    boards = _boards(report, env)
    with styled():
        if cost is None:
            return as_file(charts.scores_figure(boards), kind)
        priced = [board for board in boards if board.is_nominal and pareto.priced(board, cost)]
        if not priced:
            raise BadInput(f"no policy of a method is known to cost {pareto.UNITS[cost]}")
        return as_file(pareto.costs_figure(priced, cost), kind)


def table(report: Report, kind: str, env: str | None = None) -> str:
    """Return the file of a table: the scores on each board, or on those of one environment.

    kind: one of `TABLES`; CSV has all columns of leaderboard.csv. Raises BadInput as `figure`.
    """
    boards = _boards(report, env)
    if kind == "csv":
        return as_csv(frame_of([entry for board in boards for entry in board.entries], ENTRY_FIELDS))
    tables = [Table(board.heading, visible("scores"), board.entries) for board in boards]
    if kind == "tex":
        return "% \\usepackage{booktabs}\n" + "\n".join(one.as_latex() for one in tables)
    return "\n".join(f"## {one.name}\n\n{one.as_markdown()}" for one in tables)


def _boards(report: Report, env: str | None) -> Sequence[Board]:
    envs = dict.fromkeys(board.env for board in report.boards)
    named = choose("env of this run", "all" if env is None else env, envs)
    return [board for board in report.boards if board.env in named]


def _scores_csv(report: Report) -> str:
    """Return the rows, with the conditions, the program and the time of each."""
    cells = {result.cell: result for result in report.results}
    frame = frame_of(report.rows, COLUMNS)
    conditions = report.request.conditions
    frame["budget"], frame["rl"] = conditions.budget, conditions.rl
    mine = [cells[Cell(row.env, row.method, row.seed, row.shown, row.dynamics)] for row in report.rows]
    frame["program"] = [result.origin.get(PROGRAM_NAME, "") for result in mine]
    frame["finished"] = [result.finished for result in mine]
    return as_csv(frame)


def _leaderboard_md(report: Report) -> str:
    """Return scores, rewards and costs of each board, in tables as wide as GitHub shows."""
    parts = [f"# {report.title}Leaderboard\n", _listed([*report.facts, report.command])]
    across = report.across
    if across.table.items or across.notes:
        parts.append(f"## Across environments\n\n{_listed(across.notes)}\n{across.table.as_markdown()}")
    for board in report.shown:
        parts.append(f"## {board.heading}\n")
        tables = [
            Table("scores", visible("scores"), board.entries),
            Table("rewards", visible("rewards"), board.scored("pi_R")),
            Table("costs", visible("costs"), board.entries),
            facts.details("fits", board.results),
        ]
        parts += [one.as_markdown() for one in tables if one.items]
    if report.spent.items:
        parts.append(f"## Where the time went\n\n{report.spent.as_markdown()}")
    parts.append("## Computed with\n\n" + _listed(report.origins))
    return "\n".join(parts)


def _listed(lines: Sequence[str]) -> str:
    return "".join(f"- {escaped(line)}\n" for line in lines)
