"""Files that are either whole or absent, however the process ends; and reading that nothing can block."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from filelock import lock_descriptor

from harness.registry import BadInput

LARGEST = 1 << 24
"""Bytes of a file that is read whole, at most."""
LARGEST_OF_CELL = 1 << 28
"""Bytes of all files that a cell adds to its run, at most."""
LARGEST_HASHED = 1 << 30
"""Bytes of a file whose checksum is wanted, at most."""
BLOCK = 1 << 16
"""Bytes of a file that are read next where it is larger than was told, or more if it has more by then."""
_ODD = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags for opening: a link is refused, and a pipe without a writer does not block."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path in `path`'s folder to write to; on leaving, it is synced to disk and becomes `path`.

    Creates the folder, but not the folder's own. On an exception the temporary file is removed and `path`
    stays as it was; an OSError, such as of a full disk, names `path`.
    """
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        _sync(temporary)
        temporary.replace(path)
        with suppress(OSError):  # which not every file system can
            _sync(path.parent)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def unfinished(folder: Path, names: str) -> list[Path]:
    """What `replacing` left in the folder where it was killed, of files with such names.
    names: a regular expression."""
    left = re.compile(rf"\.({names})\.[0-9a-f]{{16}}\.tmp")
    return [path for path in folder.glob(".*") if left.fullmatch(path.name) and _is_plain(path)]


def remove_unfinished(folder: Path, names: str) -> None:
    """Deletes what `unfinished` finds, as far as it can be deleted."""
    for path in unfinished(folder, names):
        with suppress(OSError):
            path.unlink()


def write_atomic(path: Path, data: bytes | str) -> None:
    """Writes `path` (text as UTF-8, its newlines kept) so that a reader finds the old file or the new one."""
    with replacing(path) as temporary:
        temporary.write_bytes(data.encode() if isinstance(data, str) else data)


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """The regular file at `path`, to be read. Raises OSError for all else, be it a link, a pipe or a
    folder."""
    handle = _open(path, os.O_RDONLY)
    with open(handle, "rb") as file:
        yield file


@contextmanager
def opened_below(folder: Path, name: str, most: int = LARGEST_HASHED) -> Iterator[BinaryIO]:
    """Open the regular file `name`, a path of names below `folder`, to be read.

    Raises OSError as `opened` does, for a link anywhere below `folder`, for a path that leaves it, and for
    more than `most` bytes. A hard link is a file like any other.
    """
    path, parts = folder / name, PurePosixPath(name).parts
    if not parts or {"..", "/"} & {*parts}:
        raise OSError(errno.EINVAL, "it leads out of its folder", str(path))
    with ExitStack() as stack:
        place: int | None = None
        if os.open in os.supports_dir_fd:
            for step in (str(folder), *parts[:-1]):
                flags = os.O_RDONLY | os.O_DIRECTORY | (0 if place is None else os.O_NOFOLLOW)
                try:
                    place = os.open(step, flags, dir_fd=place)
                except NotADirectoryError as error:
                    raise OSError(errno.ELOOP, "it lies behind a link", str(path)) from error
                except ValueError as error:  # of a name that no file can have
                    raise OSError(errno.EINVAL, str(error), repr(str(path))) from error
                stack.callback(os.close, place)
        elif any(folder.joinpath(*parts[:count]).is_symlink() for count in range(1, len(parts))):
            raise OSError(errno.ELOOP, "it lies behind a link", str(path))
        handle = _open(path, os.O_RDONLY, place)
        file = stack.enter_context(open(handle, "rb"))
        if os.fstat(handle).st_size > most:
            raise _too_large(path, most)
        yield file


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder to write into, which is at `path` once the context ends; nothing is left on an exception.

    Raises BadInput where `path` is a link, or anything but an empty folder.
    """
    there = os.path.lexists(path)
    if path.is_symlink() or (there and not (path.is_dir() and not os.listdir(path))):
        raise BadInput(f"{path} is there already; give a new folder, or an empty one")
    path = path.absolute()
    above = [] if there else [folder for folder in path.parents if not os.path.lexists(folder)]
    temporary = (path if there else path.parent) / f".irl-bench.{secrets.token_hex(8)}.tmp"
    moved: list[Path] = []
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if there:
            for item in sorted(temporary.iterdir()):
                moved.append(item.rename(path / item.name))
            temporary.rmdir()
        else:
            temporary.rename(path)
    except BaseException:
        for item in (temporary, *moved):
            if item.is_dir():
                shutil.rmtree(item, ignore_errors=True)
            else:
                item.unlink(missing_ok=True)
        for folder in above:
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def appending(path: Path) -> Iterator[FileIO]:
    """The regular file at `path`, made if it is not there, to be written to at its end, each write at once.
    Raises OSError as `opened` does, and for a file that has other names besides."""
    handle = _open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    with open(handle, "ab", buffering=0) as file:
        yield file


def append(path: Path, data: bytes) -> None:
    """Writes `data` at the end of the regular file at `path`. Raises OSError as `appending` does, and where
    not all of it could be written."""
    with appending(path) as file:
        if file.write(data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@contextmanager
def locked(path: Path) -> Iterator[FileIO | None]:
    """The regular file at `path`, made if it is not there, locked by this process until the context ends;
    None where another process holds it. Raises OSError as `appending` does."""
    handle = _open(path, os.O_RDWR | os.O_CREAT)
    with open(handle, "r+b", buffering=0) as file:
        yield file if lock_descriptor(handle, blocking=False) else None


def share_lock(handle: int) -> bool:
    """Whether nobody holds the open file's lock; until it is closed nobody but other readers gets it."""
    try:
        import fcntl
    except ImportError:  # not on Windows
        return lock_descriptor(handle, blocking=False)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def read(path: Path, most: int = LARGEST) -> bytes:
    """Return what is in the regular file at `path`. Raises OSError as `opened` does, and for more."""
    with opened(path) as file:
        # Memory for as much as there is: a read of `most` asks for all of that.
        size = min(os.fstat(file.fileno()).st_size, most)
        data = file.read(size + 1)
        while size < len(data) <= most:  # It has grown, or its size was not told.
            size = len(data)
            data += file.read(min(max(size, BLOCK), most + 1 - size))
    if len(data) > most:
        raise _too_large(path, most)
    return data


def sha256(path: Path) -> str:
    """Of the regular file's content, in hexadecimal. Raises OSError as `opened` does, and for more than
    `LARGEST_HASHED`."""
    with opened(path) as file:
        if os.fstat(file.fileno()).st_size > LARGEST_HASHED:
            raise _too_large(path, LARGEST_HASHED)
        return digest_of(file)


def digest_of(file: BinaryIO) -> str:
    """The SHA-256 of the rest of an open file, in hexadecimal."""
    return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]  # it has readinto


def sha256_of(data: bytes) -> str:
    """In hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def can_write(folder: Path) -> bool:
    """Whether files can be put into the folder, which need not be there yet."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {most >> 20} MiB", str(path))


def _open(path: Path, flags: int, place: int | None = None) -> int:
    """place: the open folder in which the file is looked up by its name."""
    try:
        handle = os.open(path if place is None else path.name, flags | _ODD, 0o666, dir_fd=place)
    except ValueError as error:  # of a name that no file can have
        raise OSError(errno.EINVAL, str(error), repr(str(path))) from error
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(error.errno, "it is a link", str(path)) from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    if flags & (os.O_WRONLY | os.O_RDWR) and os.fstat(handle).st_nlink > 1:
        os.close(handle)
        raise OSError(errno.EMLINK, "it has other names besides (hard links)", str(path))
    return handle


def _is_plain(path: Path) -> bool:
    return stat.S_ISREG(path.lstat().st_mode)


def _sync(path: Path) -> None:
    # Windows syncs only what could be written to, and no folder can.
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
