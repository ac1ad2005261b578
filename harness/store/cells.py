"""The results of a run: what is stored of each cell, and which of it counts."""

from __future__ import annotations

import dataclasses
import errno
import functools
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from harness.records import LEARNED, PROGRAM_NAME, Cell, CellResult
from harness.registry import BadInput
from harness.registry.keys import task_version
from harness.registry.machine import origin
from harness.store.codec import decode, encode
from harness.store.database import FILE, Database
from harness.store.files import append, sha256_of, write_atomic
from harness.store.names import files_of
from harness.store.request import Request
from harness.store.sums import in_words, why_damaged
from harness.store.versions import of_other_versions

LOG = "run.log"
"""The file of what the cells' processes print, full tracebacks included."""
OTHER_VERSION = "computed by another version of the program, its packages or its experts"


class StoredCells:
    """The cells of an open run's directory.

    `keys`: for each cell, the key that a result needs to count; empty where all of one version count.
    `lost`: files that were damaged, and why.
    """

    def __init__(
        self,
        path: Path,
        request: Request,
        database: Database,
        keys: Mapping[Cell, str] = MappingProxyType({}),
        lost: Mapping[Path, str] = MappingProxyType({}),
    ) -> None:
        self.path, self.request, self.keys = path, request, keys
        self._database, self._lost = database, lost
        self._identity = self._identity_now()
        self._version_of = functools.cache(task_version)

    def check(self) -> None:
        """Raise OSError where the path leads elsewhere by now: moved, deleted, or in another run's hands."""
        if self._identity_now() != self._identity:
            raise OSError(errno.ENOENT, "moved, deleted or changed while the run goes on", str(self.path))

    def save(self, result: CellResult, files: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Store a cell's result and its files. Raises OSError where one cannot be written, TypeError for
        values that JSON cannot hold."""
        self.check()
        cell, here = result.cell, origin()
        noted = dataclasses.replace(
            result,
            key=self.keys[cell],
            task_version=self._version_of(cell.env),
            origin=result.origin | {PROGRAM_NAME: here[PROGRAM_NAME]} if result.origin else here,
            finished=datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        )
        text = encode(noted)
        for name in files_of(cell) - result.files.keys() - {LEARNED}:  # An earlier result may have left them.
            (self.path / name).unlink(missing_ok=True)
        for name in files.keys() - {LEARNED}:
            write_atomic(self.path / name, files[name])
        with self._database.writing():
            self._database.put("cells", cell.name, text)
            if LEARNED in files:
                self._database.put("learned", cell.name, files[LEARNED])
            else:
                self._database.delete("learned", cell.name)

    def learned(self, cell: Cell) -> bytes:
        """Return what a cell learned, empty where nothing is stored that counts for this run."""
        with suppress(ValueError):
            if (text := self._database.read("cells", cell.name)) is not None:
                return self._learned(self._counting(cell.name, text))
        return b""

    def read_learned(self, result: CellResult) -> dict[str, Any]:
        """Return what a cell learned, by name, as `learned_in` does. Raises BadInput where it is damaged, or
        not what was stored with the result."""
        from harness.store.artifacts import learned_in  # libraries that `verify` needs no memory for

        try:
            return learned_in(self._learned(result), result.cell)
        except (ValueError, MemoryError) as error:
            place = self.place("learned", result.cell.name)
            raise BadInput(f"{place} holds nothing that was learned: {in_words(error)}") from error

    def load(self) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """Return every stored result that counts, sorted, and why others do not, by place."""
        results: dict[Cell, CellResult] = {}
        unusable = dict(self._lost)
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
        self.check()
        with self._database.writing():
            self._database.delete("baseline")
            for result in results:
                self._database.put("baseline", result.cell.name, encode(result))

    def beside(self) -> tuple[list[CellResult], dict[Path, str]]:
        """Return the cells of other runs that the run is shown beside, but for those that it has itself, and
        why other rows are none, by place."""
        results, unusable = [], {}
        own = self._database.digests("cells")
        for name, data, why in self._database.rows("baseline"):
            try:
                result = _decoded(name, data, why)
            except ValueError as error:
                unusable[self.place("baseline", name)] = str(error)
            else:
                results += [result] if name not in own else []
        return results, unusable

    def without_its_own(self, results: Iterable[CellResult]) -> list[Cell]:
        """Return the cells of these results that the run does not have itself."""
        own = self._database.digests("cells")
        return [result.cell for result in results if result.cell.name not in own]

    def log(self, printed: bytes) -> None:
        """Add what jobs printed to the log. Raises OSError where it cannot be written."""
        append(self.path / LOG, printed)

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

    def place(self, *names: str) -> Path:
        """Return how a row of the database is named to people."""
        return (self.path / FILE).joinpath(*names)

    def _identity_now(self) -> tuple[int, int] | None:
        """Return what the database's path leads to."""
        try:
            status = os.stat(self.path / FILE, follow_symlinks=False)
        except OSError:
            return None
        return status.st_dev, status.st_ino

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
