"""Contents of the reference boards, for tables of generated pages."""

from __future__ import annotations

import csv
import functools
from collections.abc import Sequence
from pathlib import Path

from harness.registry import BUILT_IN, SPECS

ROOT = Path(__file__).parents[2]
BOARDS = ROOT / "results/reference/board"
Row = dict[str, str]
SCORE = ("mean", "low", "high")


@functools.cache
def rows() -> list[Row]:
    """Every scored line of every run's leaderboard.csv, with the run's name as `run`, by task."""
    found = []
    for file in sorted(BOARDS.glob("*/leaderboard.csv")):
        for row in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
            if row["score_mean"]:
                found.append({**row, "run": file.parent.name})
    tasks = BUILT_IN["env"]
    return sorted(
        found, key=lambda row: (tasks.index(row["env"]), row["dynamics"] != "nominal", row["dynamics"])
    )


def task_of(row: Row) -> str:
    return row["env"] if row["dynamics"] == "nominal" else f"{row['env']}.{row['dynamics']}"


def shown(row: Row) -> str:
    """Return the number of demonstrations, and the choice of their steps."""
    demos = int(row["demos"]) or SPECS[row["env"]].demo_episodes["full"]
    return f"{demos}" if row["every"] == "1" else f"{demos}, 1 step in {row['every']}"


def score(row: Row | None) -> str:
    """Mean and interval, Student's at 95 %; the mean alone of fewer than three seeds."""
    if row is None:
        return ""
    mean, low, high = (row[f"score_{name}"] and f"{float(row[f'score_{name}']):z.2f}" for name in SCORE)
    return f"{mean}\u00a0[{low},\u00a0{high}]" if int(row["seeds_ok"]) > 2 else mean


def amount(text: str) -> str:
    """A cost, to the unit; '' where it is not known."""
    return f"{float(text):,.0f}" if text else ""


def pairs(its: Sequence[Row]) -> list[tuple[Row, Row | None, Row | None]]:
    """Return three rows of each run, task and method: any row, that of pi* and that of pi_R."""
    found: dict[tuple[str, ...], dict[str, Row]] = {}
    for row in its:
        key = (row["run"], row["demos"], row["every"], task_of(row), row["method"])
        found.setdefault(key, {})[row["policy"]] = row
    return [(next(iter(p.values())), p.get("pi_star"), p.get("pi_R")) for p in found.values()]


def link(text: str, row: Row) -> str:
    """To the file that it is of, from a page one folder below docs/."""
    return f"[{text}](../../results/reference/board/{row['run']}/leaderboard.csv)"


def table(heading: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    rule = ["---"] * len(heading)
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in (heading, rule, *lines)) + "\n"
