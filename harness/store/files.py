"""Files that are whole or absent however the process ends, and reading that nothing can block."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from filelock import lock_descriptor

from harness.registry import BadInput

LARGEST = 1 << 24
"""Most bytes of a file that is read whole."""
LARGEST_OF_CELL = 1 << 28
"""Most bytes that a cell adds to its run."""
LARGEST_HASHED = 1 << 30
"""Most bytes of a file whose checksum is wanted."""
_ODD = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags for opening: a link is refused, and a pipe without a writer does not block."""


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write `path` (text as UTF-8, newlines kept), so that a reader sees the old file or the new one.

    Creates the folder, but not the folder's own. Raises OSError, which names `path`, and leaves `path` as it
    was.
    """
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        temporary.write_bytes(data.encode() if isinstance(data, str) else data)
        _sync(temporary)
        temporary.replace(path)
        with suppress(OSError):  # Some file systems cannot sync folders.
            _sync(path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def unfinished(folder: Path, names: str) -> list[Path]:
    """Return the files that a killed `write_atomic` left in the folder, for files whose names match the
    regular expression `names`."""
    left = re.compile(rf"\.({names})\.[0-9a-f]{{16}}\.tmp")
    return [path for path in folder.glob(".*") if left.fullmatch(path.name) and _is_plain(path)]


def remove_unfinished(folder: Path, names: str) -> None:
    """Delete what `unfinished` returns, as far as it can be deleted."""
    for path in unfinished(folder, names):
        with suppress(OSError):
            path.unlink()


@contextmanager
def opened(path: Path, most: int | None = None, alone: bool = False) -> Iterator[BinaryIO]:
    """Open the regular file at `path` for reading.

    alone: refuse a file that has other names (hard links). Raises OSError for everything else (a link, a
    pipe, a folder), and for more than `most` bytes.
    """
    handle = _open(path, os.O_RDONLY, alone)
    with open(handle, "rb") as file:
        if most is not None and os.fstat(handle).st_size > most:
            raise _too_large(path, most)
        yield file


@contextmanager
def opened_below(folder: Path, name: str, most: int = LARGEST_HASHED) -> Iterator[BinaryIO]:
    """Open the regular file `name`, a path below `folder`, for reading.

    Raises OSError as `opened` does, and where a link below `folder` or a path out of it is followed.
    """
    path, relative = folder / name, PurePosixPath(name)
    parts = relative.parts
    if not parts or relative.is_absolute() or ".." in parts:
        raise OSError(errno.EINVAL, "it leads out of its folder", str(path))
    if any(folder.joinpath(*parts[:count]).is_symlink() for count in range(1, len(parts))):
        raise OSError(errno.ELOOP, "it lies behind a link", str(path))
    with opened(path, most) as file:
        yield file


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder to write into. It is at `path` once the context ends; an exception leaves nothing.

    Raises BadInput where `path` is a link, or anything but an empty folder.
    """
    exists = os.path.lexists(path)
    if path.is_symlink() or (exists and not (path.is_dir() and not os.listdir(path))):
        raise BadInput(f"{path} is there already; give a new folder, or an empty one")
    path = path.absolute()
    above = [folder for folder in path.parents if not os.path.lexists(folder)]
    temporary = path.parent / f".irl-bench.{secrets.token_hex(8)}.tmp"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if exists:
            path.rmdir()
        temporary.rename(path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in above:
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def appending(path: Path) -> Iterator[FileIO]:
    """Open the regular file at `path`, made if absent, to write at its end, each write at once.

    Raises OSError as `opened` does, and for a file that has other names.
    """
    handle = _open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, alone=True)
    with open(handle, "ab", buffering=0) as file:
        yield file


def append(path: Path, data: bytes) -> None:
    """Write `data` at the end of the regular file at `path`.

    Raises OSError as `appending` does, and where not all of it could be written.
    """
    with appending(path) as file:
        if file.write(data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@contextmanager
def locked(path: Path) -> Iterator[FileIO | None]:
    """Lock the regular file at `path`, made if absent, until the context ends; None where another process
    holds it. Raises OSError as `appending` does."""
    handle = _open(path, os.O_RDWR | os.O_CREAT, alone=True)
    with open(handle, "r+b", buffering=0) as file:
        yield file if lock_descriptor(handle, blocking=False) else None


def share_lock(handle: int) -> bool:
    """Return whether nobody holds the open file's lock. Until it is closed, only other readers get it."""
    try:
        import fcntl
    except ImportError:  # Windows has no such module.
        return lock_descriptor(handle, blocking=False)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def read(path: Path, most: int = LARGEST) -> bytes:
    """Return the content of the regular file at `path`. Raises OSError as `opened` does."""
    with opened(path, most) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + 1)  # A read of `most` would ask for that much memory.
        if len(data) > size:  # The file has grown.
            data += file.read(max(0, most + 1 - len(data)))
    if len(data) > most:
        raise _too_large(path, most)
    return data


def sha256(path: Path) -> str:
    """Return the regular file's SHA-256, in hexadecimal. Raises OSError as `opened` does, and for more than
    `LARGEST_HASHED` bytes."""
    with opened(path, LARGEST_HASHED) as file:
        return digest_of(file)


def digest_of(file: BinaryIO) -> str:
    """Return the SHA-256 of the rest of an open file, in hexadecimal."""
    return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]  # it has readinto


def sha256_of(data: bytes) -> str:
    """Return the SHA-256 of the data, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def can_write(folder: Path) -> bool:
    """Return whether files can be put into the folder, which need not exist yet."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {most >> 20} MiB", str(path))


def _open(path: Path, flags: int, alone: bool = False) -> int:
    try:
        handle = os.open(path, flags | _ODD, 0o666)
    except ValueError as error:  # No file can have such a name.
        raise OSError(errno.EINVAL, str(error), repr(str(path))) from error
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(error.errno, "it is a link", str(path)) from error
        raise
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    if alone and status.st_nlink > 1:
        os.close(handle)
        raise OSError(errno.EMLINK, "it has other names besides (hard links)", str(path))
    return handle


def _is_plain(path: Path) -> bool:
    return stat.S_ISREG(path.lstat().st_mode)


def _sync(path: Path) -> None:
    # Windows syncs only files that could be written to, and no folders.
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
