"""The directory of a run: one writer, whole files, checksums. See `harness.judge.results` for its layout."""

from __future__ import annotations

import dataclasses
import errno
import functools
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

from harness.judge.results import PROGRAM_NAME, REFERENCE, Cell, CellResult, Request, artifact_of, files_of
from harness.registry import BadInput
from harness.registry.keys import report_key, task_of, task_version
from harness.registry.machine import origin
from harness.run.codec import decode, encode
from harness.run.files import (
    LARGEST,
    LARGEST_OF_CELL,
    append,
    digest_of,
    opened_below,
    read,
    sha256,
    sha256_of,
    write_atomic,
)
from harness.run.request import BASELINE, FOLDERS, LOCK, REQUEST, as_text, existing
from harness.run.sums import SUMS, as_lines, in_words, listed_in, named, readable, seal_of, why_damaged

LOG = "run.log"
"""What the cells' processes print, full tracebacks included."""
REPORT_KEY = "report.key"
REBUILT = ("scores.csv", "leaderboard.csv", "leaderboard.md", "report.html", REPORT_KEY)
"""Beside figures, what is rebuilt from cells."""
OF_CELLS = ("cells/", f"{BASELINE}/", "recordings/", "artifacts/")
"""How the names of files begin that a cell wrote."""
Check = Callable[[str, str], None]
"""A function that raises ValueError for the name and the digest of a file that is not as it was written."""
OTHER_VERSION = "computed by another version of the program, its packages or its experts"
CELL_FILE = re.compile(r"[^.]\S*__\S+__seed\d{1,3}(__\S+)?\.json")
"""Names of files that hold a cell."""


class RunDirectory:
    """A run's directory. Made by those of `harness.run.opening`.

    request: what its run.json says. keys: for each cell, what it must have been computed under to count;
    empty where all of one version do.
    """

    def __init__(
        self,
        path: Path,
        request: Request,
        lock: FileIO | None = None,
        keys: Mapping[Cell, str] = MappingProxyType({}),
    ) -> None:
        self.path, self.request, self.lock, self.keys = path, request, lock, keys
        self._version_of = functools.cache(task_version)
        self._checker_once = functools.cache(self._checker)

    def check(self) -> None:
        """Raises OSError where the path leads no more to what was opened: moved, deleted, in another's hands,
        or asked for something else by now."""
        try:
            there = os.stat(self.path / LOCK, follow_symlinks=False)
            same = self.lock is None or os.path.samestat(there, os.fstat(self.lock.fileno()))
            same &= existing(self.path) == self.request
        except (OSError, BadInput):
            same = False
        if not same:
            raise OSError(errno.ENOENT, "moved, deleted or changed while the run goes on", str(self.path))

    def save(self, result: CellResult, files: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Stores a cell's result and its files. Raises OSError where one cannot be written, TypeError for no
        JSON."""
        self.check()
        for name in files_of(result.cell) - result.files.keys():  # of what was computed before
            (self.path / name).unlink(missing_ok=True)
        for name, data in files.items():
            write_atomic(self.path / name, data)
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
        facts: dict[str, object] = {
            "key": self.keys[result.cell],
            "task_version": self._version_of(result.cell.env),
        }
        here = origin()
        there = result.origin | {PROGRAM_NAME: here[PROGRAM_NAME]} if result.origin else here
        facts |= {"origin": there, "finished": now}
        keyed = dataclasses.replace(result, **facts)  # type: ignore[arg-type]
        name = f"cells/{result.cell.name}.json"
        write_atomic(self.path / name, encode(keyed))
        noted = [(sha256(self.path / name), name)]
        noted += [(digest, name) for name, digest in result.files.items()]
        append(self.path / SUMS, as_lines(noted).encode())

    def learned(self, cell: Cell) -> bytes:
        """The artifact of a cell that counts for this run; empty where there is none, or it is damaged."""
        with suppress(OSError, ValueError):
            stored = self._load(self.path / "cells" / f"{cell.name}.json", lambda name, digest: None)
            if stored.artifacts:
                return read(self.path / artifact_of(cell), LARGEST_OF_CELL)
        return b""

    @contextmanager
    def opened(self, file: Path) -> Iterator[BinaryIO]:
        """Open a file of the run to read what was written there. Raises BadInput where `verify` would name
        it."""
        name = file.relative_to(self.path).as_posix()
        try:
            with opened_below(self.path, name) as stream:
                self._checker_once(self._mends)(name, digest_of(stream))
                stream.seek(0)
                yield stream
        except (ValueError, OSError) as error:
            raise BadInput(f"{file}: {in_words(error)}") from error

    def copy(self, file: Path, folder: Path) -> Path:
        """Copy a file that `opened` opens into the folder; return the copy's path."""
        with self.opened(file) as stream, (folder / file.name).open("xb") as copied:
            shutil.copyfileobj(stream, copied)
        return folder / file.name

    def log(self, printed: bytes) -> None:
        """Adds to what jobs printed. Raises OSError where it cannot be written."""
        append(self.path / LOG, printed)

    def load(self) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """Every stored cell, sorted, and why the files that hold no cell for this run do not."""
        return self._loaded(self._mends)

    def _loaded(self, mends: bool) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """As `load`. mends: of `_checker`."""
        results: dict[Cell, CellResult] = {}
        unusable: dict[Path, str] = {}
        check = self._checker(mends)
        for path in self._cell_files():
            try:
                result = self._load(path, check)
                results[result.cell] = result
            except (ValueError, OSError) as error:
                unusable[path] = in_words(error)
        for cell in [] if self.keys else _of_other_versions(results):
            del results[cell]
            unusable[self.path / "cells" / f"{cell.name}.json"] = OTHER_VERSION
        return dict(sorted(results.items())), unusable

    def seal(self, results: Sequence[CellResult], files: Iterable[Path]) -> None:
        """Notes what the run holds: these results, those that they are shown beside, and `files`, rebuilt
        from them by this version. Of cells that were noted before and are not among these, the lines stay."""
        self.check()
        known = {"", *(result.cell.name for result in results)}
        lines = {name: digest for name, digest in self._listed().items() if _cell_of(name) not in known}
        for result in results:
            name = f"cells/{result.cell.name}.json"
            lines[name] = sha256(self.path / name)
            lines |= result.files
        lines |= {f.relative_to(self.path).as_posix(): sha256(f) for f in [*files, *self._baseline_files()]}
        for name, digest in self._listed().items():
            drawn = name.startswith("figures/") and _is_ours(name) and name not in lines
            if drawn and not why_damaged(self.path / name, digest):  # by an earlier report
                (self.path / name).unlink()
        listed = as_lines((digest, name) for name, digest in sorted(lines.items()))
        write_atomic(self.path / REPORT_KEY, f"{self._key_of_report(results)}\n{seal_of(listed.encode())}\n")
        write_atomic(self.path / SUMS, listed + as_lines([(sha256(self.path / REPORT_KEY), REPORT_KEY)]))

    def is_sealed(self, results: Sequence[CellResult]) -> bool:
        """Whether all that is rebuilt from cells is as it was written, from these and by this version."""
        try:
            noted = self._noted()
            key, _ = self._report_key()
            derived = [name for name in noted if not name.startswith(OF_CELLS)]
            return (
                {*REBUILT} <= {*derived}
                and key == self._key_of_report(results)
                and all(_is_ours(name) and sha256(self.path / name) == noted[name] for name in derived)
            )
        except (OSError, ValueError):
            return False

    def is_as_written(self, file: Path) -> bool:
        """Whether a file of the run is there, and as it was noted."""
        digest = self._listed().get(file.relative_to(self.path).as_posix())
        return digest is not None and not why_damaged(file, digest)

    def keep_beside(self, results: Iterable[CellResult]) -> None:
        """Keeps cells of other runs to be shown beside its own, in the place of those that it had. Raises
        OSError where one cannot be written."""
        self.check()
        folder = self.path / BASELINE
        folder.mkdir(exist_ok=True)
        texts = {f"{result.cell.name}.json": encode(result) for result in results}
        for name, text in texts.items():
            write_atomic(folder / name, text)
        noted = ((sha256(folder / name), f"{BASELINE}/{name}") for name in texts)
        append(self.path / SUMS, as_lines(noted).encode())
        for file in self._baseline_files():
            if file.name not in texts:
                file.unlink()

    def beside(self) -> tuple[list[CellResult], dict[Path, str]]:
        """The cells of other runs that it is shown beside, and why files that should hold one do not. A cell
        that the run has itself by now is none."""
        found, unusable, check = [], {}, self._checker(self._mends)
        for path in self._baseline_files():
            try:
                result, *noted = self._decoded(path)
                check(*noted)
            except (ValueError, OSError) as error:
                unusable[path] = in_words(error)
                continue
            if not (self.path / "cells" / path.name).exists():
                found.append(result)
        return found, unusable

    def without_its_own(self, results: Iterable[CellResult]) -> list[Cell]:
        """The cells among these that the run has not itself."""
        own = {path.stem for path in self._cell_files()}
        return [result.cell for result in results if result.cell.name not in own]

    def forgotten(self, results: Iterable[CellResult]) -> list[str]:
        """The names of cells that were stored here, are not among these, and have no file any more."""
        known = {result.cell.name for result in results}
        listed = [Path(name) for name in self._listed() if name.startswith("cells/")]
        cells = [path.stem for path in listed if CELL_FILE.fullmatch(path.name)]
        there = {path.stem for path in self._cell_files()}
        return sorted({*cells} - known - there)

    def why_incomplete(self, results: Sequence[CellResult]) -> str:
        """Why the list of checksums does not tell what was stored here, '' where it does."""
        try:
            noted = self._noted()
        except (OSError, ValueError) as error:
            return in_words(error)
        listed = any(f"cells/{result.cell.name}.json" in noted for result in results)
        return "it lists no cell" if results and not listed else ""

    def damaged(self) -> dict[Path, str]:
        """What is not as it was written, and why. What the run did not write is nobody's damage."""
        results, damaged = self._loaded(mends=True)
        damaged |= self.damaged_files(results.values())
        if read(self.path / REQUEST) != as_text(self.request).encode():
            damaged[self.path / REQUEST] = "it is not as it was written"
        try:
            noted = self._noted()
        except (OSError, ValueError) as error:
            damaged[self.path / SUMS] = in_words(error)
            noted = {}
        if self.why_incomplete(list(results.values())):
            for cell in [cell for cell in self.request.cells if cell not in results]:
                damaged.setdefault(self.path / "cells" / f"{cell.name}.json", "not there, though asked for")
        for name, digest in noted.items():
            file = self.path / name
            if file not in damaged and (
                reason := why_damaged(file, digest) if _is_ours(name) else "no file of a run"
            ):
                damaged[file] = reason
        there = [f"cells/{cell.name}.json" for cell in results]
        reported = any(name in noted or (self.path / name).exists() for name in REBUILT)
        there += REBUILT if reported else ()
        if unlisted := [name for name in there if name not in noted]:
            damaged.setdefault(self.path / SUMS, f"does not list {', '.join(unlisted)}")
        return damaged

    def damaged_files(self, results: Iterable[CellResult]) -> dict[Path, str]:
        """Those of the results' recordings and artifacts that are not as they were written, and why."""
        return {
            self.path / name: damage
            for result in results
            for name, digest in result.files.items()
            if (damage := why_damaged(self.path / name, digest))
        }

    def uncovered(self) -> list[Path]:
        """Files of the kinds that a run writes, but not in its list of checksums: perhaps a user's own."""
        noted, found = self._listed(), []
        for folder, kind in FOLDERS.items():
            names = os.listdir(self.path / folder) if (self.path / folder).is_dir() else []
            ours = re.compile(rf"[^.].*\.{kind}")
            found += [f"{folder}/{name}" for name in names if ours.fullmatch(name)]
        return [self.path / name for name in sorted({*found} - noted.keys())]

    def _baseline_files(self) -> list[Path]:
        return sorted((self.path / BASELINE).glob("*.json"))

    def _cell_files(self) -> list[Path]:
        folder = self.path / "cells"
        try:
            names = os.listdir(folder)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise BadInput(f"cannot read {folder}: {error.strerror}") from error
        ours = tuple(f"{env}{end}" for env in self.request.envs for end in ("__", "."))
        return sorted(folder / n for n in names if CELL_FILE.fullmatch(n) and n.startswith(ours))

    @property
    def _mends(self) -> bool:
        """Return whether the directory was opened to write it, which mends its list of checksums."""
        return self.lock is not None or bool(self.keys)

    def _checker(self, mends: bool) -> Check:
        """Return a function that raises ValueError for a file that the list of checksums does not vouch for.

        mends: accept files that are not in the list, and a damaged list.
        """
        try:
            listed, broken = (self._listed() if mends else self._noted()), ""
        except (OSError, ValueError) as error:
            listed, broken = {}, f"{SUMS}: {in_words(error)}"

        def check(name: str, digest: str) -> None:
            if broken:
                raise ValueError(broken)
            if name not in listed and not mends:
                raise ValueError(f"{SUMS} does not list it")
            if listed.get(name, digest) != digest:
                raise ValueError("its checksum does not match")

        return check

    def _decoded(self, path: Path) -> tuple[CellResult, str, str]:
        """Return the cell in a file, and the file's name and digest. Raises ValueError or OSError where it
        holds none."""
        name = path.relative_to(self.path).as_posix()
        with opened_below(self.path, name, LARGEST) as file:
            data = file.read()
        return decode(data), name, sha256_of(data)

    def _load(self, path: Path, check: Check) -> CellResult:
        """check: of `_checker`. Raises ValueError or OSError where the file holds no cell of this run, or not
        the one that was noted."""
        result, *noted = self._decoded(path)
        if path.stem != result.cell.name:
            raise ValueError(f"holds the cell {result.cell.name}")
        if not self.request.asks_for(result.cell):
            raise ValueError("this run was not asked for it")
        if any(row.protocol != self.request.conditions.protocol for row in result.rows):
            raise ValueError("it was computed under another protocol")
        if self.keys and result.key != self.keys[result.cell]:
            raise ValueError(OTHER_VERSION)
        if self.keys and (damaged := self.damaged_files([result])):
            raise ValueError(f"{min(damaged).relative_to(self.path)} is missing or damaged")
        check(*noted)
        return result

    def _noted(self) -> dict[str, str]:
        """Checksums of files by their names. Raises ValueError for anything but such a list."""
        data = listed_in(self.path / SUMS)
        noted = dict(map(named, data.decode().splitlines()))
        if REPORT_KEY in noted and not why_damaged(self.path / REPORT_KEY, noted[REPORT_KEY]):
            _, seal = self._report_key()
            if seal_of(data[: int(seal.partition(" ")[0])]) != seal:
                raise ValueError("lines of it were changed or are missing")
        return noted

    def _listed(self) -> dict[str, str]:
        """The same, as far as it can be read."""
        try:
            return readable(listed_in(self.path / SUMS))
        except OSError:
            return {}

    def _key_of_report(self, results: Iterable[CellResult]) -> str:
        cells = [self.path / "cells" / f"{result.cell.name}.json" for result in results]
        return report_key([sha256(file) for file in [*cells, *self._baseline_files()]])

    def _report_key(self) -> tuple[str, str]:
        """Which cells and which version the report was built from, and the seal of the list that was written
        then. Raises ValueError where the file is damaged."""
        text = read(self.path / REPORT_KEY).decode()
        found = re.fullmatch(r"([0-9a-f]+)\n(\d{1,9} [0-9a-f]{64})\n", text)
        if not found:
            raise ValueError("damaged")
        return found[1], found[2]


def _of_other_versions(results: Mapping[Cell, CellResult]) -> list[Cell]:
    """Cells that cannot be compared with the rest of their environment, that is of the version of most of its
    references, or of most cells where it has none; nor with those that differ by their seed alone."""
    others = set()
    by_env: dict[str, dict[Cell, str]] = {}
    for cell in sorted(results):
        by_env.setdefault(cell.env, {})[cell] = results[cell].key
    for mine in by_env.values():
        deciding = {cell: key for cell, key in mine.items() if cell.method == REFERENCE} or mine
        task = _most(map(task_of, deciding.values()))
        others |= {cell for cell, key in mine.items() if task_of(key) != task}
        seeds: dict[Cell, dict[Cell, str]] = {}
        for cell in mine.keys() - others:
            seeds.setdefault(dataclasses.replace(cell, seed=0), {})[cell] = mine[cell]
        for its in seeds.values():
            most = _most(key for _, key in sorted(its.items()))
            others |= {cell for cell, key in its.items() if key != most}
    return sorted(others)


def _most(keys: Iterable[str]) -> str:
    """What most are, the first of equals."""
    ((most, _),) = Counter(keys).most_common(1)
    return most


def _cell_of(name: str) -> str:
    """The cell that a listed file belongs to, '' for what is rebuilt from all."""
    folder, _, file = name.partition("/")
    if folder in ("cells", "artifacts"):
        return file.rpartition(".")[0]
    return file.rpartition("__")[0] if folder == "recordings" else ""


def _is_ours(name: str) -> bool:
    """Whether a run writes files of such names, by their path in its directory."""
    folder, _, file = name.rpartition("/")
    return folder in ("", *FOLDERS) and file not in ("", ".", "..")
