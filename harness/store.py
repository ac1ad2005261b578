"""The directory of a run: one writer, whole files, checksums. See `harness.results` for its layout."""

from __future__ import annotations

import dataclasses
import errno
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout, lock_descriptor

from harness.codec import decode, encode, printable
from harness.environment import numeric
from harness.files import appending, opened, read, sha256, unfinished, write_atomic
from harness.keys import REPORT_PACKAGES, REPORT_SOURCES, cell_key, key_of, origin, versions
from harness.registry import BadInput
from harness.request import FOLDERS, LOCK, REQUEST, Request, existing, merged, write_request
from harness.results import Cell, CellResult

LOG = "run.log"
"""What the cells' processes print, full tracebacks included."""
SUMS = "SHA256SUMS"
REPORT_KEY = "report.key"
REBUILT = ("scores.csv", "leaderboard.csv", "leaderboard.md", "report.html", REPORT_KEY)
"""Beside figures, what is rebuilt from cells."""


class RunDirectory:
    """A run's directory. Made by `open_for_run`, `open_for_report` and `open_to_verify`.

    request: what its run.json says. key: what cells must have been computed under to count; '' where all do.
    """

    def __init__(self, path: Path, request: Request, key: str = "") -> None:
        self.path, self.request, self.key = path, request, key

    def save(self, result: CellResult) -> None:
        """Stores a cell's result. Raises OSError where it cannot be written, TypeError for no JSON."""
        if not (self.path / REQUEST).is_file():
            raise OSError(errno.ENOENT, f"moved or deleted; cannot store {result.cell.name}", str(self.path))
        keyed = dataclasses.replace(result, key=self.key, origin=origin())
        name = f"cells/{result.cell.name}.json"
        write_atomic(self.path / name, encode(keyed))
        noted = [(sha256(self.path / name), name)]
        noted += [(digest, f"recordings/{file}") for file, digest in result.recordings.items()]
        with appending(self.path / SUMS) as sums:
            sums.write(_lines(noted).encode())

    def load(self) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """Every stored cell, sorted, and why the files that hold no cell for this run do not."""
        results: dict[Cell, CellResult] = {}
        unusable: dict[Path, str] = {}
        for path in self._cell_files():
            try:
                result = self._load(path)
                results[result.cell] = result
            except (ValueError, OSError) as error:
                unusable[path] = _reason(error)
        return dict(sorted(results.items())), unusable

    def seal(self, results: Sequence[CellResult], files: Iterable[Path]) -> None:
        """Notes what the run holds: these results and `files`, rebuilt from them by this version."""
        write_atomic(self.path / REPORT_KEY, _report_key(results))
        cells = [self.path / "cells" / f"{result.cell.name}.json" for result in results]
        recordings = [self.path / "recordings" / name for result in results for name in result.recordings]
        written = [self.path / REPORT_KEY, *files, *cells, *filter(Path.is_file, recordings)]
        names = sorted(file.relative_to(self.path).as_posix() for file in written)
        write_atomic(self.path / SUMS, _lines((sha256(self.path / name), name) for name in names))

    def is_sealed(self, results: Sequence[CellResult]) -> bool:
        """Whether all that is rebuilt from cells is as it was written, from these and by this version."""
        try:
            noted = self._noted()
            derived = [name for name in noted if not name.startswith(("cells/", "recordings/"))]
            return (
                REPORT_KEY in derived
                and read(self.path / REPORT_KEY).decode() == _report_key(results)
                and all(_is_ours(name) and sha256(self.path / name) == noted[name] for name in derived)
            )
        except (OSError, ValueError):
            return False

    def damaged(self) -> dict[Path, str]:
        """What is not as it was written, and why. What the run did not write is nobody's damage."""
        results, damaged = self.load()
        for result in results.values():
            damaged |= self._damaged_recordings(result)
        try:
            noted = self._noted()
        except (OSError, ValueError) as error:
            damaged[self.path / SUMS] = _reason(error)
            noted = {}
        for name, digest in noted.items():
            file = self.path / name
            if file not in damaged and (
                reason := _damage(file, digest) if _is_ours(name) else "no file of a run"
            ):
                damaged[file] = reason
        there = [f"cells/{cell.name}.json" for cell in results]
        there += [name for name in REBUILT if (self.path / name).exists()]
        if unlisted := [name for name in there if name not in noted]:
            damaged.setdefault(self.path / SUMS, f"does not list {', '.join(unlisted)}")
        return damaged

    def _cell_files(self) -> list[Path]:
        folder = self.path / "cells"
        try:
            names = os.listdir(folder)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise BadInput(f"cannot read {folder}: {error.strerror}") from error
        return sorted(folder / name for name in names if name.endswith(".json") and not name.startswith("."))

    def _load(self, path: Path) -> CellResult:
        """Raises ValueError or OSError where the file holds no cell of this run."""
        result = decode(read(path))
        if path.stem != result.cell.name:
            raise ValueError(f"holds the cell {result.cell.name}")
        if not self.request.asks_for(result.cell):
            raise ValueError("this run was not asked for it")
        if self.key not in ("", result.key):
            raise ValueError("computed by another version of the program or its packages")
        if self.key and (damaged := self._damaged_recordings(result)):
            raise ValueError(next(iter(damaged.values())))
        return result

    def _noted(self) -> dict[str, str]:
        """Checksums of files by their names. Raises ValueError for anything but such a list."""
        noted = {}
        for line in read(self.path / SUMS).decode().splitlines():
            digest, _, name = line.partition("  ")
            if len(digest) != 64 or not name:
                raise ValueError("damaged")
            noted[name] = digest
        return noted

    def _damaged_recordings(self, result: CellResult) -> dict[Path, str]:
        folder = self.path / "recordings"
        return {
            folder / name: f"the recording {name} is missing or damaged"
            for name, digest in result.recordings.items()
            if _damage(folder / name, digest)
        }


@contextmanager
def open_for_run(path: Path, request: Request) -> Iterator[RunDirectory]:
    """Starts a run in `path`, which is made, or continues the one there; held until the context ends.

    Raises BadInput, having changed nothing, where `path` is no run's directory, or that of a run with
    other conditions or another format, or cannot be written, or is held by another process.
    """
    merged(path, request)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    with held(path):
        grown = merged(path, request)
        for file in filter(os.path.lexists, (path / LOG, path / SUMS)):
            _check_can_append(file)
        for folder in (path, *(path / name for name in FOLDERS)):
            for left_by_a_killed_run in unfinished(folder):
                left_by_a_killed_run.unlink()
        write_request(path, grown)
        with appending(path / SUMS):  # which is there from now on
            pass
        conditions = grown.conditions
        key = cell_key(dataclasses.asdict(conditions), numeric(conditions.deterministic))
        yield RunDirectory(path, grown, key)


@contextmanager
def open_for_report(path: Path) -> Iterator[RunDirectory]:
    """Holds the run in `path` until the context ends. Raises BadInput like `open_for_run`."""
    request = existing(path)
    with held(path):
        yield RunDirectory(path, request)


@contextmanager
def open_to_verify(path: Path) -> Iterator[RunDirectory]:
    """The run in `path`, where nothing is written, not even a lock, but held where a lock is there and can be
    read. Raises BadInput like `open_for_run`."""
    request = existing(path)
    with ExitStack() as stack:
        with suppress(OSError):
            lock = stack.enter_context(opened(path / LOCK))
            if not lock_descriptor(lock.fileno(), blocking=False):
                raise BadInput(_in_use(path))
        yield RunDirectory(path, request)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """This process alone has the directory until the context ends. Raises BadInput where another has it."""
    lock = FileLock(path / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise BadInput(_in_use(path)) from error
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    try:
        with suppress(OSError):
            (path / LOCK).write_text(str(os.getpid()), encoding="ascii")
        yield
    finally:
        lock.release()


def _in_use(path: Path) -> str:
    holder = "?"
    with suppress(OSError):
        holder = printable(read(path / LOCK)[:20].decode(errors="replace").strip()) or "?"
    return f"{path} is in use by another run (process {holder})"


def _lines(noted: Iterable[tuple[str, str]]) -> str:
    return "".join(f"{digest}  {name}\n" for digest, name in noted)


def _is_ours(name: str) -> bool:
    """Whether a run writes files of such names, by their path in its directory."""
    folder, _, file = name.rpartition("/")
    return folder in ("", *FOLDERS) and file not in ("", ".", "..")


def _damage(file: Path, digest: str) -> str:
    """Why it is not as it was written, '' where it is."""
    try:
        return "" if sha256(file) == digest else "its checksum does not match"
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return _reason(error)


def _reason(error: Exception) -> str:
    return printable(getattr(error, "strerror", None) or str(error))


def _report_key(results: Sequence[CellResult]) -> str:
    return key_of(REPORT_SOURCES, [*versions(REPORT_PACKAGES), *map(encode, results)])


def _check_can_append(file: Path) -> None:
    try:
        with appending(file):
            pass
    except OSError as error:
        raise BadInput(f"cannot write to {file}: {error.strerror}") from error
