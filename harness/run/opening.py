"""Opens the directory of a run: to compute, to report, to look, or to plan."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from harness.judge.results import Request
from harness.registry import BadInput
from harness.registry.keys import cell_keys
from harness.run.environment import numeric
from harness.run.files import appending, opened, remove_unfinished, share_lock
from harness.run.marked import held, in_use
from harness.run.request import FOLDERS, LOCK, REQUEST, existing, merged, write_request
from harness.run.store import LOG, REBUILT, RunDirectory
from harness.run.sums import SUMS, mend_last_line


@contextmanager
def open_for_run(
    path: Path, request: Request, variables: Mapping[str, str] | None = None
) -> Iterator[RunDirectory]:
    """Starts a run in `path`, which is made, or continues the one there; held until the context ends.
    variables: those of the engine that computes it.

    Raises BadInput, having changed nothing, where `path` is no run's directory, or that of a run with
    other conditions or another format, or cannot be written, or is held by another process.
    """
    merged(path, request)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write to {path}: {error.strerror}") from error
    except RecursionError as error:
        raise BadInput(f"cannot write to {path}: it lies in too many folders") from error
    with held(path) as lock:
        grown = merged(path, request)
        for file in filter(os.path.lexists, (path / LOG, path / SUMS)):
            _check_can_append(file)
        remove_unfinished(path, "|".join(map(re.escape, (REQUEST, SUMS, *REBUILT))))
        for folder, kind in FOLDERS.items():
            remove_unfinished(path / folder, rf".+\.{kind}")
        write_request(path, grown)
        mend_last_line(path / SUMS)
        if variables is None:
            variables = numeric(grown.conditions.deterministic)
        yield RunDirectory(path, grown, lock, cell_keys(grown.cells, grown.conditions, variables))


@contextmanager
def open_for_report(path: Path) -> Iterator[RunDirectory]:
    """Holds the run in `path` until the context ends. Raises BadInput like `open_for_run`."""
    request = existing(path)
    with held(path) as lock:
        with suppress(OSError):  # what is no such list is replaced
            mend_last_line(path / SUMS)
        yield RunDirectory(path, request, lock)


@contextmanager
def open_to_verify(path: Path) -> Iterator[RunDirectory]:
    """The run in `path`, where nothing is written, not even a lock, but held where a lock is there and can be
    read. Raises BadInput like `open_for_run`."""
    request = existing(path)
    with _shared(path):
        yield RunDirectory(path, request)


@contextmanager
def open_to_plan(path: Path, request: Request, variables: Mapping[str, str]) -> Iterator[RunDirectory]:
    """The run that `open_for_run` would start or continue, where nothing is written. Raises BadInput as that
    does, but for what cannot be written."""
    grown = merged(path, request)
    with _shared(path):
        yield RunDirectory(path, grown, keys=cell_keys(grown.cells, grown.conditions, variables))


@contextmanager
def _shared(path: Path) -> Iterator[None]:
    """Nobody writes the run in `path` until the context ends, as far as a lock there can be read. Raises
    BadInput where somebody does."""
    with ExitStack() as stack:
        with suppress(OSError):
            lock = stack.enter_context(opened(path / LOCK))
            if not share_lock(lock.fileno()):
                raise BadInput(in_use(path))
        yield


def _check_can_append(file: Path) -> None:
    try:
        with appending(file):
            pass
    except OSError as error:
        raise BadInput(f"cannot write to {file}: {error.strerror}") from error
