"""A worker: a process that does jobs, one after the other, as they come through its connection."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import select
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec

from harness.cell.phases import Phase
from harness.engines.compute import compute, describe, process_restored
from harness.engines.containment import adopt_orphans, bound_memory, kill_descendants
from harness.engines.jobs import Job, Outcome
from harness.store.files import appending

LOG, TEMPORARY = "log", "tmp"
"""In the folder of a job: its printed text, and its temporary files."""


@dataclass(frozen=True)
class Message:
    """The phase of a job or, as the last message, its outcome.
    reusable: whether the worker is as before, and can do another job."""

    phase: Phase = field(default_factory=Phase)
    outcome: Outcome | None = None
    reusable: bool = False


def serve(connection: Connection) -> None:
    """Do jobs until the run closes the connection. A worker is alone in its session: signals to its group
    are its own."""
    os.setsid()
    adopt_orphans()
    process = os.getpid()
    threading.Thread(target=_end_with_run, args=(connection.fileno(),), daemon=True).start()

    def send(message: Message) -> None:
        connection.send_bytes(msgspec.msgpack.encode(message))

    while True:
        try:
            work, job, folder = connection.recv()
        except EOFError:
            return
        before = _traces()
        with process_restored():
            outcome = _do(work, job, folder, lambda phase: send(Message(phase)))
        if os.getpid() != process:  # A copy of the process came back from a job that made it.
            return
        send(Message(outcome=outcome, reusable=_traces() == before))


def _end_with_run(connection: int) -> None:
    """Wait until the run has closed its end of the connection, and end this process, whatever it does."""
    poll = select.poll()
    poll.register(connection, getattr(select, "POLLRDHUP", 0))
    if not poll.poll()[0][1] & select.POLLNVAL:  # which says that a job has closed this end
        kill_descendants()
        os._exit(1)


def _traces() -> list[object]:
    """Return what of a job could reach the next one: handlers of signals, the alarm, and threads."""
    alarm = signal.getitimer(signal.ITIMER_REAL)
    return [*map(signal.getsignal, sorted(signal.valid_signals())), alarm, threading.active_count()]


def _do(work: str, job: Job, folder: Path, tell: Callable[[Phase], None]) -> Outcome:
    """Return the outcome of a job. Its printed text goes to the log in its folder, its temporary files below
    that."""
    try:
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
        bound_memory()
        with appending(folder / LOG) as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        faulthandler.enable()
        return compute(work, job, tell)
    except BaseException as error:
        with contextlib.suppress(BaseException):
            print(f"\n{job.name}:", file=sys.stderr)
            traceback.print_exc()
        return Outcome(error=describe(error))
    finally:
        for stream in (sys.stdout, sys.stderr):  # A process that has told its result may be killed.
            with contextlib.suppress(Exception):
                stream.flush()
