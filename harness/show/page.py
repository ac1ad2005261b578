"""The page of a report: one file, which opens offline and sends nothing."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from harness.judge.across_tasks import Overall
from harness.judge.leaderboard import Entry
from harness.judge.results import CellResult, Request, Row
from harness.show import charts, curves, facts, profiles, tables
from harness.show.boards import Board
from harness.show.charts import Chart
from harness.show.glossary import MEANINGS
from harness.show.spreadsheet import as_csv
from harness.show.summary import anchor, summary
from harness.show.tables import Table

PAGE, STYLE, SCRIPT = "report.html.j2", "report.css", "report.js"
MOST_LISTED = 1000
"""Warnings and recordings on the page, each."""
FILTERS = ("Task", "Method", "Policy", "Demonstrations", "Dynamics")
WIDE = ("Note", "Episodes by ending")
"""Headings of columns of text that may be long."""


@dataclass(frozen=True)
class Found:
    """What a page is of. boards: those that are shown; drawn: those of them that have charts, of which those
    of curves have `most_panels` plots. made: lines on the run, the last being its command; left_out: on what
    is not shown. across, compared: lines, and rows, that compare policies across environments, but those in
    `without`, of which `apart` says why."""

    request: Request
    results: Sequence[CellResult]
    """By cell."""
    rows: Sequence[Row]
    boards: Sequence[Board]
    drawn: Sequence[Board]
    made: Sequence[str]
    across: Sequence[Overall]
    apart: Sequence[str]
    compared: Sequence[Row]
    without: Collection[str]
    left_out: Sequence[str]
    recorded: Collection[str]
    most_panels: int


def render(found: Found, parts: Mapping[str, str]) -> str:
    """The HTML. parts: its template, style and script, by file name."""
    drawn = _charts(found)
    leaderboard, recordings = _leaderboard(found.boards), _recordings(found)
    packed = {one.name: pack(one.data) for its in drawn.values() for one in its if one.data is not None}
    warnings = facts.warnings(found.results, found.rows, found.request.conditions.budget)
    no_expert = found.request.conditions.experts == "none"
    context = {
        **drawn,
        "tables": _more_tables(found.boards),
        "flag": f"{facts.NO_RESULT}: " if any(board.flag for board in found.boards) else "",
        "flags": {board.name: board.flag for board in found.boards},
        "no_result": facts.NO_RESULT,
        "top": "what the demonstrations return" if no_expert else "the expert",
        "facts": [*found.made[:-1], *found.left_out],
        "command": found.made[-1],
        "map": summary(found.boards),
        "across": tables.of_overall(found.across),
        "apart": found.apart,
        "leaderboard": leaderboard,
        "filters": _choices(leaderboard),
        "meanings": MEANINGS,
        "wide": WIDE,
        "anchor": anchor,
        "anchors": {anchor(chart.title) for name in ("seeds", "transfer") for chart in drawn[name]},
        "signs": charts.policy_signs(),
        "carried": charts.policy_signs("π* carried over", "π_R, trained there on R*"),
        "learning_signs": curves.SIGNS,
        "warnings": _some(warnings, "scores.csv has every row"),
        "recordings": recordings[:MOST_LISTED],
        "more_recordings": max(0, len(recordings) - MOST_LISTED),
        "origins": facts.origins(found.results),
        "spent": facts.spent(found.results),
        "files": Markup(json.dumps(packed).replace("<", "\\u003c")),
        "style": Markup(parts[STYLE]),
        "script": Markup(parts[SCRIPT]),
        "style_hash": _hash(parts[STYLE]),
        "script_hash": _hash(parts[SCRIPT]),
    }
    sections = [(name, title) for name, title, there in _sections(context) if there]
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(parts[PAGE]).render(context, sections=sections)


def _charts(found: Found) -> dict[str, list[Chart]]:
    """By the name that the template has for them."""
    nominal = [board for board in found.drawn if board.is_nominal]
    variants = [board for board in found.drawn if not board.is_nominal]
    by_env: dict[str, list[Entry]] = {}
    for board in found.boards:
        by_env.setdefault(board.env, []).extend(board.entries)
    envs = dict.fromkeys(board.env for board in found.drawn)
    its = {
        "seeds": map(charts.scores, nominal),
        "transfer": map(charts.scores, variants),
        "costs": map(charts.costs, nominal),
        "profiles": profiles.charts(found.compared, [*found.without]),
        "demonstrations": (charts.demonstrations(env, by_env[env]) for env in envs),
        "distances": map(charts.distances, nominal),
        "learning": (curves.learning(board, found.most_panels) for board in found.drawn),
        "training": (curves.training(board, found.most_panels) for board in nominal),
    }
    return {name: [chart for chart in made if chart] for name, made in its.items()}


def _leaderboard(boards: Sequence[Board]) -> Table:
    """All lines, those that are no result noted so."""
    table = tables.of_entries(
        "leaderboard", tables.EVERY, [entry for board in boards for entry in board.entries]
    )
    at = table.headings.index("Note")
    flags = [board.flag for board in boards for _ in board.entries]
    for line, flag in zip(table.lines, flags, strict=True):
        line[at] = "; ".join(filter(None, [f"{facts.NO_RESULT}: {flag}" if flag else "", str(line[at])]))
    return table


def _choices(table: Table) -> dict[str, list[str]]:
    """What the leaderboard can be filtered by."""
    columns = zip(table.headings, zip(*table.lines, strict=True), strict=False)
    return {heading: [*dict.fromkeys(map(str, its))] for heading, its in columns if heading in FILTERS}


def _more_tables(boards: Sequence[Board]) -> list[tuple[str, list[Table]]]:
    """By board, of fits and of how episodes ended."""
    every = [
        (b.name, [facts.details(f"fits {b.name}", b.results), facts.endings(f"endings {b.name}", b.results)])
        for b in boards
    ]
    return [(name, there) for name, its in every if (there := [table for table in its if table.lines])]


def _recordings(found: Found) -> list[tuple[str, str, str, str]]:
    """File, what its policy scored, how all of the policy's episodes ended, and the command that plays it."""
    there = {*found.recorded}
    if not there:
        return []
    scores = {
        (row.env, row.dynamics, row.method, row.seed, row.shown, row.policy): row.normalized_score
        for row in found.rows
    }
    lines = []
    for result in found.results:
        cell = result.cell
        for name in sorted(there & result.recordings.keys()):
            score, ended = math.nan, ""
            for policy, counts in result.endings.items():
                if name.startswith(f"{cell.name}__{policy}."):
                    its = (cell.env, cell.dynamics, cell.method, cell.seed, cell.shown, policy)
                    score = scores.get(its, math.nan)
                    ended = ", ".join(f"{why} {count}" for why, count in counts.items())
            command = f"irl-bench view . --env {cell.env} --method {cell.method}"
            lines.append((name, tables.number(score, "z.2f").text, ended, command))
    compared = [
        (name, "", "all methods on one episode", f"irl-bench view . --env {env} --compare")
        for env in found.request.envs
        if (name := f"{env}__compare.rrd") in there
    ]
    return [*compared, *lines]


def _some(lines: Sequence[str], elsewhere: str) -> list[str]:
    """The first of them, and how many more there are."""
    more = len(lines) - MOST_LISTED
    return [*lines[:MOST_LISTED], *([f"and {more:,} more; {elsewhere}"] if more > 0 else [])]


def _sections(context: Mapping[str, object]) -> list[tuple[str, str, object]]:
    """Id, short title, and whether it is there."""
    return [
        ("leaderboard", "Leaderboard", context["leaderboard"]),
        ("seeds", "Seeds", context["seeds"]),
        ("transfer", "Transfer", context["transfer"]),
        ("cost", "Cost", context["costs"]),
        ("runs", "Profiles", context["profiles"]),
        ("demonstrations", "Demonstrations", context["demonstrations"]),
        ("distances", "Reward distances", context["distances"]),
        ("learning", "Learning curves", context["learning"]),
        ("training", "Training", context["training"]),
        ("more-tables", "Fits and endings", context["tables"]),
        ("recordings", "Recordings", context["recordings"]),
        ("computed", "Computed with", True),
    ]


def _hash(text: str) -> str:
    """As a content security policy names an inline style or script."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def pack(frame: pd.DataFrame) -> str:
    """A CSV of it, compressed, as text."""
    text = as_csv(frame, float_format="%.5g")
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()
