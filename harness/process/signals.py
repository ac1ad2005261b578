"""Signals that stop a run: the first one stops it cleanly, and later ones do not disturb that."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

NO_NUMBERS = "It ends a run cleanly."

STOPS = (
    *(signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2),
    *(signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, signal.SIGXCPU, signal.SIGPOLL, signal.SIGPWR),
)
"""Signals that would end this process amid its work, and tell of no fault of its own."""


def stop_cleanly() -> None:
    """Make all `STOPS` raise KeyboardInterrupt like Ctrl-C, once. A signal that is ignored, as under nohup,
    or has a handler of its own, stays as it is."""
    for number in STOPS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    ignore_stops()
    raise KeyboardInterrupt


def ignore_stops() -> None:
    """Have these signals do nothing from now on, but for those with a handler that is not Python's."""
    for number in STOPS:
        if threading.current_thread() is threading.main_thread() and signal.getsignal(number) is not None:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def importing() -> Iterator[None]:
    """Let Ctrl-C end this process at once until the context ends. Nothing is begun yet that would have to be
    told or cleaned up, and a KeyboardInterrupt amid imports can come out as another error."""
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    try:
        yield
    finally:
        if interruptible:
            signal.signal(signal.SIGINT, signal.default_int_handler)
