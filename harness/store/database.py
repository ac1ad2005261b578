"""The database of a run: one SQLite file, whose rows have checksums. It may be a stranger's.

`run` holds the request, and what the run's tables were rebuilt from.
`cells` holds the result of each cell, as JSON.
`baseline` holds the results of other runs' cells that the run is shown beside.
`learned` holds what each cell learned (`harness.store.artifacts`).
"""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import LARGEST_OF_CELL, in_words, opened, read, sha256_of

NO_NUMBERS = "It keeps bytes and checks them."

FILE = "run.sqlite"
FORMAT = 9
"""The version of the layout."""
APPLICATION = 0x49524C42
"""The number in SQLite's header that marks a run's database."""
Table = Literal["run", "cells", "baseline", "learned"]
TABLES: tuple[Table, ...] = ("run", "cells", "baseline", "learned")
SCHEMA = {
    table: f"CREATE TABLE {table} (name TEXT PRIMARY KEY NOT NULL, data NOT NULL, sha256 TEXT NOT NULL)"
    for table in TABLES
}
LARGEST_ROW = LARGEST_OF_CELL + (1 << 20)
"""Most bytes of a row."""
LARGEST_FILE = 1 << 35
"""Most bytes of the file."""
POINTS_ELSEWHERE = bytes.fromhex("d9d505f920a163d7")
"""The last bytes of a journal that names another file, which SQLite would delete."""
WAIT = 60.0
"""Seconds to wait for another program that reads the database."""


class Database:
    """An open database, of `open_database`."""

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        self.file, self._connection = file, connection
        self._place = file.stat()

    def rows(self, table: Table) -> Iterator[tuple[str, bytes, str]]:
        """Yield the name and the data of each row, and why it is not as it was written, '' where it is.

        Where the rest cannot be read, a last row without a name says why.
        """
        try:
            for name, data, digest in self._connection.execute(f"SELECT name, data, sha256 FROM {table}"):
                yield _text(name), *_checked(data, digest)
        except sqlite3.Error as error:
            yield "", b"", str(error)

    def digests(self, table: Table) -> dict[str, str]:
        """Return the SHA-256 of each row by its name, as far as they can be read."""
        digests = {}
        with suppress(sqlite3.Error):
            for name, digest in self._connection.execute(f"SELECT name, sha256 FROM {table}"):
                digests[_text(name)] = _text(digest)
        return digests

    def read(self, table: Table, name: str) -> bytes | None:
        """Return the data of a row, None for an absent one. Raises ValueError for a damaged one."""
        statement = f"SELECT data, sha256 FROM {table} WHERE name = ?"
        try:
            row = self._connection.execute(statement, (name,)).fetchone()
        except sqlite3.Error as error:
            raise ValueError(str(error)) from error
        data, why = _checked(*row) if row else (None, "")
        if why:
            raise ValueError(why)
        return data

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Begin a transaction, which ends as a whole with the context, or not at all. Raises OSError where it
        cannot be written, or another file has taken its place."""
        try:
            if not os.path.samestat(self.file.stat(), self._place):
                raise FileNotFoundError
        except OSError as error:
            reason = "moved, deleted or changed while the run goes on"
            raise OSError(errno.ENOENT, reason, str(self.file.parent)) from error
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            with self._connection:
                yield
        except sqlite3.Error as error:
            raise OSError(errno.EIO, str(error), str(self.file)) from error

    def put(self, table: Table, name: str, data: str | bytes) -> None:
        """Write a row in the place of the one of its name, within `writing`."""
        digest = sha256_of(data.encode() if isinstance(data, str) else data)
        self._connection.execute(f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?)", (name, data, digest))

    def delete(self, table: Table, name: str = "") -> None:
        """Delete the row of this name, or all rows, within `writing`."""
        self._connection.execute(f"DELETE FROM {table} WHERE ? IN ('', name)", (name,))


@contextmanager
def open_database(file: Path | None, write: bool = False) -> Iterator[Database]:
    """Open the database of a run, or, without `file`, an empty one in memory.

    To be written, it is created where it is absent, and a transaction that a kill cut off is undone. Else
    nothing is written: such a transaction is undone in a copy. Raises BadInput for any other file, another
    format, and a file that is damaged or cannot be used.
    """
    with ExitStack() as stack:
        try:
            address = stack.enter_context(_address(file, write)) if file else ":memory:"
            connection = stack.enter_context(closing(sqlite3.connect(address, uri=True, timeout=WAIT)))
            connection.isolation_level = None
            connection.text_factory = bytes
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_ROW)
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            if not connection.execute("PRAGMA page_count").fetchone()[0]:
                connection.executescript(
                    f"BEGIN; PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {FORMAT}; "
                    f"{'; '.join(SCHEMA.values())}; COMMIT"
                )
            if why := _why_none(connection):
                raise BadInput(f"{file} {why}")
        except sqlite3.OperationalError as error:
            raise BadInput(f"cannot use {file}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise BadInput(f"{file} is no database of a run, or is damaged: {error}; move it away") from error
        except OSError as error:
            raise BadInput(f"cannot use {file}: {in_words(error)}") from error
        yield Database(file or Path(), connection)


@contextmanager
def _address(file: Path, write: bool) -> Iterator[str]:
    """Yield the address for SQLite. Raises OSError for links, pipes and other irregular files."""
    journal, mode = file.with_name(f"{file.name}-journal"), "rwc" if write else "ro"
    with ExitStack() as stack:
        if not write or os.path.lexists(file):
            with opened(file, LARGEST_FILE):
                pass
        if os.path.lexists(journal):
            left = read(journal, LARGEST_FILE)
            if left.endswith(POINTS_ELSEWHERE):
                raise OSError(errno.EINVAL, f"{journal.name} names another file, which no run's does")
            if left and not write:
                copy, mode = Path(stack.enter_context(TemporaryDirectory())) / FILE, "rw"
                shutil.copyfile(file, copy)
                shutil.copyfile(journal, f"{copy}-journal")
                file = copy
        yield f"{file.absolute().as_uri()}?mode={mode}"


def _why_none(connection: sqlite3.Connection) -> str:
    """Return why this database of a run is incomplete or another program's, '' for a whole one."""
    application, version = (
        connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
    )
    if application != APPLICATION:
        return "is no database of a run"
    if version != FORMAT:
        return f"has format {version}; this version reads {FORMAT}"
    schema = connection.execute("SELECT name, sql FROM sqlite_schema WHERE sql NOT NULL")
    if {_text(name): _text(sql) for name, sql in schema} != SCHEMA:
        return "is damaged: it has other tables than a run's; move it away"
    (message,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    return "" if message == b"ok" else f"is damaged: {' '.join(_text(message).split())}; move it away"


def _text(value: object) -> str:
    """Return what a column holds as printable text."""
    return printable(value.decode(errors="backslashreplace") if isinstance(value, bytes) else str(value))


def _checked(data: object, digest: object) -> tuple[bytes, str]:
    """Return the data of a row, and why it is not as it was written, '' where it is."""
    if isinstance(data, bytes) and sha256_of(data) == _text(digest):
        return data, ""
    return b"", "its checksum does not match"
