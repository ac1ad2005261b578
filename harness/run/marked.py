"""Folders that are this program's own: known by a file in them, and held by one process at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from pathlib import Path

from harness.registry import BadInput
from harness.run.codec import printable
from harness.run.files import locked, read, remove_unfinished, write_atomic
from harness.run.request import LOCK, LOCK_MARK, is_begun


@contextmanager
def open_marked(
    path: Path, marker: str, mark: bytes, what: str, good: Callable[[bytes], bool], unfinished: str
) -> Iterator[None]:
    """Starts what is called `what` in `path`, which is made, or continues the one there; held until the
    context ends. It is known by the file `marker`, at first `mark`, whose content is `good`.
    unfinished: other files that a killed process may have left half-written, a regular expression.

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
        remove_unfinished(path, f"{re.escape(marker)}|{unfinished}")
        if not os.path.lexists(path / marker):
            write_atomic(path / marker, mark)
        yield


@contextmanager
def held(path: Path) -> Iterator[FileIO]:
    """This process alone has the directory, and this lock on it, until the context ends. Raises BadInput
    where another has it."""
    with ExitStack() as stack:
        try:
            lock = stack.enter_context(locked(path / LOCK))
        except OSError as error:
            raise BadInput(f"cannot write to {path}: {LOCK}: {error.strerror}") from error
        if lock is None:
            raise BadInput(in_use(path))
        with suppress(OSError):
            lock.truncate(0)
            lock.write(f"{LOCK_MARK}{os.getpid()}".encode())
        yield lock


def in_use(path: Path) -> str:
    """Who has the directory."""
    holder = "?"
    with suppress(OSError):
        text = read(path / LOCK)[:40].decode(errors="replace").removeprefix(LOCK_MARK)
        holder = printable(text.strip()) or "?"
    return f"{path} is in use by another run (process {holder})"
