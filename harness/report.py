"""The report of a run, rebuilt from its results alone: scores, leaderboard, figures and one page."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from harness import figures
from harness.files import write_atomic
from harness.keys import program
from harness.leaderboard import Entry, leaderboard, overall, scored_rows
from harness.results import COLUMNS, CellResult, Row

HEADINGS = (
    *("Method", "Role", "Policy", "Seeds ok", "Score [95 %]", "Above best lower control"),
    "Reward's rank correlation with the advantage",
    *("Return [95 %]", "Discounted return", "Seconds", "Env steps", "RL solves", "Note"),
)
OVERALL_HEADINGS = ("Method", "Policy", "Environments", "Runs", "Interquartile mean [95 %]")


def write_report(directory: Path, results: Sequence[CellResult]) -> list[Path]:
    """Writes scores.csv, leaderboard.csv, leaderboard.md, figures/*.png and report.html into `directory`, and
    returns their paths.

    A run may be partial: what is not known is an empty field, 'n/a' in tables for people.
    """
    rows = scored_rows(results)
    entries = leaderboard(rows)
    files: dict[str, bytes | str] = {
        "scores.csv": as_csv(rows, COLUMNS),
        "leaderboard.csv": as_csv(entries, [f.name for f in dataclasses.fields(Entry)]),
    }

    envs = list(dict.fromkeys(entry.env for entry in entries))
    tables = {env: [_cells(entry) for entry in entries if entry.env == env] for env in envs}
    across = [
        [x.method, x.policy, str(x.envs), str(x.runs), _range(x.score, x.low, x.high, ".2f")]
        for x in overall(rows)
    ]
    parts = ["# Leaderboard\n"]
    if across:
        parts.append(f"## Across environments\n\n{_markdown(OVERALL_HEADINGS, across)}")
    parts += [f"## {env}\n\n{_markdown(HEADINGS, table)}" for env, table in tables.items()]
    origins = _origins(results)
    parts.append("## Computed with\n\n" + "".join(f"- {_escaped(line)}\n" for line in origins))
    files["leaderboard.md"] = "\n".join(parts)

    pictures = {}
    for env in envs:
        pictures[env] = figures.draw(
            env,
            [entry for entry in entries if entry.env == env],
            [row for row in rows if row.env == env],
            [result for result in results if result.cell.env == env],
            len(envs),
        )
        files |= {f"figures/{picture.file}": picture.png for picture in pictures[env]}

    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    files["report.html"] = template.from_string(program()["harness/report.html.j2"].decode()).render(
        headings=HEADINGS,
        tables=tables,
        overall_headings=OVERALL_HEADINGS,
        overall=across,
        pictures=pictures,
        endings=_endings(results),
        warnings=_warnings(results, rows),
        origins=origins,
        recordings=[
            (name, f"rerun {shlex.quote(f'recordings/{name}')} --bind 127.0.0.1")
            for name in sorted(name for result in results for name in result.recordings)
            if (directory / "recordings" / name).is_file()
        ],
    )
    for name, content in files.items():
        write_atomic(directory / name, content)
    return [directory / name for name in files]


def as_csv(items: Sequence[Row] | Sequence[Entry], columns: Sequence[str]) -> str:
    """A table of the items, a line each, which a spreadsheet shows as it is."""
    frame = pd.DataFrame([dataclasses.asdict(item) for item in items], columns=list(columns))
    for name in ("reason", "note"):
        if name in frame:  # A spreadsheet would compute what begins like this.
            frame[name] = ["'" + text if text.startswith(tuple("=+-@")) else text for text in frame[name]]
    return frame.to_csv(index=False, lineterminator="\n")


def _number(value: float, spec: str) -> str:
    return format(value, spec) if math.isfinite(value) else "n/a"


def _range(mean: float, low: float, high: float, spec: str) -> str:
    return _number(mean, spec) + (f" [{low:{spec}}, {high:{spec}}]" if math.isfinite(low) else "")


def _cells(entry: Entry) -> list[str]:
    """The entry for people, in the order of HEADINGS."""
    return [
        entry.method,
        entry.role,
        entry.policy,
        f"{entry.seeds_ok} of {entry.seeds}",
        _range(entry.score_mean, entry.score_low, entry.score_high, ".2f"),
        _number(entry.above_best_lower_control, "+.2f") if entry.policy == "pi_R" else "",
        _number(entry.advantage_correlation, ".2f") if entry.policy == "pi_R" else "",
        _range(entry.return_mean, entry.return_low, entry.return_high, ".1f"),
        _number(entry.discounted_mean, ".2f"),
        _number(entry.fit_seconds, ".1f"),
        _number(entry.env_steps, ",.0f"),
        _number(entry.rl_solves, ".0f"),
        " ".join(entry.note.split()),
    ]


def _markdown(headings: Sequence[str], table: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *table]
    return "".join("| " + " | ".join(map(_escaped, line)) + " |\n" for line in lines)


def _escaped(text: str) -> str:
    """For Markdown, in which it is neither table nor HTML nor link."""
    return re.sub(r"([\\|<>&`]|(?<=\])\()", r"\\\1", text)


def _endings(results: Sequence[CellResult]) -> dict[str, list[tuple[str, str, list[tuple[str, int]]]]]:
    """For each env: method, policy, and how many evaluation episodes ended how, over all seeds."""
    counts: dict[tuple[str, str, str], Counter[str]] = {}
    for result in results:
        for name, endings in result.endings.items():
            counts.setdefault((result.cell.env, result.cell.method, name), Counter()).update(endings)
    table: dict[str, list[tuple[str, str, list[tuple[str, int]]]]] = {}
    for (env, method, policy), counter in sorted(counts.items()):
        table.setdefault(env, []).append(
            (method, policy, sorted(counter.items(), key=lambda item: (-item[1], item[0])))
        )
    return table


def _origins(results: Sequence[CellResult]) -> list[str]:
    """The machines and versions that cells were computed with, and how many cells with each."""
    lines = (", ".join(f"{name} {value}" for name, value in result.origin.items()) for result in results)
    return [f"{count} cells: {line}" for line, count in sorted(Counter(lines).items())]


def _warnings(results: Sequence[CellResult], rows: Sequence[Row]) -> list[str]:
    found = [f"{r.cell.name}: {text}" for r in sorted(results, key=lambda r: r.cell) for text in r.warnings]
    unscored = {(r.env, r.seed) for r in rows if r.status == "ok" and math.isnan(r.normalized_score)}
    if len({tuple(result.origin.items()) for result in results}) > 1:
        found.append("the cells were computed on different machines or with different versions, see the end")
    for env, seed in sorted(unscored):
        found.append(f"{env}, seed {seed}: no normalized scores, for want of an expert better than random")
    return found
