"""Parts of several forms: files within a size, checked JSON, Arrow tables, and observations by key."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.recording import Reading
from harness.store import files
from harness.store.codec import printable

LARGEST = 1 << 30
"""Most bytes of a file that is read."""
KEYS = "--obs-keys"
T = TypeVar("T")


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading. Raises OSError as `harness.store.files.opened` does."""
    with files.opened(path, LARGEST) as file:
        yield file


def described(path: Path, kind: type[T]) -> T:
    """Return a JSON file as `kind`. Raises ValueError, with the place, where it does not fit."""
    try:
        return checked(files.read(path), kind)
    except ValueError as error:
        raise ValueError(f"its {path.name} cannot be used: {error}") from error


def checked(text: str | bytes, kind: type[T]) -> T:
    """Return JSON as `kind`. Raises ValueError, with the place, where it does not fit."""
    try:
        return msgspec.convert(json.loads(text), kind)  # which takes Infinity
    except (msgspec.ValidationError, ValueError, RecursionError) as error:
        raise ValueError(printable(str(error)[:200])) from error


def table(path: Path, kind: str) -> Any:
    """Return an Arrow table. kind: 'stream', 'arrow' (a file of such), 'parquet' or 'json' (a row a line)."""
    import pyarrow as pa  # which an .npz is read without
    from pyarrow import json as lines
    from pyarrow import parquet

    with opened(path) as file:
        if kind == "parquet":
            content = parquet.read_table(file, use_threads=False)
        elif kind == "json":
            content = lines.read_json(file, lines.ReadOptions(use_threads=False))
        else:
            content = (pa.ipc.open_stream if kind == "stream" else pa.ipc.open_file)(file).read_all()
    content.validate(full=True)  # or damaged offsets would end this process
    return content


def rows(values: Any) -> NDArray[Any]:
    """Return an Arrow array as (N,) numbers, or (N, W) of N lists of W numbers each."""
    from pyarrow import compute, types

    kind = values.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    widths = compute.list_value_length(values).to_numpy(zero_copy_only=False)
    if values.null_count or (widths != widths[:1]).any():
        raise ValueError("it has rows of several lengths, or gaps; flat rows of numbers are needed")
    return rows(values.flatten()).reshape(len(values), -1)


def observed(widths: Mapping[str, int], how: Reading) -> Sequence[str]:
    """Return the keys of the observations, in the order of the task's.

    widths: numbers of each key that the file has. Raises ValueError where the user has to choose among
    several, or chose others.
    """
    listed = ", ".join(f"{printable(key)} ({width})" for key, width in widths.items())
    if unknown := [key for key in how.obs_keys if key not in widths]:
        raise ValueError(f"it has no observations {', '.join(unknown)}, but {listed or 'none'}")
    if not how.obs_keys and len(widths) != 1:
        raise ValueError(
            f"its observations are {listed or 'none'}; give those of the task, in its order, as {KEYS}"
        )
    return how.obs_keys or [*widths]


def without_keys(form: str, how: Reading) -> None:
    """Raise ValueError where keys are chosen, in a form whose observations have none."""
    if how.obs_keys:
        raise ValueError(f"observations of {form} have no keys; leave out {KEYS}")


def beside(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return columns (N,) or (N, W) side by side, (N, sum of W)."""
    return np.concatenate([column.reshape(len(column), -1) for column in columns], axis=1)
