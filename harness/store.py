"""The directory of a run: one writer, whole files, checksums. See `harness.results` for its layout."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from harness.files import sha256, write_atomic
from harness.keys import CELL_SOURCES, REPORT_PACKAGES, REPORT_SOURCES, key_of, origin, versions
from harness.registry import ENVS, METHODS, VARIANTS, BadInput
from harness.results import CONTROLS, FORMAT, REFERENCE, Cell, CellResult, Conditions

LOG = "run.log"
"""What the cells' processes print, full tracebacks included."""

SUMS = "SHA256SUMS"
REPORT_KEY = "report.key"
DERIVED = ("scores.csv", "leaderboard.*", "report.html", "figures/*.png", REPORT_KEY)
"""What is rebuilt from cells, and has its checksums in `SUMS`."""
KEYS = tuple(field.name for field in dataclasses.fields(Conditions))


@dataclass(frozen=True)
class Request:
    """What a run computes; seeds is how many, from 0."""

    methods: tuple[str, ...]
    envs: tuple[str, ...]
    seeds: int
    conditions: Conditions

    @property
    def cells(self) -> list[Cell]:
        """Every cell, the reference and the controls included."""
        methods = (REFERENCE, *CONTROLS, *self.methods)
        return [Cell(e, m, s) for e in self.envs for m in methods for s in range(self.seeds)]


class RunDirectory:
    """A run's directory, held by this process alone. Made by `open_for_run` and `open_for_report`.

    key: what cells must have been computed under to count; '' where all do.
    """

    def __init__(self, path: Path, key: str = "") -> None:
        self.path, self.key = path, key
        for folder in (path, path / "cells", path / "recordings", path / "figures"):
            for left_by_a_killed_run in folder.glob(".*.tmp"):
                left_by_a_killed_run.unlink()

    def save(self, result: CellResult) -> None:
        """Stores a cell's result. Raises OSError where it cannot be written, TypeError for no JSON."""
        keyed = dataclasses.replace(result, key=self.key, origin=origin())
        write_atomic(self.path / "cells" / f"{result.cell.name}.json", encode(keyed))

    def load(self) -> tuple[dict[Cell, CellResult], dict[Path, str]]:
        """Every stored cell, sorted, and why the files that hold no cell for this run do not."""
        results, unusable = {}, {}
        for path in (self.path / "cells").glob("[!.]*.json"):
            try:
                result = decode(path.read_bytes())
                if path.stem != result.cell.name:
                    raise ValueError(f"holds the cell {result.cell.name}")
                if self.key not in ("", result.key):
                    raise ValueError("computed by another version of the program or its packages")
                if self.key and (damaged := self._damaged_recordings(result)):
                    raise ValueError(next(iter(damaged.values())))
                results[result.cell] = result
            except (ValueError, OSError) as error:
                unusable[path] = str(error)
        return dict(sorted(results.items())), unusable

    def seal(self, results: Sequence[CellResult]) -> None:
        """Notes from which cells all that is rebuilt from cells was, and its checksums."""
        write_atomic(self.path / REPORT_KEY, _report_key(results))
        write_atomic(self.path / SUMS, self._sums())

    def is_sealed(self, results: Sequence[CellResult]) -> bool:
        """Whether all that is rebuilt from cells is as it was written, from these and by this version."""
        try:
            written = (self.path / REPORT_KEY).read_text(), (self.path / SUMS).read_text()
        except (OSError, ValueError):
            return False
        return written == (_report_key(results), self._sums())

    def damaged(self) -> dict[Path, str]:
        """What is not as it was written, and why."""
        results, damaged = self.load()
        for result in results.values():
            damaged |= self._damaged_recordings(result)
        noted: dict[str, str] = {}
        try:
            for line in (self.path / SUMS).read_text().splitlines():
                digest, name = line.split("  ", 1)
                noted[name] = digest
        except FileNotFoundError:  # no report yet
            pass
        except (OSError, ValueError):
            damaged[self.path / SUMS] = "damaged"
        there = {file.relative_to(self.path).as_posix(): file for file in self._derived()}
        for name in sorted(noted.keys() | there.keys()):
            if name not in there:
                damaged[self.path / name] = "missing"
            elif noted.get(name) != sha256(there[name]):
                damaged[there[name]] = "its checksum does not match"
        return damaged

    def _sums(self) -> str:
        lines = [f"{sha256(file)}  {file.relative_to(self.path).as_posix()}\n" for file in self._derived()]
        return "".join(lines)

    def _derived(self) -> list[Path]:
        return sorted(file for pattern in DERIVED for file in self.path.glob(pattern))

    def _damaged_recordings(self, result: CellResult) -> dict[Path, str]:
        folder = self.path / "recordings"
        return {
            folder / name: f"the recording {name} is missing or damaged"
            for name, digest in result.recordings.items()
            if "/" in name or not (folder / name).is_file() or sha256(folder / name) != digest
        }


@contextmanager
def open_for_run(path: Path, request: Request) -> Iterator[RunDirectory]:
    """Starts a run in `path`, which is made, or continues the one there; held until the context ends.

    Raises BadInput, having changed nothing, where `path` is no run's directory, or that of a run with
    other conditions or another format, or cannot be written, or is held by another process.
    """
    _merged(path, request)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    with _held(path):
        merged = _merged(path, request)
        data = {"format": FORMAT, **dataclasses.asdict(merged)}
        data |= data.pop("conditions")
        sealed = {"sha256": _checksum(data), **data}
        write_atomic(path / "run.json", json.dumps(sealed, indent=2) + "\n")
        yield RunDirectory(path, key_of(CELL_SOURCES, dataclasses.asdict(merged.conditions)))


@contextmanager
def open_for_report(path: Path, to_write: bool = True) -> Iterator[RunDirectory]:
    """Holds the run in `path` until the context ends. Raises BadInput like `open_for_run`.

    to_write: where not, what cannot be written to, such as an archive, is read without being held.
    """
    if _read_request(path) is None:
        raise BadInput(f"{path} holds no run (no run.json)")
    with _held(path) if to_write or os.access(path, os.W_OK) else nullcontext():
        yield RunDirectory(path)


def encode(result: CellResult) -> str:
    """JSON of the result and its checksum; what is not finite becomes null. Raises TypeError for no JSON."""
    payload = _plain(result.to_json())
    return json.dumps({"sha256": _checksum(payload), "result": payload}, indent=1) + "\n"


def decode(data: bytes | str) -> CellResult:
    """The inverse of `encode`. Raises ValueError for anything that it did not write."""
    try:
        stored = json.loads(data)
        payload = stored["result"]
        if stored["sha256"] != _checksum(payload):
            raise ValueError("its checksum does not match")
        return CellResult.from_json(_nan_for_none(payload))
    except (KeyError, TypeError, AttributeError, RecursionError, json.JSONDecodeError, UnicodeError) as error:
        raise ValueError("it is no stored cell") from error


def _report_key(results: Sequence[CellResult]) -> str:
    return key_of(REPORT_SOURCES, [*versions(REPORT_PACKAGES), *map(encode, results)])


def _checksum(payload: Any) -> str:
    return hashlib.sha256(json.dumps(payload, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _nan_for_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _nan_for_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_nan_for_none(item) for item in value]
    return math.nan if value is None else value


@contextmanager
def _held(path: Path) -> Iterator[None]:
    file = path / ".lock"
    lock = FileLock(file)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        holder = file.read_text().strip() or "?"
        raise BadInput(f"{path} is in use by another run (process {holder})") from error
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    try:
        file.write_text(str(os.getpid()))
        yield
    finally:
        lock.release()


def _merged(path: Path, request: Request) -> Request:
    """The request of `path` grown by this one."""
    old = _read_request(path)
    if old is None:
        return request
    for name in KEYS:
        there, asked = getattr(old.conditions, name), getattr(request.conditions, name)
        if there != asked:
            raise BadInput(f"{path} holds a run with {name} {there}, not {asked}; give another --out")
    return Request(
        methods=_union(METHODS | VARIANTS, old.methods, request.methods),
        envs=_union(ENVS, old.envs, request.envs),
        seeds=max(old.seeds, request.seeds),
        conditions=old.conditions,
    )


def _union(order: dict[str, Any], *lists: tuple[str, ...]) -> tuple[str, ...]:
    names = {name for names in lists for name in names}
    return tuple(name for name in order if name in names) + tuple(sorted(names - order.keys()))


def _read_request(path: Path) -> Request | None:
    """The request stored in `path`; None where nothing is there yet. Raises BadInput for all else."""
    try:
        # A run that was killed before its first file was whole leaves these.
        if all(file.name.startswith((".lock", ".run.json.")) for file in path.iterdir()):
            return None
        text = (path / "run.json").read_bytes()
    except FileNotFoundError as error:
        if not os.path.lexists(path):
            return None
        raise BadInput(f"{path} is not empty and holds no run (no run.json)") from error
    except OSError as error:
        raise BadInput(f"cannot use {path}: {error.strerror}") from error
    except ValueError as error:
        raise BadInput(f"cannot use {str(path)!r}: {error}") from error
    try:
        data = json.loads(text)
        version = data["format"]
        if version == FORMAT:
            if data.pop("sha256") != _checksum(data):
                raise ValueError
            methods, envs = (tuple(map(str, data[key])) for key in ("methods", "envs"))
            return Request(methods, envs, int(data["seeds"]), Conditions(**{key: data[key] for key in KEYS}))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(f"{path / 'run.json'} is damaged") from error
    raise BadInput(f"{path} has format {version!r}; this version reads format {FORMAT}")
