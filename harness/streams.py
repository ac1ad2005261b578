"""Standard output and error of the command line: what becomes of them never ends the work. A reader that
went away ends the printing, and so does a closed stream; a full disk does too, and is told at the end."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from typing import TextIO

READER_LEFT = {errno.EPIPE, errno.EIO}
"""What writing raises when a pipe's reader, or the terminal, is gone."""


class Lasting(io.TextIOWrapper):
    """Text to a file descriptor until that fails, and from then on to nowhere."""

    lost: OSError | None = None
    """Why it failed."""

    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._lose(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        self.lost = error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def install() -> None:
    """Makes standard output and error of this process lasting ones. Those that are closed lead nowhere, lest
    the next file that is opened takes their place."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = _lasting(1, sys.stdout, "replace")
    sys.stderr = _lasting(2, sys.stderr, "backslashreplace")


def output_was_lost() -> str:
    """Why standard output is not whole, '' where it is or nobody was reading."""
    lost = getattr(sys.stdout, "lost", None)
    return "" if lost is None or lost.errno in READER_LEFT else str(lost.strerror)


def _lasting(handle: int, old: TextIO | None, errors: str) -> Lasting:
    with contextlib.suppress(OSError):
        os.set_blocking(handle, True)
    encoding = getattr(old, "encoding", None) or "utf-8"
    raw = io.FileIO(handle, "w", closefd=False)
    return Lasting(io.BufferedWriter(raw), encoding=encoding, errors=errors, line_buffering=True)
