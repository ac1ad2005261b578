"""Messages on a run, to people and to programs: its results, failures and damaged files."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import TextIO

from harness.api.running import MOST_NAMED, Reported, tell_unusable
from harness.judge import effort
from harness.records import CellResult
from harness.schedule.progress import say, tell


@contextmanager
def for_programs(asked: bool) -> Iterator[TextIO | None]:
    """Yield the stream of JSON for programs, standard output, if it is asked for. All text goes to standard
    error until the context ends."""
    if not asked:
        yield None
        return
    programs = sys.stdout
    with redirect_stdout(sys.stderr):
        yield programs


def show(reported: Reported, tables: bool = False, programs: TextIO | None = None) -> None:
    """Print the closing lines of a run, and what it lacks. `tables`: print its tables, too."""
    from harness.report import terminal
    from harness.schedule.events import Reported as Event
    from harness.schedule.events import write

    report = reported.report
    for line in terminal.tables(report) if tables else []:
        say(line)
    say("")
    closing = terminal.closing(report, reported.directory)
    for line in closing:
        say(terminal.wrapped(line))
    if programs:
        failed = [result.cell.name for result in reported.results.values() if result.has_failed]
        write(programs, Event(directory=str(reported.directory), failed=failed, found=closing))
    if reported.missing:
        say(f"not computed yet, or gone: {_first(reported.missing)}")
    tell_unusable(reported.damaged, "damaged")


def _first(names: Sequence[str]) -> str:
    return names[0] + (f" and {len(names) - 1} more" if names[1:] else "")


def tell_troubles(results: Sequence[CellResult], budget: str, beside: Iterable[CellResult] = ()) -> bool:
    """Print warnings and failures to standard error. Return whether any cell failed.

    `beside`: the results of a baseline.
    """
    warned = dict[str, list[str]]()
    for name, warning in [(result.cell.name, warning) for result in results for warning in result.warnings]:
        of_cell = warning.removeprefix(f"{name}: ")
        warned.setdefault(of_cell, []).extend([name] if of_cell != warning else [])
    warnings = [f"{_first(names)}: {text}" if names else text for text, names in warned.items()]
    for warning in [*warnings, *effort.warnings([*results, *beside], budget)]:
        tell(f"WARNING: {warning}")
    failed = dict[str, list[str]]()
    for result in [result for result in results if result.has_failed]:
        reason = next(row.reason for row in result.rows if row.status == "failed")
        failed.setdefault(reason, []).append(result.cell.name)
    for reason, names in [*failed.items()][:MOST_NAMED]:
        tell(f"FAILED: {_first(names)}: {reason}")
    if len(failed) > MOST_NAMED:
        tell(f"FAILED: {len(failed) - MOST_NAMED} more reasons, which are in scores.csv")
    return bool(failed)
