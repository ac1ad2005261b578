"""The directory of a run: one writer, a database of results, and files with checksums.

`harness.records` says what lies where.
"""

from __future__ import annotations

import dataclasses
import functools
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from harness.records import CellResult
from harness.registry import BadInput
from harness.registry.keys import report_key
from harness.store.cells import LOG, StoredCells, recordings_of
from harness.store.codec import encode, parsed
from harness.store.database import FILE
from harness.store.files import digest_of, opened_below, read, sha256, sha256_of, write_atomic
from harness.store.sums import SUMS, as_lines, in_words

REQUEST, REPORT = "request", "report"
"""Rows of the database's table `run`."""
REBUILT = ("scores.csv", "leaderboard.csv", "leaderboard.md", "report.html")
"""The files that are rebuilt from cells."""
UNLISTED = (FILE, f"{FILE}-journal", LOG, SUMS)
"""The files of a run that no list of checksums has."""


@dataclasses.dataclass(frozen=True)
class Report:
    """The last report: its cells, and the files that it left."""

    key: str = ""
    """The key of its cells and of the program (`report_key`)."""
    cells: dict[str, str] = dataclasses.field(default_factory=dict)
    """The SHA-256 of each cell's row, rows that are gone included."""
    files: dict[str, str] = dataclasses.field(default_factory=dict)
    """The SHA-256 of each table and recording, by its path in the directory."""

    @property
    def sums(self) -> bytes:
        """The list of checksums."""
        return as_lines((digest, name) for name, digest in sorted(self.files.items())).encode()


class Store(StoredCells):
    """An open run's directory, with its tables and recordings. Made by `harness.store.opening`."""

    @contextmanager
    def opened(self, file: Path) -> Iterator[BinaryIO]:
        """Open a file of the run to read what was written there. Raises BadInput where it is not that."""
        name = file.relative_to(self.path).as_posix()
        try:
            with opened_below(self.path, name) as stream:
                if name not in self._covered:
                    raise ValueError("it has no checksum")
                if digest_of(stream) != self._covered[name]:
                    raise ValueError("its checksum does not match")
                stream.seek(0)
                yield stream
        except (ValueError, OSError) as error:
            raise BadInput(f"{file}: {in_words(error)}") from error

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
        """Note that this version rebuilt `files` from these results, and list their checksums. Cells that
        were noted before and are gone stay noted."""
        self.check()
        listed = {name: digest for result in results for name, digest in recordings_of(result).items()}
        listed |= {file.relative_to(self.path).as_posix(): sha256(file) for file in files}
        cells = self._noted_cells() | self._database.digests("cells")
        report = Report(self._report_key(), cells, listed)
        write_atomic(self.path / SUMS, report.sums)
        with self._database.writing():
            self._database.put("run", REPORT, encode(report))

    def is_sealed(self) -> bool:
        """Return whether all that is rebuilt from cells is as it was written, from these and by this
        version."""
        with suppress(OSError, ValueError):
            report = self._report()
            tables = {name: digest for name, digest in report.files.items() if "recordings/" not in name}
            whole = {*REBUILT} <= tables.keys() and report.key == self._report_key()
            return whole and not self._why_damaged(tables) and read(self.path / SUMS) == report.sums
        return False

    def forgotten(self) -> list[str]:
        """Return the names of cells that were stored once and have no row any more."""
        return sorted(self._noted_cells().keys() - self._database.digests("cells").keys())

    def damaged(self) -> dict[Path, str]:
        """Return why parts of the run are not as they were written, by place."""
        results, damaged = self.load()
        damaged |= self.damaged_files(results.values()) | self.beside()[1]
        damaged |= {self.place(name): "it was stored once and is gone" for name in self.forgotten()}
        if why := self._database.why_damaged():
            damaged.setdefault(self.path / FILE, why)
        try:
            report = self._report()
        except ValueError as error:
            return damaged | {self.place("run", REPORT): str(error)}
        if report.files:
            damaged |= self._why_damaged(report.files | {SUMS: sha256_of(report.sums)})
            if self._database.digests("cells").items() - report.cells.items():
                damaged.setdefault(self.path / REBUILT[0], "cells were stored since it was written")
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

    def _noted_cells(self) -> dict[str, str]:
        with suppress(ValueError):
            return self._report().cells
        return {}

    def _report_key(self) -> str:
        return report_key([sorted(self._database.digests(table).items()) for table in ("cells", "baseline")])
