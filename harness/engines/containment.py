"""Bounds of a process: nothing that it starts outlives it, and it takes no more memory than there is."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import sys
import time
from pathlib import Path

import psutil

NO_NUMBERS = "It ends processes that cells leave behind."

PATIENCE = 5.0
"""Seconds for killed processes to be gone."""
_SET_CHILD_SUBREAPER = 36
"""A request of prctl(2)."""


def adopt_orphans() -> None:
    """Make this process the parent of its descendants whose own parents end, where the system can."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def is_alive(process: psutil.Process) -> bool:
    """Return whether the process has not ended, be it that its parent knows of its end or not."""
    with contextlib.suppress(psutil.Error):
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    return False


def descendants(pid: int | None = None) -> list[psutil.Process]:
    """Return the living processes that this one, or the one of that number, started, and all that those
    started, the oldest first."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return [one for one in psutil.Process(pid).children(recursive=True) if is_alive(one)]
    return []


def kill_descendants(pid: int | None = None) -> None:
    """Kill all `descendants`. The youngest go first, as long as they can be found."""
    deadline = time.monotonic() + PATIENCE
    while (left := descendants(pid)) and time.monotonic() < deadline:
        for process in reversed(left):
            with contextlib.suppress(psutil.Error):
                process.kill()
        time.sleep(0.01)


def bound_memory() -> None:
    """Bound this process to the memory that the machine has left. Beyond it gets MemoryError. Where several
    ask for too much together, the system kills one of them and not the run."""
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = psutil.Process().memory_info().data + psutil.virtual_memory().available
    if most != resource.RLIM_INFINITY:
        limit = min(limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
    with contextlib.suppress(OSError):  # where containers forbid it
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
