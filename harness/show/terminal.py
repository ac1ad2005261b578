"""What a terminal shows of a run's results: five lines when it is done, tables of five columns when asked."""

from __future__ import annotations

import io
import math
import shlex
import shutil
import sys
import textwrap
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from harness.judge.across_tasks import GOOD, NO_BETTER
from harness.judge.leaderboard import (
    Entry,
    leaderboard,
    scored_rows,
)
from harness.judge.numbers import as_text
from harness.judge.results import NOMINAL, CellResult, Request
from harness.judge.roles import ASKS, UNINFORMED
from harness.show.facts import NO_RESULT
from harness.show.tables import INCOMPARABLE

HEADINGS = ("Method", "Policy", "Score", "Behind best", "Note")
NAMES = {"pi_star": "pi*", "pi_R": "pi_R"}
"""Policies that methods are compared by."""
FEW_BOARDS, FEW_NAMES = 3, 4
"""Up to so many boards are told one by one, and so many names of each list."""
LABEL = 10
"""Columns of what begins a line."""
UNWRAPPED = 100
"""Columns of tables where there is no terminal."""
WITH_INTERVALS = 80
"""Columns that tables need to show the intervals of scores."""
LONGEST_NOTE = 120
ONE_SEED = "one seed ranks no methods"
UNSOLVED = "RL did not solve R* on every seed, which says nothing about the reward"

Boards = dict[str, list[Entry]]
"""Entries that are compared with each other, by the board's name."""


def found(request: Request, results: Sequence[CellResult], directory: Path) -> list[str]:
    """Five lines: what was computed, the best pi* and pi_R, what the controls say of them, where to look.
    results: of the run, and those that it is shown beside. directory: the run's."""
    boards, where = _boards(results), shlex.quote(str(directory))
    places = [
        f"{directory / 'report.html'}, and scores.csv there",
        f"tables: irl-bench report --print {where}",
    ]
    if any(result.recordings for result in results):
        places.append(f"recordings: irl-bench view {where}")
    lines = {
        "cells": "; ".join([*_counts(request, results, directory), *_cautions(request, results, boards)]),
        "pi*": _best(boards, "pi_star"),
        "pi_R": _best(boards, "pi_R"),
        "controls": _controls(boards),
        "look at": "; ".join(places),
    }
    return [f"{label:{LABEL}}{line}" for label, line in lines.items()]


def wrapped(line: str) -> str:
    """A line of `found` within a terminal's width; as it is where there is none."""
    if not sys.stdout.isatty():
        return line
    width = max(2 * LABEL, shutil.get_terminal_size().columns)
    indent = " " * LABEL
    return textwrap.fill(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def tables(request: Request, results: Sequence[CellResult]) -> list[str]:
    """Every board as a table of five columns, in lines within the width of the terminal, or of `UNWRAPPED`
    columns."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else UNWRAPPED
    console = Console(file=io.StringIO(), width=width, color_system=None)
    with console.capture() as capture:
        for name, entries in _boards(results).items():
            flags = [f"{NO_RESULT}: budget smoke"] * (request.conditions.budget == "smoke")
            flags += [ONE_SEED] * _has_one_seed(entries)
            console.print("; ".join([name, *flags]), markup=False)
            console.print(_table(entries, width >= WITH_INTERVALS))
        console.print(_glossary(request), markup=False)
    return [line.rstrip() for line in capture.get().splitlines()]


def _table(entries: Sequence[Entry], intervals: bool) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    *numbers, note = HEADINGS
    for heading in numbers:
        with_interval = intervals and heading == "Score"
        table.add_column(f"{heading} [95 %]" if with_interval else heading, no_wrap=True)
    table.add_column(note, overflow="fold")
    for entry in entries:
        table.add_row(*map(Text, _line(entry, intervals)))
    return table


def _glossary(request: Request) -> str:
    top = "what the demonstrations return" if request.conditions.experts == "none" else "the expert"
    there = "; in other dynamics 1 is RL on the true reward" if request.variants else ""
    return (
        f"Score: 0 is a random policy, 1 {top}{there}. tied: not told apart from the best. Where RL did not "
        "solve R*, pi_R says nothing about the reward."
    )


def _line(entry: Entry, intervals: bool) -> tuple[str, str, str, str, str]:
    """In the order of `HEADINGS`."""
    behind = "the best" if entry.best else INCOMPARABLE * entry.incomparable
    if math.isfinite(entry.behind_mean):
        behind = as_text(entry.behind_mean, "z.2f") + (" tied" if entry.tied else "")
    role = {"method": "", ASKS: f"{ASKS}: no rival"}.get(entry.role, entry.role)
    seeds = f"{entry.seeds_ok} of {entry.seeds} seeds" if 0 < entry.seeds_ok < entry.seeds else ""
    unsolved = f"R* solved on {as_text(entry.solved, '.0%')} of seeds" if entry.unsolved else ""
    note = "; ".join(filter(None, [role, seeds, unsolved, entry.note]))
    note = textwrap.shorten(note, LONGEST_NOTE, placeholder=" …")
    return entry.method, NAMES.get(entry.policy, entry.policy), score_of(entry, intervals), behind, note


def _boards(results: Sequence[CellResult]) -> Boards:
    boards: Boards = {}
    for entry in leaderboard(scored_rows(results)):
        boards.setdefault(entry.board, []).append(entry)
    return boards


def score_of(entry: Entry, interval: bool = True) -> str:
    """As '0.98 [0.96, 1.00]', or without the interval; 'n/a' where there is none."""
    known = interval and math.isfinite(entry.score_low)
    within = f" [{as_text(entry.score_low, 'z.2f')}, {as_text(entry.score_high, 'z.2f')}]" if known else ""
    return as_text(entry.score_mean, "z.2f") + within


def _counts(request: Request, results: Sequence[CellResult], directory: Path) -> list[str]:
    """How many cells came out how, and under which conditions."""
    own = [result for result in results if not any(row.source for row in result.rows)]
    statuses = Counter(_status(result) for result in own)
    missing = len({*request.cells} - {result.cell for result in results})
    counts = [f"{statuses[name]} {name}" for name in ("ok", "skipped", "failed") if statuses[name]]
    counts += [f"{missing} missing"] if missing else []
    counts += [f"{len(results) - len(own)} of a baseline"] if len(results) > len(own) else []
    conditions, seeds = request.conditions, request.seeds
    which = f"seed {seeds[0]}" if len(seeds) == 1 else f"{len(seeds)} seeds"
    lines = [", ".join(counts), f"budget {conditions.budget}, protocol {conditions.protocol}, {which}"]
    if statuses["failed"]:
        lines.append(f"why some failed: {directory / 'run.log'}; --retry-failed tries them again")
    return lines


def _cautions(request: Request, results: Sequence[CellResult], boards: Boards) -> list[str]:
    """Why the numbers are none to quote, or to rank methods by."""
    if request.conditions.budget == "smoke":
        return [f"{NO_RESULT}: budget smoke only shows that everything runs"]
    below = list(dict.fromkeys(result.cell.env for result in results if result.below_bar))
    lines = [f"{NO_RESULT} on {_some(below)}: an expert misses its bar"] if below else []
    return lines + [ONE_SEED] * all(map(_has_one_seed, boards.values()))


def _status(result: CellResult) -> str:
    statuses = {row.status for row in result.rows}
    return next(status for status in ("failed", "ok", "skipped") if status in statuses)


def _best(boards: Boards, policy: str) -> str:
    """Which methods are best by this policy, and which are not told apart from those."""
    best = {name: one for name, its in boards.items() if (one := _best_of(its, policy))}
    tied = {name: [e.method for e in boards[name] if e.policy == policy and e.tied] for name in best}
    if len(best) > FEW_BOARDS:
        counts = Counter(method for name, one in best.items() for method in (one.method, *tied[name]))
        often = [f"{method} on {count}" for method, count in counts.most_common()]
        lines = [f"best or not told apart from it, of {len(best)} boards: {_some(often)}"]
    else:
        lines = [f"{name}: {_first(boards[name], one, tied[name])}" for name, one in best.items()]
    asking = {
        e.method
        for its in boards.values()
        for e in its
        if e.role == ASKS and e.policy == policy and e.seeds_ok
    }
    lines += [f"{method} {ASKS} and is no rival" for method in sorted(asking)]
    both = [(name, e) for name, its in boards.items() for e in its if e.policy == policy and e.unsolved]
    unsolved = [f"{e.method} on {name}" for name, e in both]
    lines += [f"{UNSOLVED}: {_some(unsolved)}"] * bool(unsolved)
    return "; ".join(lines) or "no method has a score"


def _first(entries: Sequence[Entry], best: Entry, tied: Sequence[str]) -> str:
    """The best of a board, and those that are not told apart from it."""
    most = max(e.seeds_ok for e in entries)
    seeds = f" ({best.seeds_ok} of {most} seeds)" if best.seeds_ok < most else ""
    apart = [e.method for e in entries if e.policy == best.policy and e.incomparable]
    others = {"not told apart": tied, INCOMPARABLE: apart}
    lists = [f", {title}: {_some(methods)}" for title, methods in others.items() if methods]
    return f"{best.method} {score_of(best)}{seeds}{''.join(lists)}"


def _best_of(entries: Sequence[Entry], policy: str) -> Entry | None:
    """Of one board, the entry that others are compared with; None where no method has a score."""
    return next((e for e in entries if e.best and e.policy == policy), None)


def _has_one_seed(entries: Sequence[Entry]) -> bool:
    return max((e.seeds_ok for e in entries if e.role in ("method", ASKS)), default=0) == 1


def _controls(boards: Boards) -> str:
    """Whether rewards that know nothing do as well as the best method's, and whether RL is up to it."""
    highest, ties, short = dict[str, Entry](), dict[str, Entry](), dict[str, Entry]()
    for name, entries in boards.items():
        trained = [e for e in entries if e.policy == "pi_R" and math.isfinite(e.score_mean)]
        best = _best_of(entries, "pi_R")
        nothing = [e for e in trained if e.role in UNINFORMED]
        if best and nothing:
            highest[name] = max(nothing, key=lambda e: e.score_mean)
            if highest[name].score_mean >= best.score_mean - NO_BETTER:
                ties[name] = highest[name]
        for e in trained:
            if e.role == "upper control" and e.score_mean < GOOD and e.dynamics == NOMINAL:
                short[name] = e
    if not highest:
        return "no pi_R to compare with one of a reward that knows nothing"
    if ties:
        lines = [
            "WARNING: a reward that knows nothing does as well as the best method's on "
            + _some([f"{name} ({e.method} {score_of(e, False)})" for name, e in ties.items()])
        ]
    else:
        name = max(highest, key=lambda name: highest[name].score_mean)
        top = highest[name]
        lines = [
            f"no reward that knows nothing comes within {NO_BETTER} of the best method's; "
            f"the highest: {top.method} {score_of(top, False)} on {name}"
        ]
    if short:
        scores = [f"{score_of(e, False)} on {name}" for name, e in short.items()]
        lines.append(f"RL on the true reward falls short: {_some(scores)}")
    return "; ".join(lines)


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - FEW_NAMES} more" if len(names) > FEW_NAMES else ""
    return ", ".join(names[:FEW_NAMES]) + more
