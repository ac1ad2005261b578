"""The grid: every cell in a process of its own, as many at a time as there are workers.

A cell that raises, dies or yields NaN becomes `failed` rows with the reason; the others go on.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

from pebble import ProcessExpired
from pebble.concurrent import process as in_a_process

from harness.judge.results import (
    CONTROLS,
    REFERENCE,
    Cell,
    CellResult,
    Conditions,
    failed_rows,
    policies_of,
    usable,
)
from harness.run.codec import decode, encode, printable
from harness.run.environment import numeric, of_this_process
from harness.run.files import appending, sha256
from harness.run.keys import cell_keys
from harness.run.orphans import end_descendants, end_orphans
from harness.run.processes import NAME, SERVER_DIED, begin_cell, bound_memory, fresh_processes, wake_server
from harness.run.progress import Progress, progress_for
from harness.run.store import LOG

ENV_COST = {"cartpole": 1.0, "pendulum": 2.0, "highway": 3.0, "cartpole_discrete": 1.0, "gridworld": 0.1}
METHOD_COST = {
    REFERENCE: 0.2,
    "bc": 0.8,
    **dict.fromkeys(("shaped", "shaped_ml"), 2.0),
    **dict.fromkeys(("maxmargin", "maxmargin_projection", "maxent", "maxent_linear"), 2.2),
    **dict.fromkeys(CONTROLS, 1.0),
    "control_shuffled": 2.0,
    "control_clone": 1.8,
}
EXPERT_COST = 0.3
"""What tasks take; RL from scratch in cart-pole is 1. Only their order and the ETA depend on it."""
LOOK_EVERY = 1.0
"""Seconds between looks for processes that cells left behind."""


class Work(Protocol):
    """The module that does what is scheduled here; named, so that only the cells' processes import it."""

    def prepare(self, env: str, seed: int, conditions: Conditions) -> None: ...

    def run_cell(self, cell: Cell, conditions: Conditions, directory: Path) -> CellResult: ...


@dataclass(frozen=True)
class Task:
    """A cell to compute or, where there is none, what all cells of its env and seed share, the expert and
    its demonstrations, which they wait for."""

    env: str
    seed: int
    cell: Cell | None = None

    @property
    def name(self) -> str:
        return self.cell.name if self.cell else f"{self.env}__expert__seed{self.seed}"

    @property
    def checked(self) -> Cell:
        """The cell whose key says what the task must be done under."""
        return self.cell or Cell(self.env, REFERENCE, self.seed)

    @property
    def cost(self) -> float:
        method = METHOD_COST.get(self.cell.method, 1.0) if self.cell else EXPERT_COST
        return ENV_COST.get(self.env, 2.0) * method


@dataclass(frozen=True)
class Outcome:
    """What came back from a task's process: the encoded result, or why there is none.
    lost: whether that need not be the task's own doing."""

    result: str = ""
    error: str = ""
    lost: bool = False


@dataclass(frozen=True)
class Grid:
    """What to do with cells: under which conditions, where, with how many processes at a time.

    save: called in this process with each result as soon as it is there. timeout: seconds after which a task
    is stopped; None for never. work: the module that knows how. preload: what to import once for all
    processes.
    """

    conditions: Conditions
    directory: Path
    workers: int
    save: Callable[[CellResult], None]
    timeout: float | None = None
    work: str = "harness.run.cells"
    preload: str = "harness.run.preload"

    def run(self, cells: Sequence[Cell]) -> None:
        """Computes every cell. On an exception, KeyboardInterrupt included, every process is killed first."""
        if not cells:
            return
        tasks = [Task(env, seed) for env, seed in {(cell.env, cell.seed): None for cell in cells}]
        tasks += [Task(cell.env, cell.seed, cell) for cell in cells]
        tasks.sort(key=lambda task: (task.cell is not None, -task.cost))
        with (
            fresh_processes(self.preload, self.conditions.deterministic) as context,
            progress_for({task.name: task.cost for task in tasks}, self.workers) as progress,
        ):
            self._run(tasks, context, progress)

    def _run(
        self, waiting: list[Task], context: multiprocessing.context.BaseContext, progress: Progress
    ) -> None:
        # pebble's stubs call this argument mp_context, its code context.
        options = {"name": NAME, "context": context, "timeout": self.timeout}
        launch = in_a_process(**options)(attempt)  # type: ignore[call-overload]
        keys = cell_keys(
            [t.checked for t in waiting], self.conditions, numeric(self.conditions.deterministic)
        )
        running: dict[Future[Outcome], Task] = {}
        prepared: set[tuple[str, int]] = set()
        lost: list[Task] = []
        tried_again: set[Task] = set()

        def start(task: Task) -> None:
            progress.started(task.name)
            key = keys[task.checked]
            running[_launched(launch, self.work, task, self.conditions, self.directory, key)] = task

        while waiting or running or lost:
            ready = [task for task in waiting if task.cell is None or (task.env, task.seed) in prepared]
            for task in ready[: self.workers - len(running)]:
                waiting.remove(task)
                start(task)
            if lost and not running:  # once more, alone: one of them may be why the others were lost
                tried_again.add(lost[0])
                start(lost.pop(0))
            for future in wait(running, LOOK_EVERY, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                outcome = self._outcome(future)
                if outcome.lost and task not in tried_again:
                    lost.append(task)
                elif task.cell:
                    self._keep(task.cell, outcome, progress)
                elif not outcome.error:
                    prepared.add((task.env, task.seed))
                    progress.finished(task.name, "ok")
                else:
                    progress.finished(task.name, "failed", outcome.error)
                    orphans = [t for t in waiting if (t.env, t.seed) == (task.env, task.seed)]
                    for orphan in [t.cell for t in orphans if t.cell]:
                        self._keep(orphan, Outcome(error=f"no expert: {outcome.error}"), progress)
                    waiting[:] = [t for t in waiting if t not in orphans]
            end_orphans()
            wake_server()

    def _outcome(self, future: Future[Outcome]) -> Outcome:
        error = future.exception()  # not raised here: some would end the run
        if error is None:
            return future.result()
        if isinstance(error, NotStarted):
            return Outcome(error=f"its process could not be started: {error}", lost=True)
        if isinstance(error, ProcessExpired):
            code = error.exitcode
            if code is not None and code < 0:
                name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
                hint = " (out of memory?)" if -code == signal.SIGKILL else ""
                return Outcome(error=f"its process was killed by {name}{hint}")
            reason = f"its process ended without a result, exit code {code}"
            return Outcome(error=reason, lost=code == SERVER_DIED)
        if isinstance(error, TimeoutError) and self.timeout is not None:
            return Outcome(error=f"it was stopped after {self.timeout:g} s")
        return Outcome(error=_describe(error))

    def _keep(self, cell: Cell, outcome: Outcome, progress: Progress) -> None:
        error = outcome.error
        if error:
            self.save(failed_rows(cell, self.conditions.protocol, error))
        else:
            self.save(decode(outcome.result))
        progress.finished(cell.name, "failed" if error else "ok", error)


class NotStarted(Exception):
    """Why a process could not be started, in a line."""


def _launched(launch: Callable[..., Future[Outcome]], *arguments: object) -> Future[Outcome]:
    """The future of a process that starts, or of one that cannot."""
    wake_server()
    try:
        return launch(*arguments)
    except (OSError, EOFError, RuntimeError) as error:
        future: Future[Outcome] = Future()
        future.set_exception(NotStarted(_describe(error)))
        return future


def attempt(work: str, task: Task, conditions: Conditions, directory: Path, key: str) -> Outcome:
    """Does one task, in its own process; whatever it prints goes to the run's log.
    key: what it must be computed under, before and after."""
    try:
        begin_cell()
        bound_memory()
        with appending(directory / LOG) as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
        faulthandler.enable()
        variables = of_this_process()  # as they are now: what a method sets later is its own affair
        _check_key(key, task.checked, conditions, variables)
        module = cast(Work, importlib.import_module(work))
        if task.cell is None:
            module.prepare(task.env, task.seed, conditions)
            return Outcome()
        result = module.run_cell(task.cell, conditions, directory)
        _check(result, task.cell, conditions.protocol, directory)
        encoded = encode(result)
        decode(encoded)
        _check_key(key, task.checked, conditions, variables)
        return Outcome(result=encoded)
    except BaseException as error:
        with contextlib.suppress(BaseException):
            print(f"\n{task.name}:", file=sys.stderr)
            traceback.print_exc()
        return Outcome(error=_describe(error))
    finally:
        with contextlib.suppress(BaseException):  # such as of a handler that the cell left for their signals
            end_descendants()
        for stream in (sys.stdout, sys.stderr):  # A process that has told its result may be stopped.
            with contextlib.suppress(Exception):
                stream.flush()


def _check_key(key: str, cell: Cell, conditions: Conditions, variables: dict[str, str]) -> None:
    if cell_keys([cell], conditions, variables)[cell] != key:
        raise RuntimeError(
            "the program, its packages or its environment are not those that the run began with; "
            "were packages changed, or was Python started with -E or -I?"
        )


def _check(result: CellResult, cell: Cell, protocol: str, directory: Path) -> None:
    if result.cell != cell or not result.rows:
        raise ValueError(f"asked for {cell.name}, got {len(result.rows)} rows of {result.cell.name}")
    if (policies := tuple(row.policy for row in result.rows)) != policies_of(cell):
        raise ValueError(f"asked for {', '.join(policies_of(cell))}, got {', '.join(policies)}")
    for name, digest in result.recordings.items():
        if sha256(directory / "recordings" / name) != digest:
            raise ValueError(f"the recording {name} is not what was recorded")
    for row in result.rows:
        if row.protocol != protocol:
            raise ValueError(f"{row.policy}: of protocol {row.protocol}, not {protocol}")
        for name in ("return_mean", "discounted_mean", "length_mean"):
            value = getattr(row, name)
            if row.status == "ok" and not usable(value):
                raise FloatingPointError(f"{row.policy}: {name} is {value}")


def _describe(error: BaseException) -> str:
    """One line: what was raised, and the three innermost places."""
    frames = reversed(traceback.extract_tb(error.__traceback__)[-3:])
    where = ", called by ".join(f"{f.name} ({Path(f.filename).name}:{f.lineno})" for f in frames)
    try:
        message = str(error)
    except BaseException as another:
        message = f"(its message raises {type(another).__name__})"
    message = " ".join(f"{type(error).__name__}: {message}".split())[:300]
    cause = "out of memory: " if isinstance(error, MemoryError) else ""
    return printable(f"{cause}{message.rstrip(': ')}; in {where}")
