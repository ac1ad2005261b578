"""Reading of strangers' demonstrations in a process of its own. It takes neither much memory nor long,
whatever their files claim. Where a library ends its process, it ends this one alone.

In every form few bytes may stand for many: by compression, by lists that share their content, by shapes.
Libraries allocate before they check. So the bound is the operating system's, one for all forms.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness import demonstration_forms as forms
from harness.registry import BadInput

MEMORY = 2 << 30
"""Bytes that the process may take."""
SECONDS = 600
"""Processor time that it may take."""
LONGEST = 1 << 26
"""Bytes of its first line, at most."""
PROGRAM = "import sys; sys.path[:] = sys.argv[4:]; from harness import apart; apart.answer(*sys.argv[1:4])"
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Variables by which libraries take memory as it is needed."""


def raw(path: Path) -> forms.Raw:
    """Return what `forms.raw` does. Raises what it does, and ValueError where its process ended."""
    command = [sys.executable, "-I", "-c", PROGRAM, str(path), str(MEMORY), str(SECONDS), *sys.path]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, env=os.environ | ALONE, **pipes) as child:  # type: ignore[call-overload]
        try:
            return _received(child.stdout)
        except EOFError as error:
            raise ValueError(_why_ended(child.wait())) from error
        finally:
            child.kill()


def answer(path: str, memory: str, seconds: str) -> None:
    """Write what `raw` returns or raises to standard output: called in the process that reads."""
    _bound(int(memory), int(seconds))
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what libraries print
        arrays = list[NDArray[np.generic]]()
        try:
            found = forms.raw(Path(path))
            arrays = [array for _, _, array in found.arrays]
            said = {name: getattr(found, name) for name in ("form", "terminated", "vague", "own", "first")}
            said["bounds"] = (
                None if found.bounds is None else [np.ravel(end).tolist() for end in found.bounds]
            )
            said["paid"] = found.rewards is not None
            said["arrays"] = [(array.dtype.str, array.shape) for array in arrays]
        except (BadInput, ValueError) as error:
            said = {type(error).__name__: str(error)}
        out.write(json.dumps(said).encode() + b"\n")
        for array in arrays:
            out.write(np.ascontiguousarray(array).reshape(-1).view(np.uint8))  # type: ignore[arg-type]


def _bound(memory: int, seconds: int) -> None:
    """Bound what this process may take, where the system can."""
    try:
        import resource
    except ImportError:  # on Windows
        return
    limits = {resource.RLIMIT_DATA: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
    for limit, most in limits.items():
        _, hard = resource.getrlimit(limit)
        resource.setrlimit(limit, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _received(stream: BinaryIO) -> forms.Raw:
    """Return what `answer` wrote. Raises what it tells of, and EOFError where it did not end."""
    line = stream.readline(LONGEST)
    if not line.endswith(b"\n"):
        raise EOFError
    said = json.loads(line)
    if "BadInput" in said:
        raise BadInput(said["BadInput"])
    if "ValueError" in said:
        raise ValueError(said["ValueError"])
    arrays = [_array(stream, *one) for one in said["arrays"]]
    count = len(said["terminated"])
    return forms.Raw(
        said["form"],
        arrays[:count],
        arrays[count : 2 * count],
        said["terminated"],
        arrays[2 * count :] if said["paid"] else None,
        said["vague"],
        said["own"],
        None if said["bounds"] is None else (np.array(said["bounds"][0]), np.array(said["bounds"][1])),
        said["first"],
    )


def _array(stream: BinaryIO, kind: str, shape: list[int]) -> NDArray[np.generic]:
    array = np.empty(shape, kind)
    left = memoryview(array.reshape(-1).view(np.uint8))  # type: ignore[arg-type]
    while left:
        if not (read := stream.readinto(left)):  # type: ignore[attr-defined]
            raise EOFError
        left = left[read:]
    return array


def _why_ended(code: int) -> str:
    if code == -getattr(signal, "SIGXCPU", 0):
        return f"reading it takes more than {SECONDS} seconds"
    by = signal.strsignal(-code) if code < 0 else f"exit code {code}"
    return f"reading it takes more memory than is allowed, or it is damaged: its reader ended ({by})"
