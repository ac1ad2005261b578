"""The `.npz` of this project, and that of `imitation` before 1.0.

This project's has the arrays of `harness.demonstrations.arrays`, actions in [-1, 1] or choices, and
optionally act_bounds (2, A), the lowest and highest actions of the file. No pickle is read.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.recording import (
    Bounds,
    Recording,
    check_size,
    checked_bounds,
    endings,
    opened_to_read,
)

OWN_FORM = "npz"
OWN = {"obs": "obs", "act": "act", "lengths": "lengths", "terminated": "terminated", "rewards": "rewards"}
OTHER = {"obs": "obs", "act": "acts", "lengths": "indices", "terminated": "terminal", "rewards": "rews"}
"""Arrays of this project and of `imitation`; the last is optional."""
BOUNDS = "act_bounds"


def read(path: Path) -> Recording:
    """Return what an `.npz` holds. Raises ValueError for anything else, or a damaged one."""
    with opened_to_read(path) as file:
        if not zipfile.is_zipfile(file):
            raise ValueError("it is no .npz file; pickles are not read")
        file.seek(0)
        with _archive(file) as archive:
            check_size(sum(entry.file_size for entry in archive.zip.infolist()) // 8)
            names = set(archive.files)
            if len(names) < len(archive.files):
                raise ValueError("it has two arrays of one name")
            layout = next((one for one in (OWN, OTHER) if {*list(one.values())[:-1]} <= names), None)
            if layout is None:
                raise ValueError(f"it has none of the sets of arrays that are known, but {sorted(names)}")
            arrays = {name: _array(archive, there) for name, there in layout.items() if there in names}
            bounds = _bounds(_array(archive, BOUNDS)) if layout is OWN and BOUNDS in names else None
    lengths = _whole(arrays["lengths"])
    if layout is OTHER:
        lengths = np.diff(lengths, prepend=0, append=len(arrays["act"]))
    arrays |= {"lengths": lengths, "terminated": endings(arrays["terminated"])}
    return Recording(OWN_FORM if layout is OWN else "imitation's npz", arrays, bounds)


def to_bytes(arrays: dict[str, NDArray[Any]]) -> bytes:
    """Return a file of this project, whose actions (T, A) are in [-1, 1] or choices."""
    buffer = io.BytesIO()
    bounds = np.array([[-1.0], [1.0]]).repeat(arrays["act"].shape[1], axis=1)
    np.savez_compressed(buffer, **arrays, **{BOUNDS: bounds})  # type: ignore[arg-type]
    return buffer.getvalue()


def _archive(file: BinaryIO) -> Any:
    """Return NumPy's view of an archive. Raises ValueError for a damaged one."""
    try:
        return np.load(file)
    except MemoryError:
        raise
    except Exception as error:  # whatever NumPy and zipfile raise
        raise ValueError("it is no .npz file, or damaged; pickles are not read") from error


def _array(archive: Any, name: str) -> NDArray[Any]:
    """Return an array (N, ...) of an archive. Raises ValueError for a pickle or a number."""
    try:
        array = archive[name]
    except MemoryError:
        raise
    except Exception as error:  # whatever NumPy and zipfile raise
        raise ValueError(f"its {name} is damaged, or no array of numbers; pickles are not read") from error
    if not isinstance(array, np.ndarray) or not array.ndim:
        raise ValueError(f"its {name} is no array of a row or more")
    return array


def _bounds(values: NDArray[Any]) -> Bounds:
    if values.ndim != 2 or len(values) != 2 or values.dtype.kind not in "fiu":
        raise ValueError(f"its {BOUNDS} {values.dtype} {values.shape} are no (2, A) of lows and highs")
    low, high = values.astype(np.float64)
    return checked_bounds(low, high, f"its {BOUNDS}")


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"whole numbers are needed where it has {values.dtype} {values.shape}")
    return values.astype(np.int64)
