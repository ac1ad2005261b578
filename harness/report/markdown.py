"""Tables and the leaderboard in Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from harness.report import facts
from harness.report.columns import visible
from harness.report.model import Board, Report
from harness.report.tables import Table


def leaderboard_md(report: Report) -> str:
    """Return leaderboard.md: scores, rewards and costs of each board, in tables as wide as GitHub shows."""
    parts = [f"# {report.title}Leaderboard\n", _listed([*report.facts, report.command])]
    across = report.across
    if across.table.items or across.notes:
        parts.append(f"## Across environments\n\n{_listed(across.notes)}\n{as_markdown(across.table)}")
    parts += map(_board, report.shown)
    if report.spent.items:
        parts.append(f"## Where the time went\n\n{as_markdown(report.spent)}")
    parts.append("## Computed with\n\n" + _listed(report.origins))
    return "\n".join(parts)


def _board(board: Board) -> str:
    learned = [e for e in board.scored("pi_R") if math.isfinite(e.score_mean)]
    tables = [
        Table("scores", visible("scores"), board.entries),
        Table("rewards", visible("rewards"), learned),
        Table("costs", visible("costs"), board.entries),
        facts.details("fits", board.results),
    ]
    title = f"## {board.name}{f': {facts.NO_RESULT}, {board.flag}' if board.flag else ''}\n"
    return "\n".join([title, *filter(None, map(as_markdown, tables))])


def as_markdown(table: Table) -> str:
    """Return the table; an empty text where it has no line."""
    if not table.items:
        return ""
    texts = [[_escaped(str(value)) for value in line] for line in table.lines()]
    lines = [table.headings, ["---"] * len(table.columns), *texts]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def _escaped(text: str) -> str:
    """Return the text for Markdown, where it is neither table nor HTML nor link nor emphasis."""
    return re.sub(r"([\\|<>&`*]|(?<=\])\()", r"\\\1", text)


def _listed(lines: Sequence[str]) -> str:
    return "".join(f"- {_escaped(line)}\n" for line in lines)
