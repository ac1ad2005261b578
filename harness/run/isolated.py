"""The engine of every run: jobs in processes, which may die, hang, print and start others as they like.

A job that needs a plug-in has a fresh process of its own. Built-in methods and tasks share processes, one job
after the other, so that what JAX traced and loaded for one job serves the next."""

from __future__ import annotations

import contextlib
import faulthandler
import math
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from functools import partial
from multiprocessing import connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from harness.run.engines import WORK, Job, Outcome, compute, describe, process_restored
from harness.run.environment import PRELOAD_VARIABLE, numeric
from harness.run.orphans import PATIENCE, end_descendants, end_orphans
from harness.run.processes import NAME, SERVER_DIED, begin_cell, bound_memory, fresh_processes, wake_server
from harness.run.scratch import scratch_folder
from harness.store.files import appending, opened, write_atomic

MOST_JOBS = 50
"""Jobs that a process does before another takes its place."""
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
        self._running: dict[Worker, tuple[Job, Path, float]] = {}
        """Jobs, their folders, and when they are stopped, in seconds of `time.monotonic`."""
        self._idle: list[Worker] = []
        self._not_started: list[tuple[Job, Outcome]] = []

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            os.environ[PRELOAD_VARIABLE] = ",".join(self._modules)
            stack.callback(os.environ.pop, PRELOAD_VARIABLE, None)
            self._folders = stack.enter_context(scratch_folder())
            self._context = stack.enter_context(fresh_processes(self._preload, self._deterministic))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.clear()
        self._idle.clear()
        self._not_started.clear()
        self._stack.__exit__(kind, error, trace)

    def start(self, job: Job) -> None:
        folder = self._folders / job.name
        (folder / TEMPORARY).mkdir(parents=True, exist_ok=True)
        wake_server()
        try:
            worker = self._worker(job)
        except (OSError, EOFError, RuntimeError) as error:
            died = isinstance(error, EOFError | ConnectionError)
            reason = (
                "the process that it is forked from was killed (out of memory?)" if died else describe(error)
            )
            outcome = Outcome(error=f"its process could not be started: {reason}", lost=True)
            self._not_started.append((job, outcome))
        else:
            worker.begin(self._work, job, folder)
            stopped = math.inf if self.timeout is None else time.monotonic() + self.timeout
            self._running[worker] = job, folder, stopped

    def _worker(self, job: Job) -> Worker:
        """Return a process for the job: a fresh one where it needs plug-ins."""
        while self._idle and not job.plugins:
            worker = self._idle.pop()
            if worker.process.is_alive():
                return worker
            worker.end()
        while self._idle and len(self._idle) + len(self._running) >= self.workers:
            self._idle.pop().end()
        return Worker(self._context)

    def doing(self, name: str) -> str:
        with contextlib.suppress(OSError, ValueError), opened(self._folders / name / DOING) as file:
            return file.read(MOST_TOLD).decode()
        return ""

    def finished(self) -> list[tuple[Job, Outcome]]:
        ended, self._not_started = self._not_started, []
        wait([worker.answer for worker in self._running], 0 if ended else LOOK_EVERY, FIRST_COMPLETED)
        for worker, (job, folder, stopped) in [*self._running.items()]:
            outcome = worker.outcome()
            if outcome is None and time.monotonic() >= stopped:
                outcome = Outcome(error=f"it was stopped after {self.timeout:g} s")
            if outcome is None:
                continue
            del self._running[worker]
            if outcome.error or job.plugins or worker.jobs >= MOST_JOBS or not worker.goes_on:
                worker.end()
            else:
                self._idle.append(worker)
            ended.append((job, replace(outcome, log=_printed(folder / LOG))))
            shutil.rmtree(folder, ignore_errors=True)
        end_orphans()
        wake_server()
        return ended


class Worker:
    """A process that does jobs, one after the other, as they are sent through its connection.

    jobs: how many it has done. answer: what it says of the one that it does now, None where it ended without.
    goes_on: whether it can do another one.
    """

    def __init__(self, starter: Any) -> None:
        self.jobs, self.answer, self._began, self.goes_on = 0, Future[Outcome | None](), False, False
        self.connection, theirs = starter.Pipe()
        with theirs:
            self.process = starter.Process(target=_serve, args=(theirs,), name=NAME)
            self.process.start()

    def begin(self, *job: object) -> None:
        """Send the arguments of `_do`, and await the answer, in a thread: with a suspended process either may
        take for ever."""
        self.answer, self._began = Future(), False
        threading.Thread(target=self._ask, args=job, daemon=True).start()

    def _ask(self, *job: object) -> None:
        answer = None
        with contextlib.suppress(Exception):  # of a process that ended, or of a job that wrote here
            self.connection.send(job)
            self._began = self.connection.recv() is True
            outcome, self.goes_on = self.connection.recv()
            answer = outcome if isinstance(outcome, Outcome) else None
        self.answer.set_result(answer)

    def outcome(self) -> Outcome | None:
        """Return the outcome of the job, None where it goes on."""
        if alive := self.process.is_alive():
            if not self.answer.done():
                return None
        else:
            wait([self.answer], LOOK_EVERY)  # What was said last may be on its way.
        if self.answer.done() and (answer := self.answer.result()):
            self.jobs += 1
            return answer
        if alive:
            self.process.join(LOOK_EVERY)
        code = self.process.exitcode
        if code is None:
            return Outcome(error="it closed its connection to the run, or wrote to it")
        lost = code == SERVER_DIED or not self._began
        if code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            hint = " (out of memory?)" if name == "SIGKILL" else ""
            return Outcome(error=f"its process was killed by {name}{hint}", lost=lost)
        return Outcome(error=f"its process ended without a result, exit code {code}", lost=lost)

    def end(self) -> None:
        """End the process, whatever it does."""
        self.process.kill()
        self.process.join(PATIENCE)
        wait([self.answer], LOOK_EVERY)
        if self.answer.done():  # else what a job left behind holds the other end, and a thread waits here
            self.connection.close()


def _serve(jobs: connection.Connection) -> None:
    """Do jobs until there are none, or one has left signals to come or their handlers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    begin_cell()
    process, signals, goes_on = os.getpid(), _signals(), True
    while goes_on:
        try:
            work, job, folder = jobs.recv()
        except EOFError:
            return
        jobs.send(True)
        with process_restored():
            outcome = _do(work, job, folder)
        if os.getpid() != process:  # A copy of the process came back from a job that made it.
            os._exit(0)
        goes_on = _signals() == signals
        jobs.send((outcome, goes_on))


def _signals() -> list[object]:
    """Return the handlers of signals, and the alarm that is set."""
    alarm = signal.getitimer(signal.ITIMER_REAL) if hasattr(signal, "getitimer") else None
    return [*map(signal.getsignal, sorted(signal.valid_signals())), alarm]


def _do(work: str, job: Job, folder: Path) -> Outcome:
    """Do a job. What it prints goes to the log in its folder, and so do its temporary files."""
    try:
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
        os.makedirs(tempfile.tempdir, exist_ok=True)  # An earlier cell may have deleted it.
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
