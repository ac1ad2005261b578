"""A run's results in a terminal: lines in plain sentences when it is done, tables when asked."""

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

import rich.table
from rich import box
from rich.console import Console
from rich.text import Text

from harness.judge.across_tasks import NO_BETTER
from harness.judge.leaderboard import Entry
from harness.judge.rows import BESIDE
from harness.judge.statistics import SUCCESS
from harness.registry import BUILT_IN, base
from harness.report.columns import score, visible
from harness.report.facts import NO_RESULT
from harness.report.model import Board, Report, some
from harness.report.tables import without_interval

NAMES = {"pi_star": "pi*", "pi_R": "pi_R"}
"""Policies that methods are compared by, in any encoding."""
FEW_BOARDS = 3
"""Boards that are named one by one."""
LABEL = 10
"""Columns of the word that begins a line."""
UNWRAPPED = 100
"""Columns of tables outside a terminal."""
WITH_INTERVALS = 80
"""Columns that tables need to show the intervals of scores."""
LONGEST_NOTE = 120
ONE_SEED = "one seed ranks no methods"


def closing(report: Report, directory: Path) -> list[str]:
    """Return what was computed, the best methods, where methods of plug-ins stand, what the controls say, and
    where to look. directory: the run's."""
    where = shlex.quote(str(directory))
    places = [f"{directory / 'report.html'}, and scores.csv there"]
    places.append(f"tables: irl-bench report --print {where}")
    if any(result.recordings for result in report.results):
        places.append(f"recordings: irl-bench view {where}")
    plugins = [method for method in report.request.methods if base(method) not in BUILT_IN["method"]]
    lines = {
        "cells": "; ".join([*_counts(report, directory), *_cautions(report)]),
        **{name: _best(report, policy) for policy, name in NAMES.items()},
        "yours": "; ".join(_placed(method, report.boards) for method in plugins),
        "controls": _controls(report.boards),
        "look at": "; ".join(places),
    }
    return [f"{label:{LABEL}}{line}" for label, line in lines.items() if line]


def wrapped(line: str) -> str:
    """Return a line of `closing` within a terminal's width; outside a terminal, the line itself."""
    if not sys.stdout.isatty():
        return line
    width, indent = max(2 * LABEL, shutil.get_terminal_size().columns), " " * LABEL
    return textwrap.fill(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def tables(report: Report) -> list[str]:
    """Return every board as a table of five columns, within the terminal's width or `UNWRAPPED` columns."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else UNWRAPPED
    console = Console(file=io.StringIO(), width=width, color_system=None)
    with console.capture() as capture:
        for board in report.boards:
            flags = [f"{NO_RESULT}: {board.flag}"] * bool(board.flag) + [ONE_SEED] * board.has_one_seed
            console.print("; ".join([board.name, *flags]), markup=False)
            console.print(_table(board.entries, width >= WITH_INTERVALS))
        there = "; in other dynamics 1 is RL on the true reward" if report.request.variants else ""
        console.print(
            f"Score: 0 is a random policy, 1 {report.top}{there}. ns: not significant, and the smallest gap "
            "that these seeds would show. not solved: RL did not solve R*, so pi_R says nothing of R*.",
            markup=False,
        )
    return [line.rstrip() for line in capture.get().splitlines()]


def _table(entries: Sequence[Entry], intervals: bool) -> rich.table.Table:
    table = rich.table.Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    columns = visible("terminal")
    for column in columns:
        is_note, is_whole = column.kind == "note", intervals and column.key == "score"
        title = column.heading if is_whole else column.title
        table.add_column(title, no_wrap=not is_note, overflow="fold" if is_note else "ellipsis")
    for entry in entries:
        texts = {column.key: str(column.read(entry)).replace("π", "pi") for column in columns}
        note = textwrap.shorten(texts.pop("remarks"), LONGEST_NOTE, placeholder=" …")
        short = [t if intervals and key == "score" else without_interval(t) for key, t in texts.items()]
        table.add_row(*map(Text, [*short, note]))
    return table


def _counts(report: Report, directory: Path) -> list[str]:
    """Return how many cells came out how, and under which conditions."""
    own = [result for result in report.results if not any(row.source for row in result.rows)]
    of_cells = [{row.status for row in result.rows} for result in own]
    statuses = Counter(next(s for s in ("failed", "ok", "skipped") if s in of_cell) for of_cell in of_cells)
    missing = len({*report.request.cells} - {result.cell for result in report.results})
    counts = [f"{statuses[name]} {name}" for name in ("ok", "skipped", "failed") if statuses[name]]
    counts += [f"{missing} missing"] if missing else []
    counts += [f"{len(report.results) - len(own)} of a baseline"] if len(report.results) > len(own) else []
    conditions, seeds = report.request.conditions, report.request.seeds
    which = f"seed {seeds[0]}" if len(seeds) == 1 else f"{len(seeds)} seeds"
    lines = [", ".join(counts), f"budget {conditions.budget}, protocol {conditions.protocol}, {which}"]
    if statuses["failed"]:
        lines.append(f"why some failed: {directory / 'run.log'}; --retry-failed tries them again")
    return lines


def _cautions(report: Report) -> list[str]:
    """Return why the numbers are not to be quoted, or methods not to be ranked."""
    flagged = {board.env: board.flag for board in report.boards if board.flag}
    if report.request.conditions.budget == "smoke":
        return [f"{NO_RESULT}: budget smoke only shows that everything runs"]
    why = "an expert misses its bar, or is no better than chance"
    lines = [f"{NO_RESULT} on {some([*flagged])}: {why}"] if flagged else []
    return lines + [ONE_SEED] * all(board.has_one_seed for board in report.boards)


def _best(report: Report, policy: str) -> str:
    """Return which methods have the highest mean by this policy, what differs, and what RL did not solve."""
    boards = report.boards
    known = [(board, best) for board in boards if (best := board.best(policy))]
    says = {board.name: (board.winner(policy), board.equals(policy)) for board, _ in known}
    lines = [f"{name}: {', '.join(filter(None, parts))}" for name, parts in says.items()]
    if len(known) > FEW_BOARDS:
        counts = Counter(best.method for _, best in known)
        often = [f"{method} on {count}" for method, count in counts.most_common()]
        lines = [f"highest mean of {len(known)} boards: {some(often)}"]
    if compared := [line for line in report.across.lines if line.policy == policy and line.beside]:
        apart = [f"{x.method} {x.beside.mean:+.2f}" for x in compared if x.beside and x.beside.is_significant]
        tasks = f"over {len(compared[0].scores)} tasks, beside the other methods' mean"
        least = max((x.beside.detectable for x in compared if x.beside), key=lambda x: (math.isnan(x), x))
        shows = "they cannot show any" if math.isnan(least) else f"{least:.2f} shows"
        lines.append(f"{tasks}: {some(apart) or f'no significant difference ({shows})'}")
    mine = [(board.name, e) for board in boards for e in board.entries if e.policy == policy]
    beside = {(e.method, e.role) for _, e in mine if e.role in BESIDE and e.seeds_ok}
    lines += [f"{method} {role} and is not ranked" for method, role in sorted(beside)]
    if unsolved := [f"{e.method} on {name} ({e.unsolved} of {e.seeds_ok})" for name, e in mine if e.unsolved]:
        lines.append(f"seeds left out, on which RL did not solve R*: {some(unsolved)}")
    return "; ".join(lines) or "no method has a score"


def _placed(method: str, boards: Sequence[Board]) -> str:
    """Return a method's score and rank on each board."""
    places = []
    for board in boards:
        parts = []
        for policy, name in NAMES.items():
            ranked = board.ranked(policy)
            for mine in (e for e in ranked if e.method == method):
                rank = 1 + sum(other.score_mean > mine.score_mean for other in ranked)
                parts.append(f"its {name} scores {score(mine)} and ranks {rank} of {len(ranked)}")
        if method in board.methods:
            places.append(f"on {board.name} {', '.join(parts) or 'it has no score'}")
    return f"{method}: {some(places, '; ') or 'no cell of it is finished'}"


def _controls(boards: Sequence[Board]) -> str:
    """Return whether uninformed rewards do as well as the best method's, and whether RL is up to the task."""
    highest = [(board, top) for board in boards if (top := board.uninformed) and board.best("pi_R")]
    if not highest:
        return "no pi_R to compare with that of an uninformed reward"
    board, top = max(highest, key=lambda pair: pair[1].score_mean)
    line = f"no uninformed reward comes within {NO_BETTER} of the best method's; "
    line += f"the highest: {top.method} {_mean(top)} on {board.name}"
    if ties := [f"{board.name} ({top.method} {_mean(top)})" for board, top in highest if board.tie]:
        line = f"WARNING: an uninformed reward does as well as the best method's on {some(ties)}"
    short = [
        f"{_mean(e)} on {board.name}"
        for board in boards
        for e in board.scored("pi_R")
        if e.role == "upper control" and e.score_mean < SUCCESS and board.is_nominal
    ]
    return f"{line}; RL on the true reward falls short: {some(short)}" if short else line


def _mean(entry: Entry) -> str:
    return without_interval(str(score(entry)))
