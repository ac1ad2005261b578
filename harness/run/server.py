"""Imported first in the process that those of cells are forked from: where the run is killed, the system
tells it, and it ends the cells, whatever they do, and itself."""

import ctypes
import os
import signal
import sys
from types import FrameType

from harness.run.orphans import end_descendants

_SET_SIGNAL_OF_PARENTS_DEATH = 1
"""Of prctl(2)."""


def _end(number: int, frame: FrameType | None) -> None:
    # The signal may come again as another thread of the run ends: amid the killing this would begin anew,
    # find nobody below a cell that is dead by then, and end this process.
    signal.signal(number, signal.SIG_IGN)
    try:
        end_descendants()
    finally:
        os._exit(1)


if sys.platform == "linux":
    signal.signal(signal.SIGUSR1, _end)
    os.register_at_fork(after_in_child=lambda: signal.signal(signal.SIGUSR1, signal.SIG_DFL))
    ctypes.CDLL(None).prctl(_SET_SIGNAL_OF_PARENTS_DEATH, int(signal.SIGUSR1), 0, 0, 0)
