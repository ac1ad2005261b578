"""The program and the variables that processes of cells have."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.engines.scratch import scratch_folder
from harness.process.environment import of_cells
from harness.registry import KNOWN, BadInput
from harness.registry.keys import program
from harness.store.cache import compiled_once


def write_program(folder: Path) -> None:
    """Write `keys.program()` into the folder, which is made. Raises BadInput where it cannot be written."""
    try:
        for name, content in program().items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    except OSError as error:
        raise BadInput(f"cannot write to {folder}: {error.strerror}") from error


def cell_variables(scratch: Path, deterministic: bool) -> dict[str, str]:
    """Return the variables of processes of cells. Their temporary files are below the folder `scratch`.
    deterministic: with the same instructions on every processor."""
    temporary = scratch / "tmp"
    temporary.mkdir()
    passed = of_cells(deterministic) | KNOWN.variables
    return {**passed, "TMPDIR": str(temporary), **compiled_once(scratch / "compiled")}


@contextmanager
def as_in_cells() -> Iterator[None]:
    """Give this process the variables of cells until the context ends, and a folder for temporary files that
    goes with it."""
    before, folder = os.environ.copy(), tempfile.tempdir
    with scratch_folder() as scratch:
        variables = cell_variables(scratch, deterministic=True)
        try:
            os.environ.clear()
            os.environ.update(variables)
            tempfile.tempdir = variables["TMPDIR"]  # which it remembers
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)
            tempfile.tempdir = folder
