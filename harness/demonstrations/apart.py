"""Reading of strangers' files in a process of its own, whose memory and time are bounded.

In every form few bytes may stand for many: by compression, by lists that share their content, by shapes.
Libraries allocate before they check, so the operating system bounds what the process may take. Where a
library ends its process, it ends this one alone. No link below a folder is followed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations import imitation, minari, npz
from harness.demonstrations.recording import Recording
from harness.registry import BadInput
from harness.store.codec import printable

MEMORY = 2 << 30
"""Bytes that the process may take."""
SECONDS = 600
"""Processor time that it may take."""
PROGRAM = """
import sys
sys.path[:] = sys.argv[4:]
from harness.demonstrations import apart
apart.answer(*sys.argv[1:4])
"""
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Variables by which libraries take memory as it is needed."""
FACTS, BOUNDS = "facts", "bounds"
"""Members of the answer beside the recording's arrays."""


def recording_in(path: Path) -> Recording:
    """Return what `recording_here` does. Raises as it does, and ValueError where its process ended."""
    command = [sys.executable, "-I", "-c", PROGRAM, str(path), str(MEMORY), str(SECONDS), *sys.path]
    nothing = subprocess.DEVNULL
    with tempfile.TemporaryFile() as answered:
        ended = subprocess.run(
            command, env=os.environ | ALONE, stdin=nothing, stdout=answered, stderr=nothing, check=False
        )
        try:
            answered.seek(0)
            arrays = dict(np.load(answered))
            facts = json.loads(str(arrays.pop(FACTS)))
        except Exception as error:  # whatever NumPy and zipfile raise
            raise ValueError(_why_ended(ended.returncode)) from error
    if "refused" in facts:
        raise (BadInput if facts["bad_input"] else ValueError)(facts["refused"])
    bounds = arrays.pop(BOUNDS, None)
    return Recording(facts["form"], arrays, bounds, facts["first"], tuple(facts["unended"]))


def recording_here(path: Path) -> Recording:
    """Return what the file or folder holds, read in this process. Raises BadInput where an extra is missing,
    and ValueError, in a line, for whatever cannot be used."""
    try:
        return _read(path)
    except BadInput:
        raise
    except MemoryError as error:
        raise ValueError("reading it takes more memory than is allowed") from error
    except Exception as error:  # whatever libraries raise for damaged files
        reason = str(error)
        if isinstance(error, OSError) and error.strerror:
            inside = error.filename is not None and Path(error.filename) != path
            reason = f"{error.strerror}: {error.filename}" if inside else error.strerror
        raise ValueError(printable(" ".join(reason.split()))[:300] or type(error).__name__) from error


def _read(path: Path) -> Recording:
    if not path.is_dir():
        return npz.read(path)
    if os.path.lexists(path / imitation.STATE):
        return imitation.read(path)
    data = path / "data" if os.path.lexists(path / "data") else path
    if data != path and data.is_symlink():
        raise ValueError("its data is a link")
    if os.path.lexists(data / minari.METADATA):
        return minari.read(data)
    raise ValueError("it holds neither the state.json of imitation nor the data/metadata.json of Minari")


def answer(path: str, memory: str, seconds: str) -> None:
    """Write the recording in a file, or why it cannot be read, to standard output: an `.npz`."""
    _bound(int(memory), int(seconds))
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries may print
        try:
            recording = recording_here(Path(path))
            facts = {name: getattr(recording, name) for name in ("form", "first", "unended")}
            bounds = {} if recording.bounds is None else {BOUNDS: recording.bounds}
            _save(out, facts, recording.arrays | bounds)
        except (BadInput, ValueError) as error:
            _save(out, {"refused": str(error), "bad_input": isinstance(error, BadInput)}, {})


def _save(out: BinaryIO, facts: dict[str, object], arrays: dict[str, NDArray[Any]]) -> None:
    np.savez(out, **{FACTS: np.array(json.dumps(facts))}, **arrays)  # type: ignore[arg-type]


def _bound(memory: int, seconds: int) -> None:
    """Bound what this process may take, where the system can."""
    try:
        import resource
    except ImportError:  # on Windows
        return
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)  # it may have been inherited as ignored
    limits = {resource.RLIMIT_DATA: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
    for limit, most in limits.items():
        _, hard = resource.getrlimit(limit)
        resource.setrlimit(limit, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _why_ended(code: int) -> str:
    if code == -getattr(signal, "SIGXCPU", 0):
        return f"reading it takes more than {SECONDS} seconds"
    by = signal.strsignal(-code) if code < 0 else f"exit code {code}"
    return f"reading it takes more memory than is allowed, or it is damaged: its reader ended ({by})"
