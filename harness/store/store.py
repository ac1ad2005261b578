"""The directory of a run: one writer, a database of results, and files with checksums.

`harness.records` says what lies where.
"""

from __future__ import annotations

import dataclasses
import functools
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

from harness.records import LEARNED, PROGRAM_NAME, RESULT, Cell, CellResult
from harness.registry import BadInput
from harness.registry.keys import report_key, task_version
from harness.registry.machine import origin
from harness.store.codec import checksum, decode, encode, parsed
from harness.store.database import FILE, Database
from harness.store.files import (
    LARGEST_HASHED,
    SUMS,
    appending,
    digest_of,
    in_words,
    opened,
    sha256,
    sha256_of,
    why_damaged,
    write_atomic,
)
from harness.store.names import Report, files_of
from harness.store.request import Request
from harness.store.versions import of_other_versions

LOG = "run.log"
"""The file of what the cells' processes print, full tracebacks included."""
OTHER_VERSION = "computed by another version of the program, its packages or its experts"
REQUEST, REPORT = "request", "report"
"""Rows of the database's table `run`."""
REBUILT = ("scores.csv", "leaderboard.csv", "leaderboard.md", "report.html")
"""The files that are rebuilt from cells."""
UNLISTED = (FILE, f"{FILE}-journal", LOG, SUMS)
"""The files of a run that no list of checksums has."""


class Store:
    """An open run's directory. Made by `harness.store.opening`.

    `keys`: for each cell, the key that a result needs to count; empty where all of one version count.
    """

    def __init__(
        self,
        path: Path,
        request: Request,
        database: Database,
        keys: Mapping[Cell, str] = MappingProxyType({}),
    ) -> None:
        self.path, self.request, self.keys = path, request, keys
        self._database = database
        self._version_of = functools.cache(task_version)

    def save(self, result: CellResult, files: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Store a cell's result and its files. Raises OSError where one cannot be written, TypeError for
        values that JSON cannot hold."""
        cell, here = result.cell, origin()
        noted = dataclasses.replace(
            result,
            key=self.keys[cell],
            task_version=self._version_of(cell.env),
            origin=result.origin | {PROGRAM_NAME: here[PROGRAM_NAME]} if result.origin else here,
            finished=datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        )
        text = encode(noted)
        with self._database.writing():
            for name in files_of(cell) - result.files.keys() - {LEARNED}:  # of an earlier result
                (self.path / name).unlink(missing_ok=True)
            for name in files.keys() - {LEARNED}:
                write_atomic(self.path / name, files[name])
            self._database.put("cells", cell.name, text)
            self._database.delete("learned", cell.name)
            if LEARNED in files:
                self._database.put("learned", cell.name, files[LEARNED])

    def handed_on(self, cell: Cell) -> dict[str, bytes]:
        """Return a cell's artifact and result by name, empty where no artifact counts for this run."""
        with suppress(ValueError):
            if (text := self._database.read("cells", cell.name)) is not None:
                learned = self._learned(self._counting(cell.name, text))
                return {LEARNED: learned, RESULT: text} if learned else {}
        return {}

    def read_learned(self, result: CellResult) -> dict[str, Any]:
        """Return what a cell learned, by name, as `learned_in` does. Raises BadInput where it is damaged."""
        from harness.store.artifacts import learned_in  # libraries that `verify` needs no memory for

        try:
            return learned_in(self._learned(result), result.cell)
        except (ValueError, MemoryError) as error:
            place = self.place("learned", result.cell.name)
            raise BadInput(f"{place} holds nothing that was learned: {in_words(error)}") from error

    def load(self) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """Return every stored result that counts, sorted, and why others do not, by place."""
        results, unusable = dict[Cell, CellResult](), dict[Path, str]()
        for name, data, why in self._database.rows("cells"):
            try:
                result = self._counting(name, data, why)
                results[result.cell] = result
            except ValueError as error:
                unusable[self.place(name)] = str(error)
        for cell in [] if self.keys else of_other_versions(results):
            del results[cell]
            unusable[self.place(cell.name)] = OTHER_VERSION
        return dict(sorted(results.items())), unusable

    def keep_beside(self, results: Iterable[CellResult]) -> None:
        """Keep cells of other runs, to be shown beside the run's own, in the place of those that it had.
        Raises OSError where they cannot be written."""
        with self._database.writing():
            self._database.delete("baseline")
            for result in results:
                self._database.put("baseline", result.cell.name, encode(result))

    def beside(self) -> tuple[list[CellResult], dict[Path, str]]:
        """Return the cells of other runs that the run is shown beside, but for those that it has itself, and
        why other rows are none, by place."""
        results, unusable = dict[Cell, CellResult](), dict[Path, str]()
        for name, data, why in self._database.rows("baseline"):
            try:
                result = _decoded(name, data, why)
                results[result.cell] = result
            except ValueError as error:
                unusable[self.place("baseline", name)] = str(error)
        return [results[cell] for cell in self.without_its_own(results.values())], unusable

    def without_its_own(self, results: Iterable[CellResult]) -> list[Cell]:
        """Return the cells of these results that the run does not have itself."""
        own = self._database.digests("cells")
        return [result.cell for result in results if result.cell.name not in own]

    def log(self, printed: bytes) -> None:
        """Add what jobs printed to the log. Raises OSError where it cannot be written."""
        with appending(self.path / LOG) as file:
            file.write(printed)

    def place(self, *names: str) -> Path:
        """Return how a row of the database is named to people."""
        return (self.path / FILE).joinpath(*names)

    @contextmanager
    def opened(self, file: Path) -> Iterator[BinaryIO]:
        """Open a file of the run to read what was written there. Raises BadInput where it is not that."""
        name = file.relative_to(self.path).as_posix()
        with ExitStack() as stack:
            try:
                if file.parent.resolve() not in (self.path.resolve(), self.path.resolve() / "recordings"):
                    raise ValueError("it lies behind a link")
                stream = stack.enter_context(opened(file, LARGEST_HASHED))
                if name not in self._covered:
                    raise ValueError("it has no checksum")
                if digest_of(stream) != self._covered[name]:
                    raise ValueError("its checksum does not match")
                stream.seek(0)
            except (ValueError, OSError) as error:
                raise BadInput(f"{file}: {in_words(error)}") from error
            yield stream

    def copy(self, file: Path, folder: Path) -> Path:
        """Copy a file that `opened` opens into the folder; return the copy's path."""
        with self.opened(file) as stream, (folder / file.name).open("xb") as copied:
            shutil.copyfileobj(stream, copied)
        return folder / file.name

    def is_as_written(self, file: Path) -> bool:
        """Return whether a file of the run is there as it was written."""
        with suppress(BadInput), self.opened(file):
            return True
        return False

    def seal(self, results: Sequence[CellResult], files: Iterable[Path]) -> None:
        """Note that this version rebuilt `files` from these results, and list their checksums."""
        listed = {name: digest for result in results for name, digest in recordings_of(result).items()}
        listed |= {file.relative_to(self.path).as_posix(): sha256(file) for file in files}
        report = Report(report_key(self._digests()), checksum(self._digests()), listed)
        with self._database.writing():
            write_atomic(self.path / SUMS, report.sums)
            self._database.put("run", REPORT, encode(report))

    def is_sealed(self) -> bool:
        """Return whether all that is rebuilt from cells is as it was written, from these and by this
        version."""
        with suppress(OSError, ValueError):
            report = self._report()
            tables = {name: digest for name, digest in report.files.items() if "recordings/" not in name}
            whole = {*REBUILT} <= tables.keys() and report.key == report_key(self._digests())
            tables[SUMS] = sha256_of(report.sums)
            return whole and not self._why_damaged(tables)
        return False

    def damaged(self) -> dict[Path, str]:
        """Return why parts of the run are not as they were written, by place."""
        results, damaged = self.load()
        damaged |= self.damaged_files(results.values()) | self.beside()[1]
        try:
            report = self._report()
        except ValueError as error:
            return damaged | {self.place("run", REPORT): str(error)}
        if report.files:
            damaged |= self._why_damaged(report.files | {SUMS: sha256_of(report.sums)})
            if report.digest != checksum(self._digests()):
                damaged.setdefault(self.path / REBUILT[0], "cells were stored or lost since it was written")
        return damaged

    def damaged_files(self, results: Iterable[CellResult]) -> dict[Path, str]:
        """Return why recordings of the results, and what they learned, are not as they were written, by
        place."""
        damaged: dict[Path, str] = {}
        for result in results:
            damaged |= self._why_damaged(recordings_of(result))
            try:
                self._learned(result)
            except ValueError as error:
                damaged[self.place("learned", result.cell.name)] = str(error)
        return damaged

    def uncovered(self) -> list[Path]:
        """Return the files in the directory and its recordings that no checksum covers: perhaps a user's."""
        there = [file for folder in (self.path, self.path / "recordings") for file in folder.glob("[!.]*")]
        names = {file.relative_to(self.path).as_posix() for file in there if not file.is_dir()}
        return [self.path / name for name in sorted(names - self._covered.keys() - {*UNLISTED})]

    @functools.cached_property
    def _covered(self) -> dict[str, str]:
        """The SHA-256 of each file that has one, by its path in the directory."""
        results = self.load()[0].values()
        covered = {name: digest for result in results for name, digest in recordings_of(result).items()}
        with suppress(ValueError):
            covered |= self._report().files
        return covered

    def _report(self) -> Report:
        """Return what the last report noted. Raises ValueError where that is damaged."""
        text = self._database.read("run", REPORT)
        return Report() if text is None else parsed(text, Report)

    def _digests(self) -> list[list[tuple[str, str]]]:
        return [sorted(self._database.digests(table).items()) for table in ("cells", "baseline")]

    def _counting(self, name: str, data: bytes, why: str = "") -> CellResult:
        """Return the result in a row. Raises ValueError if it is invalid or does not count for this run."""
        result = _decoded(name, data, why)
        if not self.request.asks_for(result.cell):
            raise ValueError("this run was not asked for it")
        if any(row.protocol != self.request.conditions.protocol for row in result.rows):
            raise ValueError("it was computed under another protocol")
        if self.keys and result.key != self.keys[result.cell]:
            raise ValueError(OTHER_VERSION)
        if self.keys and (damaged := self.damaged_files([result])):
            raise ValueError(f"{min(damaged).relative_to(self.path)} is missing or damaged")
        return result

    def _learned(self, result: CellResult) -> bytes:
        """Return what was stored with the result. Raises ValueError where it is damaged, or another's."""
        data = self._database.read("learned", result.cell.name) if result.learned else b""
        if data is None:
            raise ValueError("missing")
        if result.learned and sha256_of(data) != result.learned:
            raise ValueError("it is not the one that its cell has")
        return data

    def _why_damaged(self, digests: Mapping[str, str]) -> dict[Path, str]:
        """Return why files are not as they were written. `digests`: SHA-256, by path in the directory."""
        reasons = {self.path / name: why_damaged(self.path / name, sha) for name, sha in digests.items()}
        return {path: why for path, why in reasons.items() if why}


def recordings_of(result: CellResult) -> dict[str, str]:
    """Return the SHA-256 of each recording of a result, by its path in the directory."""
    return {name: digest for name, digest in result.files.items() if name != LEARNED}


def _decoded(name: str, data: bytes, why: str) -> CellResult:
    """Return the result in a row. Raises ValueError where the row is damaged, or holds another cell."""
    if why:
        raise ValueError(why)
    result = decode(data)
    if name != result.cell.name:
        raise ValueError(f"holds the cell {result.cell.name}")
    return result
