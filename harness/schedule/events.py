"""Progress for programs: one JSON object a line, of the types below (docs/commands.md)."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self, TextIO

import msgspec

from harness.cell.phases import Phase
from harness.schedule.progress import NOTHING
from harness.schedule.tally import Tally

if TYPE_CHECKING:
    from harness.engines.jobs import Job
    from harness.records import Status

FORMAT: Literal[1] = 1
LOOK_EVERY = 1.0
"""Seconds between looks at what jobs do."""


class JobName(msgspec.Struct, frozen=True, kw_only=True):
    """Name of a job: a cell, or what the cells of an environment and a seed share, where `method` is null.
    The fields are those of scores.csv."""

    name: str
    env: str
    seed: int
    method: str | None = None
    dynamics: str | None = None
    demos: int | None = None
    every: int | None = None
    demonstrator: str | None = None


class Event(msgspec.Struct, frozen=True, kw_only=True, tag_field="event", tag=str.lower):
    """An event of a run. `seconds`: since it began to compute."""

    seconds: float


class Begun(Event, frozen=True, kw_only=True):
    """The first event. `cells`: to be computed. `eta`: seconds until all are, as they are expected."""

    format: Literal[1] = FORMAT
    cells: int
    workers: int
    eta: float


class Started(Event, frozen=True, kw_only=True):
    """The start of a job."""

    job: JobName


class Doing(Event, frozen=True, kw_only=True):
    """Another phase of a job that runs, or a later step; reported once a second at most.

    `step`, `of`: environment steps, null where unknown.
    `returns`: as of `Ended`, of policies that were scored by now.
    """

    name: str
    phase: str
    step: int | None
    of: int | None
    returns: dict[str, float]


class Ended(Event, frozen=True, kw_only=True):
    """The end of a job.

    `took`: seconds; null where it never ran. `reason`: why it failed or was skipped.
    `returns`: each policy's mean true return over the evaluation episodes.
    `cells_done` and `cells_left`: of `cells`; failed ones are done. `eta`: as of `Begun`.
    """

    name: str
    status: Literal["ok", "skipped", "failed"]
    took: float | None
    reason: str
    returns: dict[str, float]
    cells_done: int
    cells_left: int
    cells_failed: int
    eta: float


class Computed(Event, frozen=True, kw_only=True):
    """The end of computing. `stopped`: whether that is before all was, such as by Ctrl-C."""

    cells_done: int
    cells_left: int
    cells_failed: int
    stopped: bool


class Reported(msgspec.Struct, frozen=True, kw_only=True, tag_field="event", tag="reported"):
    """The last event. `failed`: names of cells, of this run and before. `found`: the closing lines."""

    directory: str
    failed: list[str]
    found: list[str]


AnyEvent = Begun | Started | Doing | Ended | Computed | Reported


def write(stream: TextIO, event: AnyEvent) -> None:
    """Write the event as a line, at once."""
    stream.write(msgspec.json.encode(event).decode() + "\n")
    stream.flush()


class Events:
    """Events of a run, to a stream. `doing`: as of `progress_for`."""

    def __init__(self, tally: Tally, doing: Callable[[str], Phase], stream: TextIO) -> None:
        self.tally, self.doing, self.stream = tally, doing, stream
        self._phases: dict[str, Phase] = {}
        """The last phase of each job that runs."""
        self._lock = threading.RLock()
        self._left = threading.Event()
        self._looks = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Self:
        its = self.tally
        self._write(Begun(seconds=its.elapsed, cells=its.cells, workers=its.workers, eta=its.eta()))
        self._looks.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._left.set()
        self._looks.join()
        self._write(Computed(seconds=self.tally.elapsed, **self._counts(), stopped=error is not None))

    def started(self, job: Job) -> None:
        self.tally.begin(job.name)
        cell, name = job.cells[0], JobName(name=job.name, env=job.cells[0].env, seed=job.cells[0].seed)
        if not job.shared:
            shown = dataclasses.asdict(cell.shown)
            name = msgspec.structs.replace(name, method=cell.method, dynamics=cell.dynamics, **shown)
        with self._lock:
            self._phases[job.name] = Phase()
            self._write(Started(seconds=self.tally.elapsed, job=name))

    def finished(
        self, job: Job, status: Status, reason: str = "", returns: Mapping[str, float] = NOTHING
    ) -> None:
        took = self.tally.end(job.name, status)
        with self._lock:
            self._phases.pop(job.name, None)
            ended = Ended(
                seconds=self.tally.elapsed,
                name=job.name,
                status=status,
                took=took,
                reason=reason,
                returns=_finite(returns),
                **self._counts(),
                eta=self.tally.eta(),
            )
            self._write(ended)

    def _counts(self) -> dict[str, int]:
        its = self.tally
        return {"cells_done": its.done, "cells_left": its.left, "cells_failed": its.failed}

    def _look(self) -> None:
        """Write the phases that have changed, until the run is over."""
        while not self._left.wait(LOOK_EVERY):
            for name in list(self._phases):
                phase = self.doing(name)
                with self._lock:
                    if phase != Phase() and self._phases.get(name, phase) != phase:
                        self._phases[name] = phase
                        doing = Doing(
                            seconds=self.tally.elapsed,
                            name=name,
                            phase=phase.stage,
                            step=phase.step,
                            of=phase.of,
                            returns=_finite(phase.returns),
                        )
                        self._write(doing)

    def _write(self, event: AnyEvent) -> None:
        with self._lock:
            write(self.stream, event)


def _finite(returns: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers that JSON can hold."""
    return {name: value for name, value in returns.items() if math.isfinite(value)}
