"""Reading of strangers' files in a process of its own, whose memory and time are bounded.

In every form few bytes may stand for many, and libraries allocate before they check. So the operating system
bounds what the process may take. Where a library ends its process, it ends this one alone.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from harness.demonstrations import forms
from harness.demonstrations.recording import AS_IT_IS, Reading, Recording
from harness.registry import BadInput
from harness.store.codec import printable

MEMORY = 2 << 30
"""Bytes that the process may take."""
SECONDS = 600
"""Seconds that it may take."""
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


def recording_in(path: Path, how: Reading = AS_IT_IS) -> Recording:
    """Return what `recording_here` does. Raises as it does, and ValueError where its process ended."""
    asked = [str(path), str(MEMORY), json.dumps(asdict(how))]
    command = [sys.executable, "-I", "-c", PROGRAM, *asked, *sys.path]
    variables, nothing = os.environ | ALONE, subprocess.DEVNULL
    with tempfile.TemporaryFile() as out:
        try:
            subprocess.run(
                command, env=variables, stdin=nothing, stdout=out, stderr=nothing, timeout=SECONDS, check=True
            )
            out.seek(0)
            arrays = dict(np.load(out))
            facts = json.loads(str(arrays.pop(FACTS)))
        except OSError as error:
            raise ValueError(f"no process can be started to read it: {error.strerror}") from error
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"reading it takes more than {SECONDS} s: its reader ended") from error
        except Exception as error:  # whatever subprocess, NumPy and zipfile raise
            why = "it takes more memory than is allowed, or is damaged: its reader ended"
            raise ValueError(why) from error
    if "refused" in facts:
        raise (BadInput if facts["bad_input"] else ValueError)(facts["refused"])
    return Recording(
        facts["form"],
        arrays,
        arrays.pop(BOUNDS, None),
        facts["first"],
        tuple(facts["unended"]),
        facts["states"] and tuple(facts["states"]),
    )


def recording_here(path: Path, how: Reading = AS_IT_IS) -> Recording:
    """Return what the file or folder holds, read in this process. Raises BadInput where an extra is missing,
    and ValueError, in a line, for whatever cannot be used."""
    try:
        return forms.read(path, how)
    except BadInput:
        raise
    except MemoryError as error:
        raise ValueError("reading it takes more memory than is allowed") from error
    except Exception as error:  # whatever libraries raise for damaged files
        reason = str(error)
        if isinstance(error, OSError) and error.strerror:
            name = error.filename or path
            reason = error.strerror if name == path else f"{error.strerror}: {name}"
        raise ValueError(printable(" ".join(reason.split()))[:300] or type(error).__name__) from error


def answer(path: str, memory: str, how: str) -> None:
    """Write the recording in a file, or why it cannot be read, to standard output: an `.npz`."""
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (int(memory), resource.getrlimit(resource.RLIMIT_DATA)[1]))
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # libraries may print
        try:
            recording = recording_here(Path(path), Reading(**json.loads(how)))
            arrays = recording.arrays | ({} if recording.bounds is None else {BOUNDS: recording.bounds})
            facts: dict[str, object] = {
                name: getattr(recording, name) for name in ("form", "first", "unended", "states")
            }
        except (BadInput, ValueError) as error:
            facts, arrays = {"refused": str(error), "bad_input": isinstance(error, BadInput)}, {}
        np.savez(out, **arrays, **{FACTS: np.array(json.dumps(facts))})  # type: ignore[arg-type]
