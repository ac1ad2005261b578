"""Messages on a run, to people and to programs: its results, failures and damaged files."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TextIO

from harness.judge import effort
from harness.records import CellResult
from harness.schedule.progress import say, tell
from harness.store.store import Store

MOST_NAMED = 20
"""Files that a line names, but for the first; cells that failed, a line each."""


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


def report(
    run: Store,
    results: list[CellResult],
    anew: bool,
    tables: bool = False,
    programs: TextIO | None = None,
) -> bool:
    """Write the report of these results and print its closing lines. Return whether
    all stored cells are there.

    `anew`: write it even where it is as written. `tables`: print tables, too. `programs`: of `for_programs`.
    """
    from harness.report import terminal
    from harness.report.files import recorded_in, write_report
    from harness.report.model import build
    from harness.schedule.events import Reported, write

    damaged = run.damaged_files(results)
    beside, unusable = run.beside()
    shown = [*results, *beside]
    if anew or not run.is_sealed():
        recorded = [result for result in results if result.learned]
        compared = []
        if recorded and run.request.conditions.record != "none":
            from harness.recordings.ghosts import write_compared  # rerun is 30 MB

            compared = write_compared(run, recorded)
        built = build(run.request, shown, recorded_in(run.path))
        run.seal(results, [*compared, *write_report(run.path, built)])
    else:
        built = build(run.request, shown)
    for line in terminal.tables(built) if tables else []:
        say(line)
    say("")
    closing = terminal.closing(built, run.path)
    for line in closing:
        say(terminal.wrapped(line))
    if programs:
        failed = [result.cell.name for result in results if has_failed(result)]
        write(programs, Reported(directory=str(run.path), failed=failed, found=closing))
    there = {result.cell for result in shown}
    if absent := [cell.name for cell in run.request.cells if cell not in there]:
        say(f"not computed yet, or gone: {absent[0]}{_and_more(absent)}")
    tell_unusable(damaged | unusable, "damaged")
    return not (damaged or unusable)


def _and_more(names: Sequence[str]) -> str:
    return f" and {len(names) - 1} more" if names[1:] else ""


def tell_troubles(results: list[CellResult], budget: str, beside: Sequence[CellResult] = ()) -> bool:
    """Print warnings and failures to standard error. Return whether any cell failed.

    `beside`: the results of a baseline.
    """
    told = [warning for result in results for warning in result.warnings]
    for warning in dict.fromkeys([*told, *effort.warnings([*results, *beside], budget)]):
        tell(f"WARNING: {warning}")
    failed = [result for result in results if has_failed(result)]
    for result in failed[:MOST_NAMED]:
        reason = next(row.reason for row in result.rows if row.status == "failed")
        tell(f"FAILED: {result.cell.name}: {reason}")
    if len(failed) > MOST_NAMED:
        tell(f"FAILED: {len(failed) - MOST_NAMED} more, whose reasons are in scores.csv")
    return bool(failed)


def tell_unusable(files: dict[Path, str], what_happens: str) -> None:
    """Print a line for each reason."""
    by_reason: dict[str, list[Path]] = {}
    for path, reason in sorted(files.items()):
        by_reason.setdefault(reason, []).append(path)
    for reason, (first, *others) in sorted(by_reason.items()):
        names = ", ".join([str(first), *(path.name for path in others[:MOST_NAMED])])
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        tell(f"{what_happens}: {names}{more}: {reason}")


def has_failed(result: CellResult) -> bool:
    return any(row.status == "failed" for row in result.rows)
