"""Where cells are computed. An engine takes jobs and gives back bytes; it knows nothing of what they mean,
and what it computes knows nothing of the run's directory."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, cast

import numpy as np

from harness.judge.results import (
    REFERENCE,
    Cell,
    CellResult,
    Conditions,
    files_of,
    policies_of,
    usable,
)
from harness.registry import plugins
from harness.registry.keys import cell_keys
from harness.registry.known import Plugin
from harness.registry.machine import machine
from harness.run.cache import compiled_once
from harness.run.codec import decode, encode, printable
from harness.run.environment import hint, of_this_process
from harness.run.files import LARGEST_OF_CELL, sha256_of

WORK = "harness.run.cells"


class Work(Protocol):
    """The module that does what is scheduled; named, so that only where cells are computed it is imported."""

    def prepare(self, cells: tuple[Cell, ...], conditions: Conditions) -> dict[str, bytes]:
        """What these cells, of one environment and seed, share, by name."""

    def run_cell(
        self, cell: Cell, conditions: Conditions, inputs: Mapping[str, bytes], tell: Callable[[str], None]
    ) -> tuple[CellResult, dict[str, bytes]]:
        """Return its result, and the files that it adds to the run, by their path there. tell: called now
        and then with what is being done."""


@dataclass(frozen=True, eq=False)
class Job:
    """A cell to compute or, where `shared`, what these cells of one environment and seed share.
    key: what it must be computed under. plugins: those that define its method and task. inputs: what the cell
    shares with others."""

    cells: tuple[Cell, ...]
    shared: bool
    conditions: Conditions
    key: str
    plugins: tuple[Plugin, ...] = ()
    inputs: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        """The method that it needs, if it needs one."""
        return () if self.shared else (self.cells[0].method,)

    @property
    def name(self) -> str:
        cell = self.cells[0]
        return f"{cell.env}__expert__seed{cell.seed}" if self.shared else cell.name


@dataclass(frozen=True)
class Outcome:
    """What came back: the encoded result and its files, or what cells share; or why there is none.
    log: what was printed. lost: whether the error need not be the job's own doing."""

    result: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    log: bytes = b""
    error: str = ""
    lost: bool = False


class Engine(Protocol):
    """A context manager; on leaving, nothing that it started goes on.

    workers: how many jobs it does at a time. variables: what numbers depend on in the environment of its
    jobs (`harness.run.environment`).
    """

    @property
    def workers(self) -> int: ...

    @property
    def variables(self) -> Mapping[str, str]: ...

    def start(self, job: Job) -> None:
        """Begins a job."""

    def finished(self) -> list[tuple[Job, Outcome]]:
        """Return those that ended and were not told yet; wait for one, a second at most. Raises Unfinished,
        as `start` does, where nothing can be computed any more."""

    def doing(self, name: str) -> str:
        """What the job of that name is doing, in a few words; '' where it is not known."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Inline:
    """In this process, one job after the other: for debuggers and tests. What a cell prints is not kept. Its
    environment is this process's, and so are its keys: what is computed here is not mixed with other
    engines' unless that is the same."""

    workers = 1

    def __init__(self, work: str = WORK) -> None:
        self.variables = of_this_process()
        self._work = work
        self._ended: list[tuple[Job, Outcome]] = []

    def start(self, job: Job) -> None:
        try:
            with process_restored():
                plugins.check_alone(job.methods, [job.cells[0].env])
                outcome = compute(self._work, job)
        except (Exception, SystemExit, GeneratorExit) as error:
            traceback.print_exc(file=sys.stderr)
            outcome = Outcome(error=describe(error))
        self._ended.append((job, outcome))

    def finished(self) -> list[tuple[Job, Outcome]]:
        ended, self._ended = self._ended, []
        return ended

    def doing(self, name: str) -> str:
        return ""

    def __enter__(self) -> Self:
        self._before = os.environ.copy()
        os.environ.update(compiled_once())
        return self

    def __exit__(self, *error: object) -> None:
        os.environ.clear()
        os.environ.update(self._before)
        gc.unfreeze()


@contextlib.contextmanager
def process_restored() -> Iterator[None]:
    """Restore this process's environment and folder as the context ends, for the next job there, and free
    what the last one holds in cycles."""
    variables, folder = os.environ.copy(), None
    with contextlib.suppress(FileNotFoundError):  # which another job may have deleted
        folder = Path.cwd()
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(variables)
        if folder:
            with contextlib.suppress(OSError):
                os.chdir(folder)
        gc.collect()
        gc.freeze()  # Modules stay, and looking through them again takes as long as a short job.


AFTERWARDS = " Or did the cell change sys.path and then import from there? Do that as the module is imported."
"""Why else a cell's key may have changed while the cell was computed."""


def compute(work: str, job: Job, tell: Callable[[str], None] = lambda doing: None) -> Outcome:
    """Does a job, here and now. tell: as of `Work.run_cell`. Raises what it raises, ComplexWarning where the
    imaginary part of a number would be dropped, and RuntimeError where it is not done under the job's key."""
    variables = of_this_process()  # as they are now: what a method sets later is its own affair
    plugins.in_cells(job.plugins, job.methods, [job.cells[0].env])
    _check_key(job, variables)
    module = cast(Work, importlib.import_module(work))
    if job.shared:
        return Outcome(files=module.prepare(job.cells, job.conditions))
    (cell,) = job.cells
    with warnings.catch_warnings(action="error", category=np.exceptions.ComplexWarning):
        result, files = module.run_cell(cell, job.conditions, job.inputs, tell)
    _check(result, files, cell, job.conditions.protocol)
    encoded = encode(replace(result, origin=machine()))
    decode(encoded)
    _check_key(job, variables, AFTERWARDS)
    return Outcome(encoded, files)


def _check_key(job: Job, variables: Mapping[str, str], hint: str = "") -> None:
    first = job.cells[0]
    cell = Cell(first.env, REFERENCE, first.seed) if job.shared else first
    if cell_keys([cell], job.conditions, variables)[cell] != job.key:
        raise RuntimeError(
            "the program, a plug-in, packages or the environment are not those that the run began with; "
            "were packages or a plug-in's files changed, or was Python started with -E or -I?" + hint
        )


def _check(result: CellResult, files: Mapping[str, bytes], cell: Cell, protocol: str) -> None:
    if result.cell != cell or not result.rows:
        raise ValueError(f"asked for {cell.name}, got {len(result.rows)} rows of {result.cell.name}")
    if (policies := tuple(row.policy for row in result.rows)) != policies_of(cell):
        raise ValueError(f"asked for {', '.join(policies_of(cell))}, got {', '.join(policies)}")
    if result.files != {name: sha256_of(data) for name, data in files.items()}:
        raise ValueError("its files are not those that its result names")
    if others := sorted(result.files.keys() - files_of(cell)):
        raise ValueError(f"{others[0]} is no file of {cell.name}")
    if sum(map(len, files.values())) > LARGEST_OF_CELL:
        raise ValueError(f"its files are larger than {LARGEST_OF_CELL >> 20} MiB")
    for row in result.rows:
        if row.protocol != protocol:
            raise ValueError(f"{row.policy}: of protocol {row.protocol}, not {protocol}")
        for name in ("return_mean", "discounted_mean", "length_mean"):
            value = getattr(row, name)
            if row.status == "ok" and not usable(value):
                raise FloatingPointError(f"{row.policy}: {name} is {value}")


def describe(error: BaseException) -> str:
    """One line: what was raised, and the three innermost places."""
    frames = reversed(traceback.extract_tb(error.__traceback__)[-3:])
    where = ", called by ".join(f"{f.name} ({Path(f.filename).name}:{f.lineno})" for f in frames)
    try:
        message = str(error)
    except BaseException as another:
        message = f"(its message raises {type(another).__name__})"
    message = " ".join(f"{type(error).__name__}: {message}".split())[:300]
    cause = "out of memory: " if isinstance(error, MemoryError) else ""
    return printable(f"{cause}{message.rstrip(': ')}; in {where}{hint(error)}")
