"""Processes that strangers' code starts: none outlives the process that it was started in."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import time
from pathlib import Path

import psutil

NO_NUMBERS = "It ends processes."

PATIENCE = 5.0
"""Seconds in which killed processes must be gone."""
_LINUX = sys.platform == "linux"
_SET_CHILD_SUBREAPER = 36
"""An option of prctl(2)."""


def guarded() -> None:
    """Go on in a child, where the system can fork. This process ends as the child does.

    Before that it ends every process that was started there, in other sessions, too.
    """
    if not hasattr(os, "fork"):
        return
    if _LINUX:
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    if not (child := os.fork()):
        return
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    end_descendants(os.getpid())
    if code < 0:
        with contextlib.suppress(OSError):  # SIGKILL has no handler.
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(abs(code))


def end_descendants(pid: int) -> None:
    """Kill every process that this one started, and all of their children, the youngest first."""
    deadline = time.monotonic() + PATIENCE
    with contextlib.suppress(psutil.NoSuchProcess):
        while (children := psutil.Process(pid).children(recursive=True)) and time.monotonic() < deadline:
            for child in reversed(children):
                with contextlib.suppress(psutil.Error):
                    child.kill()
            psutil.wait_procs(children, timeout=1)


def bound_memory() -> None:
    """Let this process take the memory that the machine has left, and no more.

    It gets MemoryError for more, and the system ends it before others.
    """
    if not _LINUX:
        return
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = psutil.Process().memory_info().data + psutil.virtual_memory().available
    if most != resource.RLIM_INFINITY:
        limit = min(limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
    with contextlib.suppress(OSError):  # Containers may forbid it.
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
