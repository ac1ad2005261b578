"""Jobs, what comes back of them, and the engine that does them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self

from harness.cell.phases import Phase
from harness.records import Cell, Conditions
from harness.registry.known import Plugin

WORK = "harness.cell.run"
"""The module that does jobs: `prepare` makes what cells share, `run_cell` a cell's result and files."""


@dataclass(frozen=True, eq=False)
class Job:
    """A cell to compute; or, if `shared`, what several cells of one environment and seed share.

    `key`: the key under which it must be computed. `plugins`: those that define its method and task.
    `inputs`: arrays and artifacts by name, which the cell shares with others.
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
    def group(self) -> tuple[str, int]:
        """The environment and the seed, whose cells share an expert and demonstrations."""
        return self.cells[0].env, self.cells[0].seed

    @property
    def name(self) -> str:
        cell = self.cells[0]
        return f"{cell.env}__expert__seed{cell.seed}" if self.shared else cell.name


def ignored(name: str, phase: Phase) -> None:
    """Do nothing with a phase."""


@dataclass(frozen=True)
class Outcome:
    """The result of a job, or the error.

    `result`: the encoded result of a cell. `files`: those of the cell, or what cells share, by name.
    `log`: text that the job printed. `lost`: whether the error may be another one's fault.
    """

    result: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    log: bytes = b""
    error: str = ""
    lost: bool = False


class Engine(Protocol):
    """A context manager that does jobs. On leaving, nothing that it started goes on."""

    @property
    def workers(self) -> int:
        """The number of jobs that it does at a time."""

    @property
    def variables(self) -> Mapping[str, str]:
        """The variables of its jobs that numbers depend on (`harness.process.environment`)."""

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


class Telling(Engine, Protocol):
    """An engine that tells all that its jobs do."""

    heard: Callable[[str, Phase], None]
    """Called with the name of a job and each of its phases, in any thread."""
