"""The database of a run: one SQLite file, whose rows have checksums. It may be a stranger's.

`run` holds the request, and what the run's tables were rebuilt from.
`cells` holds the result of each cell, as JSON.
`baseline` holds the results of other runs' cells that the run is shown beside.
`learned` holds what each cell learned (`harness.store.artifacts`).
"""

from __future__ import annotations

import errno
import itertools
import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import LARGEST_OF_CELL, opened, sha256_of
from harness.store.marked import has_our_lock

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
HEADER, ROLLBACK = b"SQLite format 3\0", b"\1\1"
"""The first bytes of a database, and those that say that it has no write-ahead log."""
POINTS_ELSEWHERE = bytes.fromhex("d9d505f920a163d7")
"""The last bytes of a journal that names another file, which SQLite would delete."""
WAIT = 60.0
"""Seconds to wait for another program that reads the database."""


class Damaged(BadInput):
    """A run's database that cannot be read."""

    def __init__(self, file: Path, why: object) -> None:
        self.why = printable(str(why))
        goes_on = "`irl-bench run` moves it aside and goes on with what can be read"
        super().__init__(f"{file} is damaged: {self.why}; {goes_on}")


class Database:
    """An open database. Made by `open_to_read` and `open_to_write`; without arguments, an empty one."""

    def __init__(self, file: Path = Path(), connection: sqlite3.Connection | None = None) -> None:
        self.file = file
        self._connection = connection or sqlite3.connect(":memory:", isolation_level=None)
        if connection is None:
            self.create()

    def create(self) -> None:
        """Create the tables."""
        with self.writing():
            self._connection.execute(f"PRAGMA application_id = {APPLICATION}")
            self._connection.execute(f"PRAGMA user_version = {FORMAT}")
            for statement in SCHEMA.values():
                self._connection.execute(statement)

    def rows(self, table: Table) -> Iterator[tuple[str, bytes, str]]:
        """Yield the name and the data of each row, and why it is not as it was written, '' where it is.

        Where a page is damaged, a last row without a name says why others are missing.
        """
        names, why = set[str](), ""
        for order in ("ASC", "DESC"):  # from both ends towards a damaged page
            try:
                for name, data, digest in self._connection.execute(
                    f"SELECT name, data, sha256 FROM {table} ORDER BY rowid {order}"
                ):
                    if name in names:
                        raise sqlite3.DatabaseError(why or "its pages repeat")
                    names.add(name)
                    yield _as_text(name), *_checked(data, digest)
                break
            except sqlite3.Error as error:
                why = str(error)
        if why:
            yield "", b"", why

    def digests(self, table: Table) -> dict[str, str]:
        """Return the SHA-256 of each row by its name, as far as they can be read."""
        digests = {}
        with suppress(sqlite3.Error):
            for name, digest in self._connection.execute(f"SELECT name, sha256 FROM {table}"):
                digests[_as_text(name)] = _as_text(digest)
        return digests

    def read(self, table: Table, name: str) -> bytes | None:
        """Return the data of a row, None for an absent one. Raises ValueError for a damaged one."""
        statement = f"SELECT data, sha256 FROM {table} WHERE name = ?"
        try:
            row = self._connection.execute(statement, (name,)).fetchone()
        except sqlite3.Error as error:
            raise ValueError(str(error)) from error
        if row is None:
            return None
        data, why = _checked(*row)
        if why:
            raise ValueError(why)
        return data

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Begin a transaction, which ends as a whole with the context, or not at all. Raises OSError where it
        cannot be written."""
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
        except sqlite3.Error as error:
            raise OSError(errno.EIO, str(error), str(self.file)) from error

    def put(self, table: Table, name: str, data: str | bytes) -> None:
        """Write a row in the place of the one of its name, within `writing`."""
        digest = sha256_of(data.encode() if isinstance(data, str) else data)
        self._connection.execute(f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?)", (name, data, digest))

    def delete(self, table: Table, name: str = "") -> None:
        """Delete the row of this name, or all rows, within `writing`."""
        self._connection.execute(f"DELETE FROM {table} WHERE ? IN ('', name)", (name,))

    def why_damaged(self) -> str:
        """Return what is wrong with the file's tables and pages, '' where nothing is."""
        try:
            schema = self._connection.execute("SELECT name, sql FROM sqlite_schema WHERE sql NOT NULL")
            if {_as_text(name): _as_text(sql) for name, sql in schema} != SCHEMA:
                return "it has other tables than a run's"
            (message,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        except sqlite3.Error as error:
            return str(error)
        return "" if message == b"ok" else " ".join(_as_text(message).replace("\\n", " ").split())


@contextmanager
def open_to_read(file: Path) -> Iterator[Database]:
    """Open the database of a run; nothing is written. A transaction that was cut off is undone in a copy.

    Raises BadInput for any other file and for another format, and Damaged where it cannot be read.
    """
    _check(file)
    with ExitStack() as stack:
        try:
            connection = stack.enter_context(_connected(file, "ro"))
            connection.execute("SELECT 1 FROM sqlite_schema")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise Damaged(file, error) from error
            copy = Path(stack.enter_context(TemporaryDirectory())) / FILE
            for there, here in zip(_parts(file), _parts(copy), strict=True):
                shutil.copyfile(there, here)
            connection = stack.enter_context(_connected(copy, "rw"))
        except sqlite3.Error as error:
            raise Damaged(file, error) from error
        yield Database(file, connection)


@contextmanager
def open_to_write(file: Path) -> Iterator[Database]:
    """Open the database of a run, or create it. A transaction that was cut off is undone.

    Raises BadInput for any other file and for another format, and Damaged for one that is not whole.
    """
    if os.path.lexists(file) and file.lstat().st_size:
        _check(file, alone=True)
    try:
        with _connected(file, "rwc") as connection:
            database = Database(file, connection)
            if not connection.execute("PRAGMA page_count").fetchone()[0]:
                database.create()
            if why := database.why_damaged():
                raise Damaged(file, why)
            yield database
    except sqlite3.OperationalError as error:
        raise BadInput(f"cannot write to {file}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise Damaged(file, error) from error


def move_aside(file: Path) -> Path:
    """Give a damaged database, and its journal, a new name, which is returned."""
    names = (file.with_name(f"{FILE}.damaged-{number}") for number in itertools.count(1))
    aside = next(name for name in names if not os.path.lexists(name))
    for there, here in zip(_parts(file), _parts(aside), strict=True):
        with suppress(FileNotFoundError):
            there.rename(here)
    return aside


def rescue(damaged: Path, database: Database) -> None:
    """Copy the rows of a damaged database that can be read."""
    with suppress(sqlite3.Error), _connected(damaged, "rw") as connection, database.writing():
        connection.execute("PRAGMA writable_schema = ON")  # or a file that was cut is not read at all
        for table in TABLES:
            for name, data, why in Database(damaged, connection).rows(table):
                if not why:
                    database.put(table, name, data if table == "learned" else data.decode(errors="replace"))


@contextmanager
def _connected(file: Path, mode: str) -> Iterator[sqlite3.Connection]:
    address = f"{file.absolute().as_uri()}?mode={mode}"
    connection = sqlite3.connect(address, uri=True, timeout=WAIT, isolation_level=None)
    try:
        connection.text_factory = bytes
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_ROW)
        connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        for pragma in ("trusted_schema = OFF", "cell_size_check = ON", f"query_only = {mode == 'ro'}"):
            connection.execute(f"PRAGMA {pragma}")
        yield connection
    finally:
        connection.close()


def _parts(file: Path) -> tuple[Path, Path]:
    """Return the file and its journal."""
    return file, file.with_name(f"{file.name}-journal")


def _check(file: Path, alone: bool = False) -> None:
    """Raise BadInput for other files than a run's database, and Damaged for one with a damaged beginning.
    alone: as of `opened`."""
    try:
        with opened(file, LARGEST_FILE, alone) as stream:
            header = stream.read(100)
        _check_journals(file, alone)
    except OSError as error:
        raise BadInput(f"cannot use {file}: {error.strerror}") from error
    version, application = (int.from_bytes(header[place : place + 4], "big") for place in (60, 68))
    if (header[:16], header[18:20], application) != (HEADER, ROLLBACK, APPLICATION):
        if has_our_lock(file.parent):
            raise Damaged(file, "it does not begin as it was written")
        raise BadInput(f"{file} is no database of a run")
    if version != FORMAT:
        raise BadInput(f"{file} has format {version}; this version reads {FORMAT}")


def _check_journals(file: Path, alone: bool) -> None:
    """Raise OSError for files beside the database that a run does not write, and SQLite would follow."""
    for log in (file.with_name(f"{file.name}-{kind}") for kind in ("wal", "shm")):
        if os.path.lexists(log):
            raise OSError(errno.EINVAL, f"{log.name} lies beside it, which no run writes")
    journal = _parts(file)[1]
    with suppress(FileNotFoundError), opened(journal, LARGEST_FILE, alone) as stream:
        stream.seek(max(0, os.fstat(stream.fileno()).st_size - len(POINTS_ELSEWHERE)))
        if stream.read() == POINTS_ELSEWHERE:
            raise OSError(errno.EINVAL, f"{journal.name} names another file, which no run's does")


def _as_text(value: object) -> str:
    """Return what a column holds as printable text."""
    return printable(value.decode(errors="backslashreplace") if isinstance(value, bytes) else str(value))


def _checked(data: object, digest: object) -> tuple[bytes, str]:
    """Return the data of a row, and why it is not as it was written, '' where it is."""
    if not isinstance(data, bytes):
        return b"", "it is no row of a run"
    return data, "" if sha256_of(data) == _as_text(digest) else "its checksum does not match"
