"""Folders of this program: each has a file that marks it, and one process at a time holds it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import in_words, is_unfinished, opened, read, remove_unfinished, write_atomic

NO_NUMBERS = "It locks folders."

LOCK = ".lock"
LOCK_MARK = b"irl-bench "
"""The beginning of a lock's text, before the number of the process that holds it."""


@contextmanager
def open_marked(
    path: Path, marker: str, mark: bytes, what: str, good: Callable[[bytes], bool]
) -> Iterator[None]:
    """Start a `what` in `path`, which is made, or continue the one there; hold it until the context ends.

    `marker`: the file that marks the folder, at first with the content `mark`.
    `good`: a function that says whether the file's content is right.
    Raises BadInput, having changed nothing, where `path` is anything else, or cannot be written.
    """
    try:
        new = is_new(path)
        if not new and not good(read(path / marker)):
            raise BadInput(f"{path / marker} is damaged")
    except FileNotFoundError as error:
        raise BadInput(f"{path} is not empty and holds no {what} (no {marker})") from error
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot use {path}: {in_words(error)}") from error
    with held(path):
        remove_unfinished(path)
        if new:
            write_atomic(path / marker, mark)
        yield


def is_new(path: Path, *begun: str) -> bool:
    """Return whether the folder is absent, or has nothing but what a process leaves that was killed at once:
    our lock, half-written files, and files named `begun`. Raises OSError for anything but a folder."""
    if not os.path.lexists(path):
        return True
    names = {name for name in os.listdir(path) if not is_unfinished(name)}
    if names - {LOCK, *begun}:
        return False
    lock = read(path / LOCK) if LOCK in names else b""
    return not lock or lock.startswith(LOCK_MARK)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the folder, which is made, by its lock until the context ends. Raises BadInput where it cannot be
    written, or another process holds it."""
    with ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            handle = os.open(path / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
            lock = stack.enter_context(open(handle, "r+b", buffering=0))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            lock.truncate(0)
            lock.write(LOCK_MARK + str(os.getpid()).encode())
        except BlockingIOError as error:
            raise BadInput(_in_use(path)) from error
        except (OSError, RecursionError) as error:
            raise BadInput(f"cannot write to {path}: {in_words(error)}") from error
        yield


@contextmanager
def shared(path: Path) -> Iterator[None]:
    """Keep writers out of the folder until the context ends, as far as its lock can be read. Raises BadInput
    where a process writes there."""
    with ExitStack() as stack:
        with suppress(OSError):
            lock = stack.enter_context(opened(path / LOCK))
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise BadInput(_in_use(path)) from error
        yield


def _in_use(path: Path) -> str:
    holder = b""
    with suppress(OSError):
        holder = read(path / LOCK)[:40].removeprefix(LOCK_MARK)
    return f"{path} is in use by another run (process {printable(holder.decode(errors='replace')) or '?'})"
