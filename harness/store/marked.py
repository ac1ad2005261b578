"""Folders of this program: each has a file that marks it, and one process at a time holds it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import (
    locked,
    opened,
    read,
    remove_unfinished,
    share_lock,
    unfinished,
    write_atomic,
)

NO_NUMBERS = "It locks folders."

LOCK = ".lock"
LOCK_MARK = "irl-bench "
"""The beginning of a lock's text, before the number of the process that holds it."""


@contextmanager
def open_marked(
    path: Path, marker: str, mark: bytes, what: str, good: Callable[[bytes], bool], others: str
) -> Iterator[None]:
    """Start a `what` in `path`, which is made, or continue the one there; hold it until the context ends.

    `marker`: the file that marks the folder, at first with the content `mark`.
    `good`: a function that says whether the file's content is right.
    `others`: a regular expression for other files that a killed process may leave half-written.
    Raises BadInput, having changed nothing, where `path` is anything else, or cannot be written.
    """
    try:
        new = not os.path.lexists(path) or not os.listdir(path) or is_begun(path, marker)
        if not new and not good(read(path / marker)):
            raise BadInput(f"{path / marker} is damaged")
        path.mkdir(parents=True, exist_ok=True)
    except FileNotFoundError as error:
        raise BadInput(f"{path} is not empty and holds no {what} (no {marker})") from error
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot use {path}: {getattr(error, 'strerror', None) or error}") from error
    except RecursionError as error:
        raise BadInput(f"cannot write to {path}: it lies in too many folders") from error
    with held(path):
        remove_unfinished(path, f"{re.escape(marker)}|{others}")
        if not os.path.lexists(path / marker):
            write_atomic(path / marker, mark)
        yield


def is_begun(path: Path, first: str) -> bool:
    """Return whether the folder holds our lock and nothing else, but for the file `first` half-written: that
    is what a process leaves that was killed at once."""
    names = {file.name for file in path.iterdir()}
    names -= {file.name for file in unfinished(path, re.escape(first))}
    return names == {LOCK} and has_our_lock(path)


def has_our_lock(path: Path) -> bool:
    """Return whether the folder's lock has our text."""
    try:
        return re.fullmatch(rf"({LOCK_MARK}\d{{0,20}})?", read(path / LOCK).decode("latin-1")) is not None
    except OSError:
        return False


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the directory by its lock until the context ends. Raises BadInput where another process does."""
    with ExitStack() as stack:
        try:
            lock = stack.enter_context(locked(path / LOCK))
        except OSError as error:
            raise BadInput(f"cannot write to {path}: {LOCK}: {error.strerror}") from error
        if lock is None:
            raise BadInput(_in_use(path))
        with suppress(OSError):
            lock.truncate(0)
            lock.write(f"{LOCK_MARK}{os.getpid()}".encode())
        yield


@contextmanager
def shared(path: Path) -> Iterator[None]:
    """Keep writers out of the directory until the context ends, as far as its lock can be read. Raises
    BadInput where a process writes there."""
    with ExitStack() as stack:
        with suppress(OSError):
            lock = stack.enter_context(opened(path / LOCK))
            if not share_lock(lock.fileno()):
                raise BadInput(_in_use(path))
        yield


def _in_use(path: Path) -> str:
    holder = "?"
    with suppress(OSError):
        text = read(path / LOCK)[:40].decode(errors="replace").removeprefix(LOCK_MARK)
        holder = printable(text.strip()) or "?"
    return f"{path} is in use by another run (process {holder})"
