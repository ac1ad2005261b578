"""Processes for cells: each fresh, one thread each, deaf to Ctrl-C, gone when the run is gone."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from multiprocessing import connection, context, forkserver, popen_forkserver
from pathlib import Path
from typing import Any

import psutil

NAME = "irl-bench cell"
FOLDER = "irl-bench-"
"""Start of a temporary folder's name; then comes its process."""
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}
"""Environment of processes that run side by side, whose own threads would only fight for the same cores."""
SAME_INSTRUCTIONS = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_CORETYPE": "Haswell",
    "XLA_FLAGS": f"{ONE_THREAD['XLA_FLAGS']} --xla_cpu_max_isa=AVX2",
}
"""Environment in which libraries use, on all processors that have AVX2, the same instructions."""


@contextlib.contextmanager
def fresh_processes(preload: tuple[str, ...], deterministic: bool = False) -> Iterator[context.BaseContext]:
    """How to start processes; on leaving, none is left. preload: modules to import once for all of them.
    deterministic: with `SAME_INSTRUCTIONS`."""
    variables = ONE_THREAD | (SAME_INSTRUCTIONS if deterministic else {})
    variables |= {"PYTHONHASHSEED": "0"}  # the order in which strings are hashed must not differ between runs
    _remove_what_killed_runs_left()
    with environment(variables), compiled_once():
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            starter = _starter(preload)
        finally:
            signal.signal(signal.SIGINT, before)
        try:
            yield starter
        finally:
            left = [p for p in multiprocessing.active_children() if p.name == NAME]
            for child in left:
                child.kill()
            for child in left:
                child.join(1)
            if sys.platform == "linux":
                forkserver._forkserver._stop()  # type: ignore[attr-defined]


@contextlib.contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """With these variables, and what is added to them, until the context ends."""
    before = os.environ.copy()
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextlib.contextmanager
def compiled_once() -> Iterator[None]:
    """What JAX, imported from now on, compiles, seconds of work, it compiles once for this process and all
    that it starts."""
    with tempfile.TemporaryDirectory(prefix=f"{FOLDER}{os.getpid()}-") as compiled:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = compiled
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        yield


def end_with_parent() -> None:
    """Called in such a process: without it, one whose run was killed would go on for minutes."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def bound_memory() -> None:
    """Called in such a process: more than the machine has left it gets MemoryError for, and where several
    ask for too much together, the system kills one of them and not the run."""
    if sys.platform == "linux":
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        limit = psutil.Process().memory_info().data + psutil.virtual_memory().available
        if most != resource.RLIM_INFINITY:
            limit = min(limit, most)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
        with contextlib.suppress(OSError):  # where containers forbid it
            Path("/proc/self/oom_score_adj").write_text("1000")


def _remove_what_killed_runs_left() -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER}*-*"):
        process = folder.name.removeprefix(FOLDER).partition("-")[0]
        if process.isdecimal() and not psutil.pid_exists(int(process)):
            shutil.rmtree(folder, ignore_errors=True)


def _starter(preload: tuple[str, ...]) -> context.BaseContext:
    # Elsewhere, forking after the preloaded libraries were imported is not safe.
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    starter = _Context()
    starter.set_forkserver_preload(list(preload))
    forkserver.ensure_running()
    return starter


class _Popen(popen_forkserver.Popen):
    """The exit code comes through a pipe, once; of two threads that ask, and every start of a process asks
    for all others, the second would find the pipe empty and say 255."""

    def __init__(self, process: Any) -> None:
        self._asking = threading.Lock()
        super().__init__(process)

    def poll(self, flag: int = os.WNOHANG) -> int | None:
        if flag != os.WNOHANG:
            connection.wait([self.sentinel])
        with self._asking:
            return super().poll(os.WNOHANG)


class _Process(context.ForkServerProcess):
    @staticmethod
    def _Popen(process: Any) -> _Popen:
        return _Popen(process)


class _Context(context.ForkServerContext):
    Process = _Process
