"""Opens the directory of a run: to compute, to report, to look, or to plan."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from harness.process.environment import numeric
from harness.registry import BadInput
from harness.registry.keys import cell_keys
from harness.store.cells import LOG
from harness.store.codec import encode
from harness.store.database import FILE, Damaged, Database, move_aside, open_to_read, open_to_write, rescue
from harness.store.files import appending, remove_unfinished
from harness.store.marked import LOCK, has_our_lock, held, shared
from harness.store.request import Request, grown, request_in
from harness.store.store import REBUILT, REQUEST, Store
from harness.store.sums import SUMS

NO_NUMBERS = "It opens what others read and write."

RECORDINGS = "recordings"
"""The folder of a run's directory. It must not lead elsewhere."""
STUDY = "study.json"
"""The file that marks the directory of a study, which holds runs (`harness.reproduce`)."""
EARLIER = "run.json"
"""The file that marks a run of an earlier version."""
MOST_NAMED = 5
"""Most runs that a line names."""


@contextmanager
def open_for_run(path: Path, request: Request, variables: Mapping[str, str] | None = None) -> Iterator[Store]:
    """Start a run in `path`, which is made, or continue the one there; hold it until the context ends.

    `variables`: those of the engine that computes the run. A damaged database is moved aside, and the run
    goes on with what can be read of it. Raises BadInput where that is another kind of directory or a run
    under other conditions, and where `path` cannot be written or another process holds it. Nothing
    has changed then.
    """
    with suppress(Damaged):
        merged(path, request)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    except RecursionError as error:
        raise BadInput(f"cannot write to {path}: it lies in too many folders") from error
    with held(path):
        if os.path.lexists(path / LOG):
            with appending(path / LOG):  # or it is refused, before anything is computed
                pass
        with _open_or_rescue(path) as (database, lost):
            old = _stored(database)
            asked = grown(path, old, request)
            remove_unfinished(path, "|".join(map(re.escape, (SUMS, *REBUILT))))
            remove_unfinished(path / RECORDINGS, r".+\.rrd")
            if asked != old:
                with database.writing():
                    database.put("run", REQUEST, encode(asked))
            if variables is None:
                variables = numeric(asked.conditions.deterministic)
            keys = cell_keys(asked.cells, asked.conditions, variables)
            yield Store(path, asked, database, keys, lost)


@contextmanager
def open_for_report(path: Path) -> Iterator[Store]:
    """Hold the run in `path` until the context ends. Raises BadInput as `open_for_run` does, and for a
    damaged database."""
    _existing(path)
    with held(path), open_to_write(path / FILE) as database:
        yield Store(path, _request_of(database), database)


@contextmanager
def open_to_verify(path: Path) -> Iterator[Store]:
    """Open the run in `path`, where nothing is written, not even a lock; keep writers out until the context
    ends. Raises BadInput as `open_for_report` does."""
    _existing(path)
    with shared(path), open_to_read(path / FILE) as database:
        yield Store(path, _request_of(database), database)


@contextmanager
def open_to_plan(path: Path, request: Request, variables: Mapping[str, str]) -> Iterator[Store]:
    """Open the run that `open_for_run` would start or continue, where nothing is written. Raises BadInput as
    that does, but for what cannot be written, and for a damaged database."""
    asked = merged(path, request)
    keys = cell_keys(asked.cells, asked.conditions, variables)
    with ExitStack() as stack:
        database = Database()
        if holds_run(path):
            stack.enter_context(shared(path))
            database = stack.enter_context(open_to_read(path / FILE))
        yield Store(path, asked, database, keys)


def holds_run(path: Path) -> bool:
    """Return whether the directory `path` holds a run, and not where it is absent, or empty but for what a
    process leaves that was killed at once. Raises BadInput for anything else."""
    try:
        names = {*os.listdir(path)}
        if RECORDINGS in names and _leads_away(path / RECORDINGS):
            raise BadInput(f"cannot use {path}: its {RECORDINGS} is no folder of its own")
        if FILE in names and (path / FILE).lstat().st_size:
            return True
    except OSError as error:
        if not os.path.lexists(path):
            return False
        raise BadInput(f"cannot use {path}: {error.strerror}") from error
    except ValueError as error:
        raise BadInput(f"cannot use {str(path)!r}: {error}") from error
    if not names - {LOCK, FILE, f"{FILE}-journal"} and (not names or has_our_lock(path)):
        return False
    if EARLIER in names:
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
    with shared(path), open_to_read(path / FILE) as database:
        return _request_of(database)


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


@contextmanager
def _open_or_rescue(path: Path) -> Iterator[tuple[Database, dict[Path, str]]]:
    """Open the database in `path` to write it. A damaged one is moved aside, which the second value says, and
    what can be read is copied into a new one."""
    with ExitStack() as stack:
        try:
            database, lost = stack.enter_context(open_to_write(path / FILE)), dict[Path, str]()
            _stored(database)
        except Damaged as error:
            stack.close()
            aside = move_aside(path / FILE)
            database = stack.enter_context(open_to_write(path / FILE))
            rescue(aside, database)
            lost = {aside: f"it was {FILE} and is damaged ({error.why}); what can be read of it is kept"}
        yield database, lost


def _stored(database: Database) -> Request | None:
    """Return the request in the database, None for an absent one. Raises Damaged for a damaged one."""
    try:
        text = database.read("run", REQUEST)
        return None if text is None else request_in(text)
    except ValueError as error:
        raise Damaged(database.file, f"what was asked for: {error}") from error


def _request_of(database: Database) -> Request:
    """Return the request in the database. Raises BadInput for an absent one, as `_stored` for another."""
    request = _stored(database)
    if request is None:
        raise BadInput(f"{database.file} holds no run")
    return request


def _leads_away(folder: Path) -> bool:
    return folder.is_symlink() or not folder.is_dir()
