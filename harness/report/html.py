"""The page of a report: one file, which opens offline and sends nothing."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from harness.judge.leaderboard import Entry
from harness.report import charts, curves, facts, heat, pareto
from harness.report.columns import ENTRY, NAMES
from harness.report.figures import Chart, styled
from harness.report.model import Board, Report
from harness.report.tables import LEVEL, Table, as_csv

PAGE, STYLE, SCRIPT = (
    Path(__file__).with_name(f"page.{kind}").read_text(encoding="utf-8") for kind in ("html.j2", "css", "js")
)
STYLE += "".join(
    f".h{shade} {{ background: color-mix(in srgb, var(--heat) {2 + 5.5 * shade}%, var(--bg)); }}\n"
    for shade in range(heat.SHADES + 1)
)
MOST_LISTED = 1000
"""Warnings and recordings on the page, each."""
Sign = tuple[int, str, str]


@dataclass(frozen=True)
class Section:
    """Charts of one kind. `id`: its anchor. `link`: a short title."""

    id: str
    link: str
    title: str
    charts: Sequence[Chart]
    legend: Sequence[Sign] = ()

    @property
    def note(self) -> str:
        """Help with reading them."""
        return NOTES.get(self.id, "")

    @property
    def choices(self) -> list[str]:
        """Names of its plots, where a switch shows one of each chart."""
        return list(dict.fromkeys(name for chart in self.charts for name in chart.choices))


NOTES = {
    "seeds": f"Small dots are seeds, markers means, bars {LEVEL} intervals; controls are on grey. Hollow: RL "
    "did not solve R*, so the score says nothing about it.",
    "transfer": "0 is the random policy there, 1 RL on the true reward. Dotted: the expert, carried over.",
    "cost": "Upper left is better. The line is the Pareto front: no point off it scores more for as little. "
    "The cost of π_R is that of the fit and of RL on R*. Interactions include the steps that judge "
    "checkpoints of RL; environment steps do not.",
    "equal": "Markers: π*, once it is fitted. Lines: π_R, which is the checkpoint with the highest return "
    "under R* so far, on the episodes that check checkpoints. Interactions are all of the fit and of RL, "
    "with these checks. Means over all seeds.",
    "distances": "A good reward is at the upper left. Squares are controls. At the lower left the reward is "
    "right and the learner did not use it; at the upper right a wrong reward solves the task.",
    "learning": "Interactions are steps that RL learned from, and those that checked its checkpoints, spread "
    "evenly. Scores of a task have one scale.",
    "profiles": f"Shares of runs that reach a score, over environments that count, with {LEVEL} intervals.",
    "training": "Means over seeds, and their range, by iteration.",
}


def render(report: Report) -> str:
    """Return the page of the report."""
    with styled():
        sections = [section for section in _sections(report) if section.charts]
    lines = [_flagged(entry, board.flag) for board in report.shown for entry in board.entries]
    columns = [column for column in ENTRY if column.places != "terminal"]
    leaderboard = Table("leaderboard", columns, lines)
    folded = {
        board.name: [
            table
            for table in (
                facts.details(f"fits {board.name}", board.results),
                facts.endings(f"endings {board.name}", board.results),
            )
            if table.items
        ]
        for board in report.shown
    }
    drawn = [chart for section in sections for chart in section.charts]
    tables = [leaderboard, report.across.table, report.spent, report.recordings]
    tables += [chart.table for chart in drawn if chart.table]
    tables += [table for mine in folded.values() for table in mine]
    more = len(report.warnings) - MOST_LISTED
    left_out = [f"and {more:,} more; scores.csv has every row"] if more > 0 else []
    choices = {
        column: dict.fromkeys(str(column.read(item)) for item in lines)
        for column in columns
        if column.kind == "choice"
    }
    data = {f"{s.id} {c.title}": _packed(c) for s in sections for c in s.charts if c.data is not None}
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(PAGE).render(
        report=report,
        map=heat.heat_map(report.shown),
        leaderboard=leaderboard,
        choices=choices,
        flags={board.name: f"{facts.NO_RESULT}: {board.flag}" for board in report.shown if board.flag},
        sections=sections,
        folded={name: its for name, its in folded.items() if its},
        recordings=dataclasses.replace(report.recordings, items=report.recordings.items[:MOST_LISTED]),
        warnings=[*report.warnings[:MOST_LISTED], *left_out],
        glossary={column.key: column for table in tables for column in table.columns if table.items},
        anchor=lambda board: "board-" + board.replace(" ", "_"),
        files=Markup(json.dumps(data).replace("<", "\\u003c")),
        style=Markup(STYLE),
        script=Markup(SCRIPT),
        style_hash=_hash(STYLE),
        script_hash=_hash(SCRIPT),
    )


def _sections(report: Report) -> list[Section]:
    nominal = [board for board in report.drawn if board.is_nominal]
    variants = [board for board in report.drawn if not board.is_nominal]
    by_env: dict[str, list[Entry]] = {board.env: [] for board in report.drawn}
    for entry in (entry for board in report.shown for entry in board.entries):
        by_env.get(entry.env, []).append(entry)
    by_demonstrations = [charts.demonstrations(env, mine) for env, mine in by_env.items()]
    most = report.panels

    def each(draw: Callable[..., Chart | None], boards: Sequence[Board], *more: int) -> list[Chart]:
        return [chart for board in boards if (chart := draw(board, *more))]

    profiles = [chart for policy in NAMES if (chart := charts.profiles(report.across.lines, policy))]
    scores, carried = each(charts.scores, nominal), each(charts.scores, variants)
    costs, distances = each(pareto.costs, nominal), each(charts.distances, nominal)
    learning, training = each(curves.learning, report.drawn, most), each(curves.training, nominal, most)
    distant = "Distances between rewards, and scores of π_R"
    shown = [chart for chart in by_demonstrations if chart]
    return [
        Section("profiles", "Profiles", "Performance profiles over environments", profiles),
        Section("seeds", "Seeds", "Scores, seed by seed", scores, charts.SIGNS),
        Section("transfer", "Transfer", "Transfer to other dynamics", carried, charts.CARRIED),
        Section("cost", "Cost", "Score against cost", costs, charts.SIGNS),
        Section("equal", "Equal interactions", "Score after equal interactions", each(pareto.equal, nominal)),
        Section("demonstrations", "Demonstrations", "Score against demonstrations", shown),
        Section("distances", "Reward distances", distant, distances),
        Section("learning", "Learning curves", "Learning curves: RL on R*", learning, curves.SIGNS),
        Section("training", "Training", "Training of the methods", training),
    ]


def _flagged(entry: Entry, flag: str) -> Entry:
    """Return the entry with a note that it is not a result, where it is not."""
    note = "; ".join(filter(None, [f"{facts.NO_RESULT}: {flag}", entry.note]))
    return dataclasses.replace(entry, note=note) if flag else entry


def _hash(text: str) -> str:
    """Return the text's digest, as a content security policy names an inline style or script."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _packed(chart: Chart) -> str:
    """Return a CSV of the chart's data, compressed, as text."""
    assert chart.data is not None
    text = as_csv(chart.data, float_format="%.5g")
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()
