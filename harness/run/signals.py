"""Signals that stop a run: the first one stops it cleanly, and later ones do not disturb that."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

NO_NUMBERS = "It ends a run cleanly."

_OTHERS = {
    *("SIGKILL", "SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGCONT"),
    *("SIGCHLD", "SIGURG", "SIGWINCH", "SIGINFO", "SIGPIPE", "SIGXFSZ"),
    *("SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE", "SIGABRT", "SIGTRAP", "SIGSYS"),
}
"""Signals that cannot be caught or suspend, are ignored, or tell of a fault of this process."""
STOPS = tuple(sorted(signal.valid_signals() - {getattr(signal, name, None) for name in _OTHERS}))
"""Signals that would end this process amid its work."""


def stop_cleanly() -> None:
    """Make all `STOPS` raise KeyboardInterrupt like Ctrl-C, once. A signal that is ignored, as under nohup,
    or has a handler of its own, stays as it is."""
    for number in STOPS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    ignore_stops()
    raise KeyboardInterrupt


def _ours(numbers: Iterable[signal.Signals]) -> list[signal.Signals]:
    """Return those of these signals whose handlers can be set here, and set again afterwards."""
    if threading.current_thread() is not threading.main_thread():
        return []
    return [number for number in numbers if signal.getsignal(number) is not None]  # else it is not Python's


def ignore_stops() -> None:
    """Have these signals do nothing from now on, but for those with a handler that is not Python's."""
    for number in _ours(STOPS):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def importing() -> Iterator[None]:
    """Ctrl-C ends this process at once until the context ends: nothing is begun yet that would have to be
    told or cleaned up, and a KeyboardInterrupt amid imports can come out as another error."""
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:
        signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        if interruptible:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(128 + number)


@contextmanager
def handlers_kept(*numbers: signal.Signals) -> Iterator[None]:
    """Set these signals' handlers, whatever they are by then, as they were before the context."""
    before = {number: signal.getsignal(number) for number in _ours(numbers)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def deaf_to(*numbers: signal.Signals) -> Iterator[None]:
    """Ignore these signals until the context ends."""
    with handlers_kept(*numbers):
        for number in _ours(numbers):
            signal.signal(number, signal.SIG_IGN)
        yield


@contextmanager
def stops_wait() -> Iterator[None]:
    """A stop that comes before the context ends, comes as it ends."""
    if threading.current_thread() is not threading.main_thread():
        yield  # which no signal interrupts
        return
    came: list[int] = []
    before = {number: handler for number in STOPS if callable(handler := signal.getsignal(number))}
    for number in before:
        signal.signal(number, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
