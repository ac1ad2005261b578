"""The temporary folder of a run: gone when the run ends or, where the run was killed, when the next one
starts."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import lock_descriptor

from harness.registry import BadInput
from harness.store.files import opened

NO_NUMBERS = "It makes and deletes temporary folders."

PREFIX = "irl-bench-9d1f7c52a3e84b06-"
"""The beginning of the names of our folders and of their locks, which nothing else has by chance."""
LONGEST = 50
"""Bytes of the path of the folder for temporary files, at most. The paths of sockets, which cells may put
below it, may have 107."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a new folder, held by this process until the context ends. Raises BadInput as `base` does."""
    parent = base()
    remove_abandoned(parent)
    lock = parent / f"{PREFIX}{secrets.token_hex(4)}.lock"
    with lock.open("xb") as file:
        lock_descriptor(file.fileno())  # before there is a folder that somebody could take for abandoned
        lock.with_suffix("").mkdir(mode=0o700)
        try:
            yield lock.with_suffix("")
        finally:
            _delete(lock)


def base() -> Path:
    """Return the folder for temporary files. Return the system's where that one's path is long or has odd
    letters. Raises BadInput where none can be written to."""
    for folder in (Path(tempfile.gettempdir()), Path("/tmp"), Path("/var/tmp")):
        if len(os.fsencode(folder)) <= LONGEST and str(folder).isprintable() and os.access(folder, os.W_OK):
            return folder
    raise BadInput("no folder for temporary files with a short path can be written to; set TMPDIR to one")


def remove_abandoned(parent: Path) -> None:
    """Delete what runs of this user that were killed left there: folders whose lock no process holds."""
    for lock in parent.glob(f"{PREFIX}*.lock"):
        with contextlib.suppress(OSError), opened(lock) as file:
            owner = os.fstat(file.fileno()).st_uid
            if owner == _user() and lock_descriptor(file.fileno(), blocking=False):
                _delete(lock)


def _delete(lock: Path) -> None:
    """Delete the folder, and then its lock. Where something is left, the next run goes on with that."""
    shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
    if not os.path.lexists(lock.with_suffix("")):
        lock.unlink(missing_ok=True)


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0  # as Windows says of every file
