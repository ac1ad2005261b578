"""One job, computed here and now under its key."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import os
import random
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from harness.cell.phases import Phase
from harness.engines.jobs import Job, Outcome
from harness.process.environment import hint, of_this_process
from harness.records import REFERENCE, Cell, CellResult, policies_of
from harness.registry import plugins
from harness.registry.bounds import usable
from harness.registry.keys import cell_keys
from harness.registry.machine import machine
from harness.store.codec import decode, encode, printable
from harness.store.files import LARGEST_OF_CELL, sha256_of
from harness.store.names import files_of

LARGEST_SHARED = 500 << 20
"""Bytes of what the cells of a task and seed share, at most."""
AFTERWARDS = " Or did the cell change sys.path and then import from there? Do that as the module is imported."
"""Why else a cell's key may have changed while the cell was computed."""


@contextlib.contextmanager
def process_restored() -> Iterator[None]:
    """Restore this process's variables, folder and random states as the context ends, for its next job.
    Free what the last job holds in cycles."""
    variables, folder = os.environ.copy(), os.open(".", os.O_PATH)
    states: list[tuple[Callable[..., object], object]] = [
        (random.setstate, random.getstate()),
        (np.random.set_state, np.random.get_state()),  # noqa: NPY002
    ]
    if torch := sys.modules.get("torch"):
        states.append((torch.set_rng_state, torch.get_rng_state()))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(variables)
        with contextlib.suppress(OSError):  # where a job closed it
            os.fchdir(folder)
            os.close(folder)
        for restore, state in states:
            restore(state)
        gc.collect()
        gc.freeze()  # Modules stay, and looking through them again takes as long as a short job.
        if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
            trim(0)  # glibc keeps what was freed between the blocks that stay: 100 MB a job.


def compute(work: str, job: Job, tell: Callable[[Phase], None] = lambda phase: None) -> Outcome:
    """Return the outcome of a job that the module `work` does. tell: called with each phase.

    Raises what the job raises, ComplexWarning where the imaginary part of a number would be dropped, and
    RuntimeError where the job is not computed under its key.
    """
    variables = of_this_process()  # as they are now: what a method sets later is its own affair
    given = job.conditions.env_kwargs, job.conditions.env_vars
    plugins.in_cells(job.plugins, job.methods, [job.cells[0].env], *given)
    _check_key(job, variables)
    module = importlib.import_module(work)
    if job.shared:
        files = module.prepare(job.cells, job.conditions)
        if sum(map(len, files.values())) > LARGEST_SHARED:
            raise ValueError(f"its demonstrations are more than {LARGEST_SHARED >> 20} MiB: show fewer")
        return Outcome(files=files)
    (cell,) = job.cells
    with warnings.catch_warnings(action="error", category=np.exceptions.ComplexWarning):
        result, files = module.run_cell(cell, job.conditions, job.inputs, tell)
    _check(result, files, cell, job.conditions.protocol)
    encoded = encode(replace(result, origin=machine()))
    decode(encoded)
    _check_key(job, variables, AFTERWARDS)
    return Outcome(encoded, files)


def _check_key(job: Job, variables: Mapping[str, str], hint: str = "") -> None:
    first = job.cells[0]
    cell = Cell(first.env, REFERENCE, first.seed) if job.shared else first
    if cell_keys([cell], job.conditions, variables)[cell] != job.key:
        raise RuntimeError(
            "the program, a plug-in, packages or the environment are not those that the run began with; "
            "were packages or a plug-in's files changed, or was Python started with -E or -I?" + hint
        )


def _check(result: CellResult, files: Mapping[str, bytes], cell: Cell, protocol: str) -> None:
    if result.cell != cell or not result.rows:
        raise ValueError(f"asked for {cell.name}, got {len(result.rows)} rows of {result.cell.name}")
    if (policies := tuple(row.policy for row in result.rows)) != policies_of(cell):
        raise ValueError(f"asked for {', '.join(policies_of(cell))}, got {', '.join(policies)}")
    if result.files != {name: sha256_of(data) for name, data in files.items()}:
        raise ValueError("its files are not those that its result names")
    if others := sorted(result.files.keys() - files_of(cell)):
        raise ValueError(f"{others[0]} is no file of {cell.name}")
    if sum(map(len, files.values())) > LARGEST_OF_CELL:
        raise ValueError(f"its files are larger than {LARGEST_OF_CELL >> 20} MiB")
    for row in result.rows:
        if row.protocol != protocol:
            raise ValueError(f"{row.policy}: of protocol {row.protocol}, not {protocol}")
        for name in ("return_mean", "discounted_mean", "length_mean"):
            value = getattr(row, name)
            if row.status == "ok" and not usable(value):
                raise FloatingPointError(f"{row.policy}: {name} is {value}")


def describe(error: BaseException) -> str:
    """Return one line: what was raised, and the three innermost places."""
    frames = reversed(traceback.extract_tb(error.__traceback__)[-3:])
    places = ", called by ".join(f"{f.name} ({Path(f.filename).name}:{f.lineno})" for f in frames)
    try:
        message = str(error)
    except BaseException as another:
        message = f"(its message raises {type(another).__name__})"
    message = " ".join(f"{type(error).__name__}: {message}".split())[:300]
    cause = "out of memory: " if isinstance(error, MemoryError) else ""
    return printable(f"{cause}{message.rstrip(': ')}; in {places}{hint(error)}")
