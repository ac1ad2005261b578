"""The schedule of a run: every cell once, on an engine, as many at a time as it has workers.

A cell that raises, dies or yields NaN becomes `failed` rows with the reason. The others go on.
"""

from __future__ import annotations

import heapq
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from harness.cell.phases import Phase
from harness.cell.sharing import before, needs
from harness.engines.inline import Inline
from harness.engines.jobs import Engine, Job, Outcome
from harness.records import REFERENCE, Cell, CellResult, Conditions, failed_rows
from harness.registry.keys import cell_keys
from harness.registry.plugins import modules, needed
from harness.schedule.costs import Costs
from harness.schedule.progress import Progress, progress_for
from harness.schedule.tally import Tally
from harness.store.codec import decode
from harness.store.names import files_of

Group = tuple[str, int]
"""An environment and a seed, whose cells share an expert and demonstrations."""
MOST_SHARED, USUAL_SHARED = 1 << 34, 1 << 26
"""Bytes of shared inputs: the most that this process holds, and the first guess for a group."""


class Sink(Protocol):
    """A place for results."""

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        """Store a cell's result and its files, by their path in the run."""

    def log(self, printed: bytes) -> None:
        """Store the printed text of a job."""

    def handed_on(self, cell: Cell) -> Mapping[str, bytes]:
        """Return a stored cell's artifact and result by name, empty where no artifact is stored."""


@dataclass(frozen=True)
class Grid:
    """The conditions of cells, their engine, and the place for results.

    `told`: a function that makes the display of progress, as `progress_for` does.
    """

    conditions: Conditions
    sink: Sink
    engine: Engine
    told: Callable[[Tally, Callable[[str], Phase]], Progress] = progress_for

    def run(self, cells: Sequence[Cell]) -> None:
        """Compute every cell. On an exception, KeyboardInterrupt included, the engine is left first."""
        if not cells:
            return
        costs = Costs(self.conditions)
        jobs = self.jobs(cells, costs)
        expected = {job.name: costs.of(job) for job in jobs}
        tally = Tally(expected, {job.name for job in jobs if job.shared})
        with self.engine:
            tally.workers = self.engine.workers
            with self.told(tally, self.engine.doing) as progress:
                try:
                    Schedule(self, jobs, progress, costs).run()
                finally:
                    costs.keep()

    def jobs(self, cells: Sequence[Cell], costs: Costs) -> list[Job]:
        """Return the jobs that compute the cells, in order."""
        groups: dict[Group, list[Cell]] = {}
        for cell in cells:
            groups.setdefault((cell.env, cell.seed), []).append(cell)
        references = {group: Cell(group[0], REFERENCE, group[1]) for group in groups}
        keys = cell_keys([*references.values(), *cells], self.conditions, self.engine.variables)
        jobs = [
            Job(tuple(its), True, self.conditions, keys[references[group]], needed([], [group[0]]))
            for group, its in groups.items()
        ]
        jobs += [
            Job((cell,), False, self.conditions, keys[cell], needed([cell.method], [cell.env]))
            for cell in cells
        ]
        expected = {job.name: costs.of(job) for job in jobs}
        ahead = dict(expected)  # with the jobs that wait for it
        for job in jobs:
            if not job.shared and (source := before(job.cells[0])) and source.name in ahead:
                ahead[source.name] += expected[job.name]
        # Seed by seed, so that the shared inputs of all seeds are not held at once.
        # In one process, jobs without plug-ins come first.
        inline = isinstance(self.engine, Inline)
        plugged = {job.name: inline * len(modules(job.methods, [job.cells[0].env])) for job in jobs}

        def order(job: Job) -> tuple[int, int, bool, float]:
            return plugged[job.name], job.cells[0].seed, not job.shared, -ahead[job.name]

        return sorted(jobs, key=order)


class Schedule:
    """The jobs of a grid that have not ended, in order."""

    def __init__(self, grid: Grid, jobs: Sequence[Job], progress: Progress, costs: Costs) -> None:
        self.grid, self.progress, self.costs = grid, progress, costs
        self.rank = {job.name: rank for rank, job in enumerate(jobs)}
        self.shared = deque(job for job in jobs if job.shared)
        self.ready: list[tuple[int, Job]] = []
        """Cells that can start, a heap by rank."""
        self.held: dict[Group, list[Job]] = {job.group: [] for job in jobs}
        """Cells that wait for their shared inputs."""
        self.later: dict[Cell, list[Job]] = {job.cells[0]: [] for job in jobs if not job.shared}
        """Cells that use what another cell learned, by that cell, until it has ended."""
        for job in jobs:
            if not job.shared:
                self.held[job.group].append(job)
        self.left = {group: len(held) for group, held in self.held.items()}
        """The number of cells of each group that have not ended."""
        self.inputs: dict[Group, Mapping[str, bytes]] = {}
        self.bytes = self.preparing = 0
        """The size of all shared inputs, and the number of groups whose inputs are being made."""
        self.started: dict[str, float] = {}
        """The start of each running job, in seconds of `time.monotonic`."""
        self.lost: list[Job] = []
        self.losses: Counter[str] = Counter()
        self.alone: set[str] = set()
        """Jobs that were lost and run alone. One that is lost again has failed."""

    def run(self) -> None:
        """Do every job."""
        while self.shared or self.ready or self.lost:
            self._do(self._next)
            if self.lost:
                self._do_again()

    def _do_again(self) -> None:
        """Do lost jobs again, half as many at a time after each loss, at last each alone.

        One of them may be the cause of the others' loss.
        """
        again, self.lost = deque(self.lost), []
        most = max(1, self.grid.engine.workers >> max(self.losses[job.name] for job in again))
        if most == 1:
            self.alone |= {job.name for job in again}
        self._do(lambda: again.popleft() if again else None, most)

    def _do(self, following: Callable[[], Job | None], most: float = math.inf) -> None:
        """Do the jobs that follow until all have ended, at most `most` at a time."""
        while True:
            limit = min(most, self.grid.engine.workers)
            while len(self.started) < limit and (job := following()):
                self._start(job)
            if not self.started:
                return
            for job, outcome in self.grid.engine.completed():
                seconds = time.monotonic() - self.started.pop(job.name)
                self._ended(job, outcome, seconds)

    def _next(self) -> Job | None:
        """Return the first job that may start now, None where all must wait."""
        enough = self.bytes + (self.preparing + 1) * USUAL_SHARED > MOST_SHARED
        if self.shared and not (enough and self.started):
            first = self.rank[self.shared[0].name]
            if not self.ready or first < self.ready[0][0]:
                return self.shared.popleft()
        return heapq.heappop(self.ready)[1] if self.ready else None

    def _start(self, job: Job) -> None:
        self.progress.started(job)
        self.started[job.name] = time.monotonic()
        self.preparing += job.shared
        if not job.shared:
            (cell,) = job.cells
            inputs = {name: data for name, data in self.inputs[job.group].items() if needs(cell, name)}
            if source := before(cell):
                inputs |= self.grid.sink.handed_on(source)
            job = replace(job, inputs=inputs)
        self.grid.engine.submit(job)

    def _release(self, job: Job) -> None:
        """Let a cell start, now or after the cell whose result it uses."""
        source = before(job.cells[0])
        if source in self.later:
            self.later[source].append(job)
        else:
            heapq.heappush(self.ready, (self.rank[job.name], job))

    def _ended(self, job: Job, outcome: Outcome, seconds: float) -> None:
        self.preparing -= job.shared
        if outcome.log:
            self.grid.sink.log(outcome.log)
        if outcome.lost and job.name not in self.alone:
            self.losses[job.name] += 1
            self.lost.append(job)
            return
        if not job.shared:
            self._keep(job, outcome, seconds)
            return
        self.progress.finished(job, "failed" if outcome.error else "ok", outcome.error)
        held = self.held.pop(job.group)
        if outcome.error:
            for cell in held:
                self._keep(cell, Outcome(error=f"no expert: {outcome.error}"), 0.0)
            return
        self.costs.note(job, seconds)
        self.inputs[job.group] = outcome.files
        self.bytes += _size(outcome.files)
        for cell in held:
            self._release(cell)

    def _keep(self, job: Job, outcome: Outcome, seconds: float) -> None:
        """Store the result of a cell, and release the cells that waited for it."""
        (cell,) = job.cells
        error = outcome.error
        if not error:
            try:
                result = decode(outcome.result)
                own = result.files.keys() <= files_of(cell)
                if result.cell != cell or not own or result.files.keys() != outcome.files.keys():
                    error = "what came back is not the cell's"
            except ValueError as wrong:
                error = f"what came back is no result: {wrong}"
        if error:
            self.grid.sink.save(failed_rows(cell, job.conditions.protocol, error), {})
            self.progress.finished(job, "failed", error)
        else:
            self.costs.note(job, seconds, result.seconds.get("retrain", 0.0))
            start = max(0.0, seconds - sum(result.seconds.values()))
            self.grid.sink.save(replace(result, seconds={"start": start, **result.seconds}), outcome.files)
            returns = {str(row.policy): row.return_mean for row in result.rows if row.status == "ok"}
            reason = "" if returns else result.rows[0].reason
            self.progress.finished(job, "ok" if returns else "skipped", reason, returns)
        for other in self.later.pop(cell):
            self._release(other)
        self.left[job.group] -= 1
        if not self.left[job.group]:
            self.bytes -= _size(self.inputs.pop(job.group, {}))


def _size(files: Mapping[str, bytes]) -> int:
    return sum(map(len, files.values()))
