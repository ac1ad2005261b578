"""The temporary folder of a run: gone when the run ends or, where the run was killed, when the next one
starts."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import lock_descriptor

from harness.registry import BadInput
from harness.store.files import opened

NO_NUMBERS = "It makes and deletes temporary folders."

PREFIX = "irl-bench-"
MARKER = ".irl-bench-scratch-9d1f7c52a3e84b06"
"""The file that makes a folder ours to delete, unless somebody holds a lock on it. It says whose the folder
is, what it is called and which one it is, so that copies of the folder are nobody's."""
LONGEST = 50
"""Bytes of the path of the folder for temporary files, at most. The paths of sockets, which processes put
below it, may have 107."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder, held by this process until the context ends. Raises BadInput as `base` does."""
    parent = base()
    remove_abandoned(parent)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    try:
        # Locked before it says anything: whoever finds it written and unlocked finds it abandoned.
        with (folder / MARKER).open("wb", buffering=0) as marker:
            lock_descriptor(marker.fileno())
            marker.write(_mark(folder))
            yield folder
    finally:
        _delete(folder)


def base() -> Path:
    """The folder for temporary files, or the system's where that one's path is too long or is no plain text.
    Raises BadInput where none can be written to."""
    for folder in (Path(tempfile.gettempdir()), Path("/tmp"), Path("/var/tmp")):
        if len(os.fsencode(folder)) <= LONGEST and str(folder).isprintable() and os.access(folder, os.W_OK):
            return folder
    raise BadInput("no folder for temporary files with a short path can be written to; set TMPDIR to one")


def remove_abandoned(parent: Path) -> None:
    """Deletes what runs that were killed left there: this user's folders that carry our marker, as they were
    named when it was written, and that no process holds."""
    with contextlib.suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if entry.name.startswith(PREFIX) and entry.is_dir(follow_symlinks=False):
                with contextlib.suppress(OSError):
                    _remove_if_abandoned(Path(entry.path))


def _remove_if_abandoned(folder: Path) -> None:
    """Raises OSError where it is not ours."""
    with opened(folder / MARKER) as marker:
        ours = folder.lstat().st_uid == _user() and marker.read(1000) == _mark(folder)
        if ours and lock_descriptor(marker.fileno(), blocking=False):
            _delete(folder)


def _delete(folder: Path) -> None:
    """The marker last, and only where all else is gone: the next run goes on with what is left."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != MARKER:
                path.unlink()
        if os.listdir(folder) == [MARKER]:
            (folder / MARKER).unlink()
        folder.rmdir()


def _mark(folder: Path) -> bytes:
    place = folder.stat()
    here = {"folder": folder.name, "device": place.st_dev, "inode": place.st_ino}
    return json.dumps({"owner": _user(), **here}).encode()


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0  # as Windows says of every file
