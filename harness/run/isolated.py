"""The engine of every run: each job in a fresh process of its own, which may die, hang, print and start
others as it likes."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from pebble import ProcessExpired
from pebble.concurrent import process as in_a_process

from harness.run.engines import WORK, Job, Outcome, compute, describe
from harness.run.environment import PRELOAD_VARIABLE, numeric
from harness.run.files import appending, opened, write_atomic
from harness.run.orphans import end_descendants, end_orphans
from harness.run.processes import NAME, SERVER_DIED, begin_cell, bound_memory, fresh_processes, wake_server
from harness.run.scratch import scratch_folder

LOOK_EVERY = 1.0
"""Seconds between looks for processes that jobs left behind."""
LOG, TEMPORARY, DOING = "log", "tmp", "doing"
"""In the folder of a job."""
MOST_TOLD = 200
"""Bytes of what a job says that it does that are shown."""
LONGEST_LOG = 1 << 20
"""Bytes of what a job printed that are kept: the last ones."""


class Isolated:
    """As many processes at a time as there are workers.

    timeout: seconds after which a job is stopped; None for never. modules: what many jobs import, such
    as their environments. work: the module that knows how. preload: what imports that once for all
    processes.
    """

    def __init__(
        self,
        workers: int,
        timeout: float | None = None,
        deterministic: bool = True,
        modules: Sequence[str] = (),
        work: str = WORK,
        preload: str = "harness.run.preload",
    ) -> None:
        self.workers, self.timeout = workers, timeout
        self.variables = numeric(deterministic)
        self._deterministic, self._modules, self._work, self._preload = deterministic, modules, work, preload
        self._running: dict[Future[Outcome], tuple[Job, Path]] = {}

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            os.environ[PRELOAD_VARIABLE] = ",".join(self._modules)
            stack.callback(os.environ.pop, PRELOAD_VARIABLE, None)
            self._folders = stack.enter_context(scratch_folder())
            context = stack.enter_context(fresh_processes(self._preload, self._deterministic))
            # pebble's stubs call this argument mp_context, its code context.
            options = {"name": NAME, "context": context, "timeout": self.timeout}
            self._launch = in_a_process(**options)(_do)  # type: ignore[call-overload]
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.clear()
        self._stack.__exit__(kind, error, trace)

    def start(self, job: Job) -> None:
        folder = self._folders / job.name
        (folder / TEMPORARY).mkdir(parents=True, exist_ok=True)
        self._running[_launched(self._launch, self._work, job, folder)] = job, folder

    def doing(self, name: str) -> str:
        with contextlib.suppress(OSError, ValueError), opened(self._folders / name / DOING) as file:
            return file.read(MOST_TOLD).decode()
        return ""

    def finished(self) -> list[tuple[Job, Outcome]]:
        ended = []
        for future in wait(self._running, LOOK_EVERY, return_when=FIRST_COMPLETED).done:
            job, folder = self._running.pop(future)
            ended.append((job, replace(self._outcome(future), log=_printed(folder / LOG))))
            shutil.rmtree(folder, ignore_errors=True)
        end_orphans()
        wake_server()
        return ended

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
                hint = " (out of memory?)" if name == "SIGKILL" else ""
                return Outcome(error=f"its process was killed by {name}{hint}")
            reason = f"its process ended without a result, exit code {code}"
            return Outcome(error=reason, lost=code == SERVER_DIED)
        if isinstance(error, TimeoutError) and self.timeout is not None:
            return Outcome(error=f"it was stopped after {self.timeout:g} s")
        return Outcome(error=describe(error))


class NotStarted(Exception):
    """Why a process could not be started, in a line."""


def _launched(launch: Callable[..., Future[Outcome]], *arguments: object) -> Future[Outcome]:
    """The future of a process that starts, or of one that cannot."""
    wake_server()
    try:
        return launch(*arguments)
    except (OSError, EOFError, RuntimeError) as error:
        died = isinstance(error, EOFError | ConnectionError)
        reason = "the process that it is forked from was killed (out of memory?)" if died else describe(error)
        future: Future[Outcome] = Future()
        future.set_exception(NotStarted(reason))
        return future


def _do(work: str, job: Job, folder: Path) -> Outcome:
    """Does one job, in its own process; whatever it prints goes to the log in its folder, and its temporary
    files there, too."""
    try:
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
        begin_cell()
        bound_memory()
        with appending(folder / LOG) as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        faulthandler.enable()
        return compute(work, job, partial(_tell, folder))
    except BaseException as error:
        with contextlib.suppress(BaseException):
            print(f"\n{job.name}:", file=sys.stderr)
            traceback.print_exc()
        return Outcome(error=describe(error))
    finally:
        with contextlib.suppress(BaseException):  # such as of a handler that the cell left for their signals
            end_descendants()
        for stream in (sys.stdout, sys.stderr):  # A process that has told its result may be stopped.
            with contextlib.suppress(Exception):
                stream.flush()


def _tell(folder: Path, doing: str) -> None:
    """Says what a job does, to whoever looks into its folder."""
    with contextlib.suppress(OSError):
        write_atomic(folder / DOING, doing)


def _printed(log: Path) -> bytes:
    """What is in the log; of a long one the end."""
    with contextlib.suppress(OSError):
        with opened(log) as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - LONGEST_LOG))
            printed = file.read()
        left_out = size - len(printed)
        return b"(%d bytes left out)\n" % left_out * (left_out > 0) + printed
    return b""
