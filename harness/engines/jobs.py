"""Jobs, what comes back of them, and the engine that does them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self

from harness.judge.results import Cell, CellResult, Conditions
from harness.run.phases import Phase
from harness.run.plugins import Plugin

WORK = "harness.run.cells"


class Work(Protocol):
    """The module that does jobs. An engine has its name: only where cells are computed it is imported."""

    def prepare(self, cells: tuple[Cell, ...], conditions: Conditions) -> dict[str, bytes]:
        """Return what these cells, of one environment and seed, share, by name."""

    def run_cell(
        self, cell: Cell, conditions: Conditions, inputs: Mapping[str, bytes], tell: Callable[[Phase], None]
    ) -> tuple[CellResult, dict[str, bytes]]:
        """Return the cell's result, and the files that it adds to the run, by their path there.
        tell: called now and then with the stage that the cell is in."""


@dataclass(frozen=True, eq=False)
class Job:
    """A cell to compute or, where `shared`, what these cells of one environment and seed share.

    key: of what it must be computed under. plugins: those that define its method and task.
    inputs: what the cell shares with others.
    """

    cells: tuple[Cell, ...]
    shared: bool
    conditions: Conditions
    key: str
    plugins: tuple[Plugin, ...] = ()
    inputs: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        """The method that the job needs, if it needs one."""
        return () if self.shared else (self.cells[0].method,)

    @property
    def name(self) -> str:
        cell = self.cells[0]
        return f"{cell.env}__expert__seed{cell.seed}" if self.shared else cell.name


@dataclass(frozen=True)
class Outcome:
    """The encoded result and its files, or what cells share; or the error, why there is none.
    log: text that the job printed. lost: whether the error need not be the job's own doing."""

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

    def submit(self, job: Job) -> None:
        """Begin a job. Raises Unfinished where nothing can be computed any more."""

    def completed(self) -> list[tuple[Job, Outcome]]:
        """Return the jobs that ended since the last call; wait for one, a second at most.
        Raises Unfinished as `submit` does."""

    def doing(self, name: str) -> Phase:
        """Return the phase of the job of that name; an empty one where it is not known."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
