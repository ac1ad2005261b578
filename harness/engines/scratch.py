"""The temporary folder of a run: gone when the run ends or, where the run was killed, when the next one
starts."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.registry import BadInput

NO_NUMBERS = "It makes and deletes temporary folders."

PREFIX = "irl-bench-9d1f7c52a3e84b06-"
"""The beginning of the names of our folders, which nothing else has by chance."""
LONGEST = 50
"""Bytes of the path of the folder for temporary files, at most. The paths of sockets, which cells may put
below it, may have 107."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a new folder, locked by this process until the context ends. Raises BadInput as `base` does."""
    parent = base()
    remove_abandoned(parent)
    begun = Path(tempfile.mkdtemp(dir=parent))
    handle = os.open(begun, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)  # before it has a name that somebody could take for abandoned
    folder = begun.rename(parent / f"{PREFIX}{begun.name}")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)


def base() -> Path:
    """Return the folder for temporary files. Return the system's where that one's path is long or has odd
    letters. Raises BadInput where none can be written to."""
    for folder in (Path(tempfile.gettempdir()), Path("/tmp"), Path("/var/tmp")):
        if len(os.fsencode(folder)) <= LONGEST and str(folder).isprintable() and os.access(folder, os.W_OK):
            return folder
    raise BadInput("no folder for temporary files with a short path can be written to; set TMPDIR to one")


def remove_abandoned(parent: Path) -> None:
    """Delete what runs of this user that were killed left there: folders that no process has locked."""
    for folder in parent.glob(f"{PREFIX}*"):
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            stack.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(handle).st_uid == os.geteuid():
                shutil.rmtree(folder, ignore_errors=True)
