"""Opens the directory of a run: to compute, to report, to look, or to plan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path

from harness.process.environment import numeric
from harness.registry import BadInput
from harness.registry.keys import cell_keys
from harness.store.codec import encode
from harness.store.database import FILE, Database, open_database
from harness.store.files import in_words, remove_unfinished
from harness.store.marked import held, is_new, shared
from harness.store.request import Request, grown, request_in
from harness.store.store import REQUEST, Store

NO_NUMBERS = "It opens what others read and write."

STUDY = "study.json"
"""The file that marks the directory of a study, which holds runs (`harness.benchmarks.reproduce`)."""
EARLIER = "run.json"
"""The file that marks a run of an earlier version."""
MOST_NAMED = 5
"""Most runs that a line names."""


@contextmanager
def open_for_run(path: Path, request: Request, variables: Mapping[str, str] | None = None) -> Iterator[Store]:
    """Start a run in `path`, which is made, or continue the one there; hold it until the context ends.

    `variables`: those of the engine that computes the run.
    Raises BadInput for another kind of directory, a run under other conditions, and a damaged database. It
    does so, too, where `path` cannot be written or another process holds it. Nothing has changed then.
    """
    merged(path, request)
    if (path / "recordings").is_symlink():
        raise BadInput(f"cannot use {path}: its recordings are a link")
    with held(path), open_database(path / FILE, write=True) as database:
        old = _stored(database)
        asked = grown(path, old, request)
        for folder in (path, path / "recordings"):
            remove_unfinished(folder)
        if asked != old:
            with database.writing():
                database.put("run", REQUEST, encode(asked))
        if variables is None:
            variables = numeric(asked.conditions.deterministic)
        yield Store(path, asked, database, cell_keys(asked.cells, asked.conditions, variables))


@contextmanager
def open_for_report(path: Path) -> Iterator[Store]:
    """Hold the run in `path` until the context ends. Raises BadInput as `open_for_run` does."""
    _existing(path)
    with held(path), open_database(path / FILE, write=True) as database:
        yield Store(path, _request_of(database), database)


@contextmanager
def open_to_verify(path: Path) -> Iterator[Store]:
    """Open the run in `path`, where nothing is written, not even a lock; keep writers out until the context
    ends. Raises BadInput as `open_for_report` does."""
    _existing(path)
    with shared(path), open_database(path / FILE) as database:
        yield Store(path, _request_of(database), database)


@contextmanager
def open_to_plan(path: Path, request: Request, variables: Mapping[str, str]) -> Iterator[Store]:
    """Open the run that `open_for_run` would start or continue, where nothing is written. Raises BadInput as
    that does, but for what cannot be written."""
    asked = merged(path, request)
    keys = cell_keys(asked.cells, asked.conditions, variables)
    there = holds_run(path)
    with shared(path) if there else nullcontext(), open_database(path / FILE if there else None) as database:
        yield Store(path, asked, database, keys)


def holds_run(path: Path) -> bool:
    """Return whether the directory `path` holds a run, and not where it is absent, or empty but for what a
    process leaves that was killed at once. Raises BadInput for anything else."""
    try:
        if (path / FILE).is_symlink() or ((path / FILE).exists() and (path / FILE).stat().st_size):
            return True
        if is_new(path, FILE, f"{FILE}-journal"):
            return False
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot use {str(path)!r}: {in_words(error)}") from error
    if (path / EARLIER).exists():
        raise BadInput(
            f"{path} holds a run of an earlier version: its numbers are in scores.csv and leaderboard.csv "
            "(irl_bench.load reads them); give another folder"
        )
    raise BadInput(f"{path} is not empty and holds no run (no {FILE})")


def merged(path: Path, request: Request) -> Request:
    """Return the request of `path` grown by this one. Raises BadInput where they cannot be one run."""
    return grown(path, stored_request(path), request)


def stored_request(path: Path) -> Request | None:
    """Return the request of the run in `path`, None before there is one. Raises BadInput for all else."""
    if not holds_run(path):
        return None
    with shared(path), open_database(path / FILE) as database:
        return _stored(database)


def _existing(path: Path) -> None:
    """Raise BadInput where `path` holds no run; name the runs in its folders."""
    try:
        if holds_run(path):
            return
        why = f"{path} holds no run (no {FILE})"
    except BadInput as error:
        why = str(error)
    if runs := sorted(str(file.parent) for file in path.glob(f"*/{FILE}")):
        more = f" and {len(runs) - MOST_NAMED} more" if len(runs) > MOST_NAMED else ""
        is_study = "a study (its tables: study.md)" if (path / STUDY).exists() else "no run"
        why = f"{path} holds {is_study}; runs in it are {', '.join(runs[:MOST_NAMED])}{more}: name one"
    raise BadInput(why)


def _stored(database: Database) -> Request | None:
    """Return the request in the database, None for an absent one. Raises BadInput for a damaged one."""
    try:
        text = database.read("run", REQUEST)
        return None if text is None else request_in(text)
    except ValueError as error:
        raise BadInput(f"{database.file} is damaged: what was asked for: {error}; move it away") from error


def _request_of(database: Database) -> Request:
    """Return the request in the database. Raises BadInput for an absent one, as `_stored` for another."""
    request = _stored(database)
    if request is None:
        raise BadInput(f"{database.file} holds no run")
    return request
