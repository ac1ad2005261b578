"""Contents of the reference board, for tables of generated pages."""

from __future__ import annotations

import csv
import functools
from collections.abc import Sequence
from pathlib import Path

from harness.registry import BUILT_IN

ROOT = Path(__file__).parents[2]
BOARDS = ROOT / "results/reference/board"
Row = dict[str, str]
SCORE = ("mean", "low", "high")


@functools.cache
def rows() -> list[Row]:
    """Every computed line of each run's leaderboard.csv, with the run's name as `run`, by task."""
    found = []
    for file in sorted(BOARDS.glob("*/leaderboard.csv")):
        for row in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
            if row["status"] == "ok":
                found.append({**row, "run": file.parent.name})
    tasks = BUILT_IN["env"]
    return sorted(
        found, key=lambda row: (tasks.index(row["env"]), row["dynamics"] != "nominal", row["dynamics"])
    )


def task_of(row: Row) -> str:
    return row["env"] if row["dynamics"] == "nominal" else f"{row['env']}.{row['dynamics']}"


def score(row: Row | None) -> str:
    """Mean and 90 % interval over the seeds whose R* RL solved, and their number where it is not all."""
    if row is None:
        return ""
    if not row["score_mean"]:
        return f"not solved ({float(row['score_unsolved']):z.2f})"
    mean, low, high = (f"{float(row[f'score_{name}']):z.2f}" for name in SCORE)
    some = f", {row['seeds_scored']} of {row['seeds_ok']} seeds" if int(row["unsolved"]) else ""
    return f"{mean}\u00a0[{low},\u00a0{high}]{some}"


def amount(text: str) -> str:
    """A cost, to the unit; '' where it is not known."""
    return f"{float(text):,.0f}" if text else ""


def pairs(its: Sequence[Row]) -> list[tuple[Row, Row | None, Row | None]]:
    """Return three rows of each run, task and method: any row, that of pi* and that of pi_R."""
    found: dict[tuple[str, ...], dict[str, Row]] = {}
    for row in its:
        key = (row["run"], task_of(row), row["method"])
        found.setdefault(key, {})[row["policy"]] = row
    return [(next(iter(p.values())), p.get("pi_star"), p.get("pi_R")) for p in found.values()]


def link(text: str, row: Row) -> str:
    """To the file that it is of, from a page one folder below docs/."""
    return f"[{text}](../../results/reference/board/{row['run']}/leaderboard.csv)"


def table(heading: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    rule = ["---"] * len(heading)
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in (heading, rule, *lines)) + "\n"
