"""Runs: a request is prepared, its missing cells are computed and stored, and a report is written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from harness.api.preparing import DEFAULT, ISOLATED, Engine, Prepared, prepare
from harness.api.request import RunRequest
from harness.api.results import Results, load
from harness.cell.given import store as store_demonstrations
from harness.cell.phases import Phase
from harness.engines.jobs import Engine as Running
from harness.process.environment import cache_folder
from harness.records import Cell, CellResult, failed_rows
from harness.registry import KNOWN, BadInput, Unfinished, ours, plugins
from harness.schedule.progress import Progress, progress_for, say, tell
from harness.schedule.tally import Tally
from harness.store import baseline
from harness.store.files import can_write
from harness.store.opening import open_for_run, open_to_plan
from harness.store.store import Store

if TYPE_CHECKING:
    from harness.engines.jobs import Telling
    from harness.report.model import Report

LEFT_OUT = "left out, computed again if asked for"
MOST_NAMED = 20
"""Files that a line names, but for the first."""
Watch = Callable[[Tally, Callable[[str], Phase]], Progress]
"""A function that makes the display of a run's progress."""


@dataclass(frozen=True)
class Reported:
    """The report of a run, and what it lacks."""

    directory: Path
    report: Report
    results: Mapping[Cell, CellResult]
    beside: Sequence[CellResult]
    missing: Sequence[str]
    """Names of cells that are not computed yet, or gone."""
    damaged: Mapping[Path, str]
    """Reasons by file."""
    ended: Unfinished | None = None
    """The reason why the run ended before it was done."""

    @property
    def is_sound(self) -> bool:
        """True where the run came to its end, and nothing of it is damaged."""
        return not (self.damaged or self.ended)


@ours.meanwhile()
def run(
    asked: RunRequest, engine: Engine = ISOLATED, store: Path | str = DEFAULT, retry_failed: bool = False
) -> Results:
    """Compute the cells of a request that `store` lacks, write tables and report, and return all of them.

    `store`: the run's directory, new or with a run under the same conditions.
    `retry_failed`: compute failed cells again. A cell that fails is a row with the reason.
    Plug-ins are known in this call only, unless `add_plugins` named them.
    Raises BadInput for a request that cannot be computed, and Unfinished where the run ended early.
    """
    with KNOWN.for_now():
        reported = compute(prepare(asked, engine, Path(store), retry_failed))
    if reported.ended:
        raise reported.ended
    return load(store)


@ours.meanwhile()
def add_plugins(named: Sequence[Path | str]) -> None:
    """Make plug-ins known, files or modules, until this process ends. Raises BadInput for a broken one."""
    plugins.add([str(name) for name in named])


def compute(prepared: Prepared, watch: Watch = progress_for) -> Reported:
    """Compute the missing cells, store each as it ends, and write the report.

    Raises BadInput where the directory cannot be used, and Unfinished where no cell has ended.
    """
    ended = None
    with _opened(prepared) as run:
        if prepared.beside:
            run.keep_beside(prepared.beside)
        try:
            results = _computed(prepared, run, watch)
        except Unfinished as error:
            results, ended = run.load()[0], error
            if not results:
                raise
        return report(run, results, ended=ended)


def cells(prepared: Prepared, watch: Watch = progress_for) -> dict[Cell, CellResult]:
    """Compute the missing cells, store each as it ends, and return all of the directory, without a report.

    Raises BadInput where the directory cannot be used, and Unfinished where the run ended early.
    """
    with _opened(prepared) as run:
        return _computed(prepared, run, watch)


@contextmanager
def _opened(prepared: Prepared) -> Iterator[Store]:
    """Hold the run's directory until the context ends, with the demonstrations of its file in the cache."""
    if prepared.demonstrations:
        summary = prepared.request.conditions.demonstrations
        store_demonstrations(summary, prepared.demonstrations.episodes, prepared.demonstrations.rewards)
    with open_for_run(prepared.directory, prepared.request, prepared.engine.variables) as run:
        yield run


def _computed(prepared: Prepared, run: Store, watch: Watch) -> dict[Cell, CellResult]:
    """Return all results of the directory once its missing cells are computed."""
    from harness.schedule.grid import Grid, Sink
    from harness.schedule.logs import Logged

    request = prepared.request
    results, unusable = run.load()
    tell_unusable(unusable, LEFT_OUT)
    beside = _beside(run, prepared.engine)
    cells = prepared.missing(results, beside)
    kept = len(request.cells) - len(cells)
    budget = request.conditions.budget
    say(f"{len(cells)} cells to run, {kept} kept from before, {budget} budget, in {run.path}")
    if cells and not can_write(cache_folder()):
        tell(f"the cache {cache_folder()} cannot be written to: experts are trained for this run alone")
    sink: Sink = run
    if prepared.logs:
        sink = logged = Logged(run, run.path, prepared.logs)
        cast("Telling", prepared.engine).heard = logged.heard  # Ray takes no logs
    grid = Grid(request.conditions, sink, prepared.engine, watch)
    grid.run(cells)
    results, _ = run.load()
    if lost := [cell for cell in request.cells if cell not in results and cell not in beside]:
        tell(f"lost or damaged while the run went on, computed again: {lost[0].name}, {len(lost)} in all")
        grid.run(lost)
        results, unusable = run.load()
        for cell in [cell for cell in lost if cell not in results]:
            reason = f"its stored result cannot be used: {unusable.get(run.place(cell.name), 'it is gone')}"
            results[cell] = failed_rows(cell, request.conditions.protocol, reason)
            run.save(results[cell])
    return results


def plan(prepared: Prepared) -> list[str]:
    """Return what the run would take, a line each. Nothing is computed or written."""
    from harness.schedule import plan as planning

    request, engine = prepared.request, prepared.engine
    with open_to_plan(prepared.directory, request, engine.variables) as run:
        results, unusable = run.load()
        tell_unusable(unusable, LEFT_OUT)
        beside = run.without_its_own(prepared.beside) if prepared.beside else _beside(run, engine)
    cells = prepared.missing(results, beside)
    kept = [cell in results for cell in {*request.cells}.difference(cells)]
    counts = (
        f"{len(request.cells):,} cells: {sum(kept):,} kept from before, in {prepared.directory}; "
        f"{len(kept) - sum(kept):,} of a baseline; {len(cells):,} to run"
    )
    return [counts, *planning.as_lines(planning.plan(cells, request.conditions, engine.variables))]


def report(
    run: Store,
    results: Mapping[Cell, CellResult],
    write: Literal["changed", "anew", "nothing"] = "changed",
    ended: Unfinished | None = None,
) -> Reported:
    """Write tables, report and compared recordings where they are not as these results make them, in any case
    or not at all. `ended`: the reason why the run ended early."""
    from harness.report.files import recorded_in, write_report
    from harness.report.model import build

    damaged = run.damaged_files(results.values())
    beside, unusable = run.beside()
    shown = [*results.values(), *beside]
    if write == "anew" or (write == "changed" and not run.is_sealed()):
        compared = list[Path]()
        learned = [result for result in results.values() if result.learned]
        if learned and run.request.conditions.record != "none":
            from harness.recordings.ghosts import write_compared  # rerun is 30 MB

            compared = write_compared(run, learned)
        built = build(run.request, shown, recorded_in(run.path))
        run.seal([*results.values()], [*compared, *write_report(run.path, built)])
    else:
        built = build(run.request, shown)
    there = {result.cell for result in shown}
    missing = [cell.name for cell in run.request.cells if cell not in there]
    return Reported(run.path, built, results, beside, missing, damaged | unusable, ended)


def _beside(run: Store, engine: Running) -> list[Cell]:
    """Return the stored cells of a baseline, not to be computed. Raises BadInput for other versions."""
    results, unusable = run.beside()
    tell_unusable(unusable, "left out of the baseline")
    tasks = baseline.tasks_now(run.request, engine.variables)
    if not all(baseline.is_comparable(result, tasks, run.request) for result in results):
        raise BadInput(
            f"the baseline in {run.path} is {baseline.OTHER_VERSION}; give it again, or another --out"
        )
    return [result.cell for result in results]


def tell_unusable(files: Mapping[Path, str], what_happens: str) -> None:
    """Print a line for each reason to standard error."""
    by_reason: dict[str, list[Path]] = {}
    for path, reason in sorted(files.items()):
        by_reason.setdefault(reason, []).append(path)
    for reason, (first, *others) in sorted(by_reason.items()):
        names = ", ".join([str(first), *(path.name for path in others[:MOST_NAMED])])
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        tell(f"{what_happens}: {names}{more}: {reason}")
