"""Lists of checksums, as sha256sum writes and reads them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from harness.run.codec import printable
from harness.run.files import appending, read, sha256

SUMS = "SHA256SUMS"
"""What such a list is called."""
LARGEST = 1 << 28
"""Bytes of one, at most: more than the largest run can list."""


def listed_in(path: Path) -> bytes:
    """What is in such a list. Raises OSError where it cannot be read."""
    return read(path, LARGEST)


def as_lines(noted: Iterable[tuple[str, str]]) -> str:
    """The list of digests and names."""
    return "".join(f"{digest}  {name}\n" for digest, name in noted)


def named(line: str) -> tuple[str, str]:
    """Name and digest of a line. Raises ValueError where it is none."""
    digest, _, name = line.partition("  ")
    if len(digest) != 64 or not name:
        raise ValueError("damaged")
    return name, digest


def readable(data: bytes) -> dict[str, str]:
    """Digests by names, of the lines of a list that can be read."""
    listed = {}
    for line in data.decode(errors="replace").splitlines():
        with suppress(ValueError):
            name, digest = named(line)
            listed[name] = digest
    return listed


def seal_of(listed: bytes) -> str:
    """Size and digest of a list, by which it is known again."""
    return f"{len(listed)} {hashlib.sha256(listed).hexdigest()}"


def why_damaged(file: Path, digest: str) -> str:
    """Why the file is not as it was written, '' where it is."""
    try:
        return "" if sha256(file) == digest else "its checksum does not match"
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return in_words(error)


def in_words(error: Exception) -> str:
    """In a few words."""
    return printable(getattr(error, "strerror", None) or str(error))


def mend_last_line(sums: Path) -> None:
    """Ends a list, made if it is not there, with a whole line, where a crash left a part of one."""
    with appending(sums) as file:
        data = listed_in(sums)
        if not data.endswith(b"\n"):
            file.truncate(data.rfind(b"\n") + 1)
