"""Arrow streams and files, and parquet: numbers, and lists of numbers, alone.

In other columns few bytes may stand for many numbers: views, dictionaries and runs share what they hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute, parquet, types

from harness.demonstrations.recording import FLAT, check_size, opened_to_read


def table(path: Path, kind: str, names: Sequence[str]) -> Any:
    """Return the named columns, as far as they are there.

    kind: 'stream', 'arrow' (a file of such) or 'parquet'. Raises ValueError for any other file or types.
    """
    with opened_to_read(path) as file:
        try:
            columns = _read_parquet(file, names) if kind == "parquet" else _read_arrow(file, kind, names)
            columns.validate(full=True)  # or damaged offsets would end this process
        except pa.ArrowException as error:
            if isinstance(error, MemoryError):
                raise
            raise ValueError(f"{path.name} is no file of the kind {kind}: {error}") from error
    return columns


def column(columns: Any, name: str) -> Any:
    """Return a column of a table as one Arrow array. Raises KeyError where it has none of that name."""
    return columns[name].combine_chunks()


def rows(values: Any, where: str) -> NDArray[Any]:
    """Return (N,) of numbers, or (N, W) of N lists of W numbers each. Raises ValueError for gaps and
    others."""
    if not _is_list(values.type):
        if values.null_count or hasattr(values.type, "value_type"):
            raise ValueError(f"{where} of type {values.type!s:.80}, or with gaps; {FLAT}")
        return np.asarray(values.to_numpy(zero_copy_only=False))
    inside, widths = lists(values, where)
    if len(widths) and (widths != widths[0]).any():
        raise ValueError(f"{where} whose rows have {widths.min()} to {widths.max()} numbers")
    numbers = rows(inside, where)
    if numbers.ndim != 1:
        raise ValueError(f"{where} of type {values.type!s:.80}; {FLAT}")
    return numbers.reshape(len(widths), -1 if len(numbers) else 0)


def lists(values: Any, where: str) -> tuple[Any, NDArray[np.int64]]:
    """Return what lists hold, one after the other, and how long each is. Raises ValueError for no lists."""
    if not _is_list(values.type) or values.null_count:
        raise ValueError(f"{where} of type {values.type!s:.80}, or with gaps; lists of rows are needed")
    inside = values.flatten()
    check_size(len(inside))
    return inside, compute.list_value_length(values).to_numpy(zero_copy_only=False).astype(np.int64)


def _read_parquet(file: BinaryIO, names: Sequence[str]) -> Any:
    whole = parquet.ParquetFile(file)
    wanted = _wanted(whole.schema_arrow, names)
    return whole.read(columns=[whole.schema_arrow.names[i] for i in wanted], use_threads=False)


def _read_arrow(file: BinaryIO, kind: str, names: Sequence[str]) -> Any:
    open_ = pa.ipc.open_stream if kind == "stream" else pa.ipc.open_file
    wanted = _wanted(open_(file).schema, names)
    file.seek(0)
    options = pa.ipc.IpcReadOptions(included_fields=wanted, use_threads=False)
    return open_(file, options=options).read_all()


def _wanted(schema: Any, names: Sequence[str]) -> list[int]:
    """Return the numbers of the named columns. Raises ValueError for types that are not read."""
    if len(set(schema.names)) < len(schema.names):
        raise ValueError("it has two columns of one name")
    wanted = [i for i, name in enumerate(schema.names) if name in names]
    for i in wanted:
        inner = schema.types[i]
        while _is_list(inner):
            inner = inner.value_type
        if not (types.is_integer(inner) or types.is_floating(inner) or types.is_boolean(inner)):
            raise ValueError(f"its {schema.names[i]} is of type {schema.types[i]!s:.80}; {FLAT}")
    return wanted


def _is_list(kind: Any) -> bool:
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))
