"""Processes that cells start and leave behind: none outlives its cell. On Linux the system gives them to
the nearest of their ancestors that takes them in, which a cell's process does while it lives, and the run's
after it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, resource_tracker

import psutil

from harness.registry import BadInput

NO_NUMBERS = "It ends processes that cells leave behind."

PATIENCE = 5.0
"""Seconds for killed processes to be gone."""
_LINUX = sys.platform == "linux"
_SET_CHILD_SUBREAPER, _GET_CHILD_SUBREAPER = 36, 37
"""Of prctl(2)."""
_ours: set[int] = set()
"""This process's children when it began to take in orphans, and itself; empty while it does not."""


@contextmanager
def taken_in() -> Iterator[None]:
    """Descendants whose parents end become this process's children, where the system can do that."""
    try:
        _ours.update([os.getpid(), *(child.pid for child in psutil.Process().children())])
    except (psutil.Error, OSError) as error:
        raise BadInput(f"cannot see this machine's processes: {error}") from error
    before = take_in(True)
    try:
        yield
    finally:
        take_in(before)
        _ours.clear()


def take_in(wanted: bool) -> bool:
    """Has this process take in orphans among its descendants, or not; returns whether it did before."""
    before = ctypes.c_int(0)
    if _LINUX:
        prctl = ctypes.CDLL(None).prctl
        prctl(_GET_CHILD_SUBREAPER, ctypes.byref(before), 0, 0, 0)
        prctl(_SET_CHILD_SUBREAPER, int(wanted), 0, 0, 0)
    return bool(before.value)


def end_descendants(of: int | None = None) -> None:
    """Kill every process that this one, or another, started, and those that they started: these first, which
    nobody finds once the one between is dead."""
    deadline = time.monotonic() + PATIENCE
    with contextlib.suppress(psutil.NoSuchProcess):
        while (found := psutil.Process(of).children(recursive=True)) and time.monotonic() < deadline:
            _kill(found[::-1])


def end_orphans() -> int:
    """Kills those that were taken in, and their descendants. Returns how many there were."""
    if not _LINUX or not _ours:
        return 0
    # Servers of processes may be started again while a run goes on.
    servers = {forkserver._forkserver._forkserver_pid, resource_tracker._resource_tracker._pid}  # type: ignore[attr-defined]
    orphans = [child for child in psutil.Process().children() if child.pid not in _ours | servers]
    _kill([*orphans, *(process for orphan in orphans for process in _descendants(orphan))])
    return len(orphans)


def end_all() -> None:
    """Kills orphans until there are none, for what is killed makes new ones."""
    deadline = time.monotonic() + PATIENCE
    while end_orphans() and time.monotonic() < deadline:
        pass


def _descendants(process: psutil.Process) -> list[psutil.Process]:
    found: list[psutil.Process] = []
    with contextlib.suppress(psutil.Error):
        found = process.children(recursive=True)
    return found


def _kill(processes: list[psutil.Process]) -> None:
    for process in processes:
        with contextlib.suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(processes, timeout=1)
