"""Standard output and error of the command line, which never end the work. Printing ends where a reader goes
away, a stream is closed or a disk is full. The end of the command reports a full disk."""

from __future__ import annotations

import errno
import io
import os
import sys


class Lasting(io.TextIOWrapper):
    """Text to a file descriptor until that fails, and from then on to nowhere.

    lost: the error with which it failed. terminal: whether it was one when it was opened.
    """

    lost: OSError | None = None
    terminal = False

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
    """Make standard output and error of this process lasting ones, in UTF-8. Closed ones lead nowhere, lest
    the next file that is opened takes their place."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout, sys.stderr = lasting(1), lasting(2)


def output_was_lost() -> str:
    """Return why standard output is not whole, '' where it is or nobody was reading."""
    stream = sys.stdout
    if not isinstance(stream, Lasting) or stream.lost is None:
        return ""
    reader_left = stream.lost.errno == (errno.EIO if stream.terminal else errno.EPIPE)
    return "" if reader_left else str(stream.lost.strerror)


def lasting(handle: int) -> Lasting:
    """Return the stream to this file descriptor."""
    os.set_blocking(handle, True)
    raw = io.FileIO(handle, "w", closefd=False)
    stream = Lasting(io.BufferedWriter(raw), encoding="utf-8", errors="backslashreplace", line_buffering=True)
    stream.terminal = os.isatty(handle)
    return stream
