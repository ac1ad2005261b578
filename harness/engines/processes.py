"""The engine of every run: jobs in processes, which may die, hang, print and start others as they like.

A job that needs a plug-in has a fresh process of its own. Built-in methods and tasks share processes, one job
after the other, so that what JAX traced and loaded for one job serves the next.
"""

from __future__ import annotations

import contextlib
import os
import queue
import shutil
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
import psutil

from harness.cell.phases import Phase
from harness.engines.cell_environment import cell_variables, write_program
from harness.engines.compute import describe
from harness.engines.containment import PATIENCE, descendants, is_alive, kill_descendants
from harness.engines.jobs import WORK, Job, Outcome, ignored
from harness.engines.scratch import scratch_folder
from harness.engines.server import Server
from harness.engines.worker import LOG, TEMPORARY, Message
from harness.process.environment import numeric
from harness.store.files import opened

MOST_JOBS = 50
"""Jobs that a worker does before another takes its place."""
LOOK_EVERY = 1.0
"""Seconds between looks for jobs that ended, and for workers that did."""
LONGEST_LOG = 1 << 20
"""Bytes of a job's printed text that are kept: the last ones."""
LONGEST_MESSAGE = 1 << 29
"""Bytes of a worker's message, at most. A cell that writes text to the connection claims more."""


class Processes:
    """Jobs in processes of this machine.

    `workers`: processes at a time. `timeout`: seconds after which a job is stopped; None for never.
    `modules`: modules that many jobs import, such as their environments. `work`: the module that does jobs.
    `preload`: the module that imports what all processes share.
    """

    def __init__(
        self,
        workers: int,
        timeout: float | None = None,
        deterministic: bool = True,
        modules: Sequence[str] = (),
        work: str = WORK,
        preload: str = "harness.engines.preload",
    ) -> None:
        self.workers, self.timeout = workers, timeout
        self.heard: Callable[[str, Phase], None] = ignored
        self.variables = numeric(deterministic)
        self._deterministic, self._modules, self._work = deterministic, [preload, *modules], work
        self._running: dict[str, threading.Thread] = {}
        self._phases: dict[str, Phase] = {}
        self._idle: list[Worker] = []
        self._ended: queue.SimpleQueue[tuple[Job, Outcome]] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._scratch = stack.enter_context(scratch_folder())
            write_program(self._scratch / "program")
            variables = cell_variables(self._scratch, self._deterministic)
            path = [str(self._scratch / "program"), *filter(None, [os.environ.get("PYTHONPATH")])]
            variables |= {"PYTHONPATH": os.pathsep.join(path), "PYTHONSAFEPATH": "1"}
            stack.callback(self._forget)
            self._server = stack.enter_context(Server(variables, self._modules))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _forget(self) -> None:
        """Wait for the threads of jobs, and forget all of the server that has ended."""
        for thread in self._running.values():
            thread.join(PATIENCE)
        for worker in self._idle:
            worker.end()
        self._running, self._phases, self._idle = {}, {}, []
        self._ended = queue.SimpleQueue()

    def submit(self, job: Job) -> None:
        folder = self._scratch / job.name
        (folder / TEMPORARY).mkdir(parents=True, exist_ok=True)
        thread = threading.Thread(target=self._do, args=(job, folder), daemon=True)
        self._running[job.name] = thread
        thread.start()

    def completed(self) -> list[tuple[Job, Outcome]]:
        self._server.wake()
        ended = list[tuple[Job, Outcome]]()
        with contextlib.suppress(queue.Empty):
            ended.append(self._ended.get(timeout=LOOK_EVERY))
            while True:
                ended.append(self._ended.get_nowait())
        for job, _ in ended:
            del self._running[job.name]
            self._phases.pop(job.name, None)
        return ended

    def doing(self, name: str) -> Phase:
        return self._phases.get(name, Phase())

    def _do(self, job: Job, folder: Path) -> None:
        """Do a job, in a thread: a suspended process may take for ever to read or to answer."""
        try:
            outcome = self._outcome(job, folder)
        except Exception as error:  # or the schedule would wait for ever
            outcome = Outcome(error=describe(error))
        outcome = replace(outcome, log=_printed(folder / LOG))
        shutil.rmtree(folder, ignore_errors=True)
        self._ended.put((job, outcome))

    def _outcome(self, job: Job, folder: Path) -> Outcome:
        try:
            worker = self._worker(job)
        except (OSError, EOFError, psutil.Error) as error:
            died = "the process that it is forked from was killed (out of memory?)"
            reason = died if isinstance(error, EOFError) else describe(error)
            return Outcome(error=f"its process could not be started: {reason}", lost=True)

        def tell(phase: Phase) -> None:
            self._phases[job.name] = phase
            self.heard(job.name, phase)

        outcome = worker.do(self._work, job, folder, self.timeout, tell)
        if outcome.error or job.plugins or worker.jobs >= MOST_JOBS or not worker.can_go_on():
            worker.end()
        else:
            self._idle.append(worker)
        return outcome

    def _worker(self, job: Job) -> Worker:
        """Return a worker for the job: a fresh one where it needs plug-ins."""
        with contextlib.suppress(IndexError):
            worker = self._idle.pop()
            if not job.plugins:
                return worker
            worker.end()
        return Worker(self._server)


class Worker:
    """The run's side of a worker. `jobs`: how many it has done.
    Raises OSError, EOFError or psutil's errors where it cannot be started."""

    def __init__(self, server: Server) -> None:
        self.jobs, self._reusable, self._stopped = 0, False, False
        self._server = server
        self.pid, self._connection = server.fork()
        self._process = psutil.Process(self.pid)

    def can_go_on(self) -> bool:
        """Return whether the last job left nothing in the process that could reach the next one."""
        return self._reusable and not self._stopped and not descendants(self.pid)

    def do(
        self, work: str, job: Job, folder: Path, timeout: float | None, tell: Callable[[Phase], None]
    ) -> Outcome:
        """Return the outcome of a job, whatever becomes of the worker. `tell`: called with each phase."""
        self.jobs, received = self.jobs + 1, False
        timer = threading.Timer(threading.TIMEOUT_MAX if timeout is None else timeout, self._stop)
        timer.daemon = True
        timer.start()
        try:
            self._connection.send((work, job, folder))
            received = True
            while (message := self._message()).outcome is None:
                tell(message.phase)
            self._reusable = message.reusable
            return message.outcome
        except Exception:  # of a process that ended, or of a job that wrote here
            reason = f"it was stopped after {timeout:g} s" if self._stopped else self._why_ended()
            return Outcome(error=reason, lost=not received)
        finally:
            timer.cancel()

    def _message(self) -> Message:
        """Return the next message. Raises EOFError where the process has ended, be it that one which it
        started holds the connection open."""
        alive = True
        while not self._connection.poll(LOOK_EVERY if alive else 0):
            if not alive:
                raise EOFError
            alive = is_alive(self._process)
        return msgspec.msgpack.decode(self._connection.recv_bytes(LONGEST_MESSAGE), type=Message)

    def _stop(self) -> None:
        self._stopped = True
        self._kill()

    def _why_ended(self) -> str:
        with contextlib.suppress(psutil.Error):
            self._process.wait(LOOK_EVERY)
        if is_alive(self._process):
            return "it closed its connection to the run, or wrote to it"
        code = self._server.exit_code(self.pid)
        if code is None or code >= 0:
            return "its process ended without a result" + (f", exit code {code}" if code is not None else "")
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"its process was killed by {name}{' (out of memory?)' if name == 'SIGKILL' else ''}"

    def end(self) -> None:
        """End the process and what it started, whatever they do."""
        self._kill()
        self._server.exit_code(self.pid)
        self._connection.close()

    def _kill(self) -> None:
        if is_alive(self._process):
            kill_descendants(self.pid)
            with contextlib.suppress(psutil.Error):
                self._process.kill()


def _printed(log: Path) -> bytes:
    """Return what is in the log; of a long one the end."""
    with contextlib.suppress(OSError), opened(log) as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - LONGEST_LOG))
        return file.read()
    return b""
