"""Processes for cells: each fresh, of one reading of the program, alone in its session, gone when the run is
gone, and so is whatever it started."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import connection, context, forkserver, popen_forkserver, spawn
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import Any

import psutil

from harness.registry import BadInput
from harness.registry.keys import program
from harness.run import orphans
from harness.run.cache import compiled_once
from harness.run.environment import for_cells
from harness.run.scratch import scratch_folder
from harness.run.signals import STOPS, deaf_to, stops_wait

NAME = "irl-bench cell"
SERVER_DIED = 255
"""The exit code of a process whose forkserver died."""
_LINUX = sys.platform == "linux"
_started: set[int] = set()
"""Processes that were started and are not known to have ended."""


@contextmanager
def fresh_processes(preload: str, deterministic: bool = True) -> Iterator[context.BaseContext]:
    """How to start processes; on leaving, none is left. preload: a module to import once for all of them.
    deterministic: with the same instructions on every processor. Raises BadInput where none can be
    started."""
    with (
        as_in_cells(deterministic) as scratch,
        _program_first(scratch / "program"),
        _sockets_in(scratch),
        _without_main(),
        orphans.taken_in(),
    ):
        try:
            with deaf_to(signal.SIGINT):  # which the server inherits
                starter = _starter(preload)
        except OSError as error:
            raise BadInput(f"no process can be started: {error.strerror}") from error
        try:
            yield starter
        finally:
            with deaf_to(*STOPS):
                for child in _cells():
                    child.kill()
                if _LINUX:
                    _stop_server()
                for child in _cells():
                    child.join(orphans.PATIENCE)
                orphans.end_all()


@contextmanager
def as_in_cells(deterministic: bool = True) -> Iterator[Path]:
    """Be in the environment of cells, with a folder for temporary files that goes with the context."""
    with scratch_folder() as scratch:
        (scratch / "tmp").mkdir()
        more = {"TMPDIR": str(scratch / "tmp"), **compiled_once(scratch / "compiled")}
        before, tempfile.tempdir = tempfile.tempdir, more["TMPDIR"]  # which it remembers
        try:
            with for_cells(deterministic, more):
                yield scratch
        finally:
            tempfile.tempdir = before


def begin_cell() -> None:
    """Called first in a cell's process: alone in its session, so that signals to its group are its own; its
    descendants stay its descendants; and without its run it ends, instead of going on for minutes."""
    if hasattr(os, "setsid"):
        os.setsid()
    orphans.take_in(True)

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            orphans.end_descendants()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def bound_memory() -> None:
    """Called in a cell's process: more than the machine has left it gets MemoryError for, and where several
    ask for too much together, the system kills one of them and not the run."""
    if _LINUX:
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        limit = psutil.Process().memory_info().data + psutil.virtual_memory().available
        if most != resource.RLIM_INFINITY:
            limit = min(limit, most)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
        with contextlib.suppress(OSError):  # where containers forbid it
            Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def let_cells_sleep() -> None:
    """Ctrl-Z suspends the cells as well, which are in sessions of their own, until this process goes on."""
    if not hasattr(signal, "SIGTSTP") or signal.getsignal(signal.SIGTSTP) != signal.SIG_DFL:
        return

    def suspend(number: int, frame: FrameType | None) -> None:
        _signal_cells(signal.SIGSTOP)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, suspend)
        _signal_cells(signal.SIGCONT)

    signal.signal(signal.SIGTSTP, suspend)


def _signal_cells(number: int) -> None:
    for pid in list(_started):  # To ask which of them live would wait for what this interrupts.
        with contextlib.suppress(OSError):
            os.killpg(pid, number)


def wake_server() -> None:
    """In case that a cell has suspended the server of processes, without which none starts or ends."""
    if _LINUX and (server := forkserver._forkserver._forkserver_pid):  # type: ignore[attr-defined]
        with contextlib.suppress(OSError):
            os.kill(server, signal.SIGCONT)


def _cells() -> list[BaseProcess]:
    return [process for process in multiprocessing.active_children() if process.name == NAME]


def write_program(folder: Path) -> None:
    """Write `keys.program()` into the folder, which is made."""
    for name, content in program().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


@contextmanager
def _program_first(folder: Path) -> Iterator[None]:
    """Cells' processes import the program from the folder, into which it is written."""
    try:
        write_program(folder)
    except OSError as error:
        raise BadInput(f"cannot write to {folder}: {error.strerror}") from error
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ |= {"PYTHONPATH": os.pathsep.join(paths), "PYTHONSAFEPATH": "1"}
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


@contextmanager
def _sockets_in(folder: Path) -> Iterator[None]:
    """Where multiprocessing puts its own, instead of into a folder that it would make."""
    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    before = config.get("tempdir")
    config["tempdir"] = str(folder)
    try:
        yield
    finally:
        config["tempdir"] = before


@contextmanager
def _without_main() -> Iterator[None]:
    """Processes do not import the main module, as multiprocessing has it: of a script that calls `run` they
    would run all. Cells need nothing of it."""
    prepared = spawn.get_preparation_data

    def without_main(name: str) -> dict[str, Any]:
        return {key: value for key, value in prepared(name).items() if not key.startswith("init_main_from")}

    spawn.get_preparation_data = without_main
    try:
        yield
    finally:
        spawn.get_preparation_data = prepared


def _stop_server() -> None:
    """At once: it would wait for all whom cells started."""
    if server := forkserver._forkserver._forkserver_pid:  # type: ignore[attr-defined]
        with contextlib.suppress(OSError):
            os.kill(server, signal.SIGKILL)
        with contextlib.suppress(OSError):
            forkserver._forkserver._stop()  # type: ignore[attr-defined]
        forkserver._forkserver._forkserver_pid = None  # type: ignore[attr-defined]


def _starter(preload: str) -> context.BaseContext:
    # Elsewhere, forking after the preloaded libraries were imported is not safe.
    if not _LINUX:
        return multiprocessing.get_context("spawn")
    starter = _Context()
    starter.set_forkserver_preload(["harness.run.server", preload])
    forkserver.ensure_running()
    return starter


class _Popen(popen_forkserver.Popen):
    """The exit code comes through a pipe, once; of two threads that ask, and every start of a process asks
    for all others, the second would find the pipe empty and say 255."""

    def __init__(self, process: Any) -> None:
        self._asking = threading.Lock()
        with stops_wait():  # amid a request the server would end with a traceback
            super().__init__(process)
            _started.add(self.pid)

    def poll(self, flag: int = os.WNOHANG) -> int | None:
        if flag != os.WNOHANG:
            connection.wait([self.sentinel])
        with self._asking:
            code = super().poll(os.WNOHANG)
        if code is not None:
            _started.discard(self.pid)
        return code


class _Process(context.ForkServerProcess):
    @staticmethod
    def _Popen(process: Any) -> _Popen:
        return _Popen(process)


class _Context(context.ForkServerContext):
    Process = _Process
