"""Lists of checksums, as sha256sum writes and reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from harness.store.codec import printable
from harness.store.files import sha256

SUMS = "SHA256SUMS"
"""The name of such a list."""


def as_lines(listed: Iterable[tuple[str, str]]) -> str:
    """Return the list of these digests and names."""
    return "".join(f"{digest}  {name}\n" for digest, name in listed)


def readable(data: bytes) -> dict[str, str]:
    """Return digests by names, from the lines of a list that can be read."""
    lines = (line.partition("  ") for line in data.decode(errors="replace").splitlines())
    return {name: digest for digest, _, name in lines if len(digest) == 64 and name}


def why_damaged(file: Path, digest: str) -> str:
    """Return why the file is not as it was written, '' where it is."""
    try:
        return "" if sha256(file) == digest else "its checksum does not match"
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return in_words(error)


def in_words(error: Exception) -> str:
    """Return the error in a few words."""
    return printable(getattr(error, "strerror", None) or str(error))
