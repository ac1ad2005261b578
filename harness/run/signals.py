"""Signals that stop a run: the first one stops it cleanly, what follows does not disturb that."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def stop_cleanly() -> None:
    """Makes being terminated, or losing the terminal, raise KeyboardInterrupt like Ctrl-C, once; what is
    ignored, as under nohup, stays so."""
    for number in STOPS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    ignore_stops()
    raise KeyboardInterrupt


def ignore_stops() -> None:
    """From now on none of these signals does anything."""
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def deaf_to(*numbers: signal.Signals) -> Iterator[None]:
    """These signals are ignored until the context ends."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
