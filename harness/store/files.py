"""Files that are whole or absent however the process ends, and reading that nothing can block."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from harness.registry import BadInput
from harness.store.codec import printable

LARGEST = 1 << 24
"""Most bytes of a file that is read whole."""
LARGEST_OF_CELL = 1 << 28
"""Most bytes that a cell adds to its run."""
LARGEST_HASHED = 1 << 30
"""Most bytes of a file whose checksum is wanted."""
SUMS = "SHA256SUMS"
"""The name of a list of checksums, as sha256sum writes and reads it."""
_UNFINISHED = re.compile(r"\..+\.[0-9a-f]{16}\.tmp")
"""Names of the files that a killed `write_atomic` leaves."""


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write `path` (text as UTF-8, newlines kept), so that a reader sees the old file or the new one.

    Creates the folder, but not the folder's own. Raises OSError, which names `path`, and leaves `path` as it
    was.
    """
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def is_unfinished(name: str) -> bool:
    """Return whether a killed `write_atomic` left a file of this name."""
    return _UNFINISHED.fullmatch(name) is not None


def remove_unfinished(folder: Path) -> None:
    """Delete the files that a killed `write_atomic` left in the folder, as far as they can be deleted."""
    for path in folder.glob(".*.tmp"):
        if is_unfinished(path.name):
            with suppress(OSError):
                path.unlink()


@contextmanager
def opened(path: Path, most: int | None = None) -> Iterator[BinaryIO]:
    """Open the regular file at `path` for reading.

    Raises OSError for everything else (a link, a pipe, a folder), and for more than `most` bytes.
    """
    with _regular(path, os.O_RDONLY, "rb") as file:
        if most is not None and os.fstat(file.fileno()).st_size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most >> 20} MiB", str(path))
        yield file


@contextmanager
def appending(path: Path) -> Iterator[BinaryIO]:
    """Open the regular file at `path`, made if absent, to write at its end. Raises OSError as `opened`."""
    with _regular(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, "ab") as file:
        yield file


def read(path: Path, most: int = LARGEST) -> bytes:
    """Return the content of the regular file at `path`. Raises OSError as `opened` does."""
    with opened(path, most) as file:
        return file.read()


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


def as_lines(listed: Iterable[tuple[str, str]]) -> str:
    """Return the list of checksums of these digests and names."""
    return "".join(f"{digest}  {name}\n" for digest, name in listed)


def why_damaged(file: Path, digest: str) -> str:
    """Return why the file is not as it was written, '' where it is."""
    try:
        return "" if sha256(file) == digest else "its checksum does not match"
    except FileNotFoundError:
        return "missing"
    except (OSError, ValueError) as error:
        return in_words(error)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder to write into. It is at `path` once the context ends; an exception leaves nothing.

    Raises BadInput where `path` is a link, or anything but an empty folder.
    """
    exists = os.path.lexists(path)
    if path.is_symlink() or (exists and not (path.is_dir() and not os.listdir(path))):
        raise BadInput(f"{path} is there already; give a new folder, or an empty one")
    path = path.absolute()
    above = [folder for folder in path.parents if not folder.exists()]
    temporary = path.parent / f".irl-bench.{secrets.token_hex(8)}.tmp"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        temporary.replace(path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in above:
            with suppress(OSError):
                folder.rmdir()
        raise


def can_write(folder: Path) -> bool:
    """Return whether files can be put into the folder, which need not exist yet."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def in_words(error: Exception) -> str:
    """Return the error in a few words."""
    return printable(getattr(error, "strerror", None) or str(error))


def _regular(path: Path, flags: int, mode: str) -> BinaryIO:
    """Open a regular file: a link is refused, and a pipe without a writer does not block."""
    try:
        handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(error.errno, "it is a link", str(path)) from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return open(handle, mode)  # type: ignore[return-value]  # of a binary mode
