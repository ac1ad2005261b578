"""The page of a report: one file, which opens offline and sends nothing."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from harness.judge.leaderboard import Entry
from harness.report import charts, curves, facts, heat, profiles
from harness.report.columns import of_page
from harness.report.figures import Chart, styled
from harness.report.model import Report
from harness.report.spreadsheet import as_csv
from harness.report.tables import Table

PAGE, STYLE, SCRIPT = (
    Path(__file__).with_name(f"page.{kind}").read_text(encoding="utf-8") for kind in ("html.j2", "css", "js")
)
MOST_LISTED = 1000
"""Warnings and recordings on the page, each."""
Section = tuple[str, str, str, Sequence[Chart]]
"""Id, short title, title, and charts of a section."""


def render(report: Report) -> str:
    """Return the page of the report."""
    with styled():
        sections = [section for section in _sections(report) if section[3]]
    every = [_flagged(entry, board.flag) for board in report.shown for entry in board.entries]
    leaderboard = Table("leaderboard", of_page(), every)
    folded = {board.name: _folded(board.name, board.results) for board in report.shown}
    drawn = [chart for *_, its in sections for chart in its]
    shown = [leaderboard, report.across.table, report.spent, report.recordings]
    shown += [chart.table for chart in drawn if chart.table] + [t for its in folded.values() for t in its]
    data = {
        f"{id_} {c.title}": pack(c.data) for id_, _, _, its in sections for c in its if c.data is not None
    }
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(PAGE).render(
        report=report,
        map=heat.heat_map(report.shown),
        winners=list(filter(None, map(heat.winners, [b for b in report.shown if b.is_nominal][:3]))),
        leaderboard=leaderboard,
        flags={board.name: f"{facts.NO_RESULT}: {board.flag}" for board in report.shown if board.flag},
        choices=_choices(leaderboard),
        sections=sections,
        legends={
            "seeds": charts.SIGNS,
            "transfer": charts.CARRIED,
            "cost": charts.SIGNS,
            "learning": curves.SIGNS,
        },
        notes=NOTES,
        folded={name: tables for name, tables in folded.items() if tables},
        recordings=Table("recordings", report.recordings.columns, report.recordings.items[:MOST_LISTED]),
        warnings=_some(report.warnings),
        glossary={column.key: column for table in shown for column in table.columns if table.items},
        anchor=heat.anchor,
        files=Markup(json.dumps(data).replace("<", "\\u003c")),
        style=Markup(STYLE),
        script=Markup(SCRIPT),
        style_hash=_hash(STYLE),
        script_hash=_hash(SCRIPT),
    )


NOTES = {
    "seeds": "Small dots are seeds, markers means, bars 95 % intervals; controls are on grey.",
    "transfer": "0 is the random policy there, 1 RL on the true reward. Dotted: the expert, carried over.",
    "cost": "Upper left is better. The line is the Pareto front: no point off it scores more for as little. "
    "The cost of π_R is that of the fit and of RL on R*.",
    "distances": "A good reward is at the upper left. Squares are controls. At the lower left the reward is "
    "right and the learner did not use it; at the upper right a wrong reward solves the task.",
    "learning": "Steps are those that RL learned from, not checks. True returns of a task have one scale.",
    "training": "Means over seeds, and their range, by iteration.",
}
"""Help with reading the charts of a section."""


def _sections(report: Report) -> list[Section]:
    nominal = [board for board in report.drawn if board.is_nominal]
    variants = [board for board in report.drawn if not board.is_nominal]
    by_env: dict[str, list[Entry]] = {board.env: [] for board in report.drawn}
    for entry in (entry for board in report.shown for entry in board.entries):
        by_env.get(entry.env, []).append(entry)
    across, most = report.across, report.panels

    def each(draw: Callable[..., Chart | None], boards: Iterable[Any], *more: int) -> list[Chart]:
        return [chart for board in boards if (chart := draw(board, *more))]

    by_demonstrations = [charts.demonstrations(env, its) for env, its in by_env.items()]
    return [
        ("seeds", "Seeds", "Scores, seed by seed", each(charts.scores, nominal)),
        ("transfer", "Transfer", "Transfer to other dynamics", each(charts.scores, variants)),
        ("cost", "Cost", "Score against cost", each(charts.costs, nominal)),
        ("runs", "Profiles", "Runs and methods", profiles.charts(across.rows, [*across.without])),
        (
            "demonstrations",
            "Demonstrations",
            "Score against demonstrations",
            list(filter(None, by_demonstrations)),
        ),
        (
            "distances",
            "Reward distances",
            "Distances between rewards, and scores of π_R",
            each(charts.distances, nominal),
        ),
        (
            "learning",
            "Learning curves",
            "Learning curves: RL on R*",
            each(curves.learning, report.drawn, most),
        ),
        ("training", "Training", "Training of the methods", each(curves.training, nominal, most)),
    ]


def _folded(name: str, results: Sequence[Any]) -> list[Table]:
    """Return the tables of fits and of how episodes ended, those that have lines."""
    tables = facts.details(f"fits {name}", results), facts.endings(f"endings {name}", results)
    return [table for table in tables if table.items]


def _flagged(entry: Entry, flag: str) -> Entry:
    """Return the entry with a note that it is not a result, where it is not."""
    note = "; ".join(filter(None, [f"{facts.NO_RESULT}: {flag}", entry.note]))
    return dataclasses.replace(entry, note=note) if flag else entry


def _choices(table: Table) -> dict[str, list[str]]:
    """Return the texts that the leaderboard can be filtered by, by the column's title."""
    columns = [column for column in table.columns if column.kind == "choice"]
    return {
        c.key: [c.title, *dict.fromkeys(str(c.read(item)) for item in table.items)]  # its title, then choices
        for c in columns
    }


def _some(lines: Sequence[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    more = len(lines) - MOST_LISTED
    return [*lines[:MOST_LISTED], *([f"and {more:,} more; scores.csv has every row"] if more > 0 else [])]


def _hash(text: str) -> str:
    """Return the text's digest, as a content security policy names an inline style or script."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def pack(frame: pd.DataFrame) -> str:
    """Return a CSV of the frame, compressed, as text."""
    text = as_csv(frame, float_format="%.5g")
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()
