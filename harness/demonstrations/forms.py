"""The forms of files of demonstrations, all read into a `Recording`.

This project's `.npz` has the arrays of `harness.demonstrations.arrays`, actions in [-1, 1] or choices, and
optionally act_bounds (2, A), the lowest and highest actions of the file. Of `imitation` there are the `.npz`
before 1.0, and folders of Hugging Face's `datasets` since: Arrow streams that state.json names. Minari 0.5
has metadata.json, and episodes in main_data.hdf5, or in <number>/part-0.parquet or .arrow. No pickle is read,
nor the column `infos` of `imitation`, whose texts stand for any Python object.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.recording import LARGEST, OWN_FORM, Episode, Recording, extra, joined
from harness.store.codec import printable
from harness.store.files import opened
from harness.store.files import read as content

OWN = {"obs": "obs", "act": "act", "lengths": "lengths", "terminated": "terminated", "rewards": "rewards"}
OTHER = {"obs": "obs", "act": "acts", "lengths": "indices", "terminated": "terminal", "rewards": "rews"}
"""Arrays of this project and of `imitation`; the last is optional."""
ACT_BOUNDS = "act_bounds"
T = TypeVar("T")
STATE, METADATA = "state.json", "metadata.json"
STEPS = ("actions", "rewards", "terminations", "truncations")
"""Columns of each step of Minari; observations have one row more."""


class State(msgspec.Struct):
    """The state.json of a dataset."""

    data_files: list[dict[str, str]] = msgspec.field(name="_data_files")
    indices: list[Any] | None = msgspec.field(name="_indices_data_files", default=None)


class Metadata(msgspec.Struct):
    """The metadata.json of Minari. `action_space`: JSON in a text."""

    data_format: Literal["hdf5", "parquet", "arrow"]
    total_episodes: Annotated[int, msgspec.Meta(ge=1)]
    total_steps: int | None = None
    action_space: str = '{"type": "Box"}'


class Space(msgspec.Struct):
    """A space of actions in Minari's JSON. `low`, `high`: nested lists of numbers."""

    type: Literal["Box", "Discrete"]
    start: int = 0
    low: Any = -math.inf
    high: Any = math.inf


def read(path: Path) -> Recording:
    """Return what a file or folder holds. Raises whatever libraries do for anything else, BadInput where
    an extra is missing."""
    if not path.is_dir():
        return _npz(path)
    if os.path.lexists(path / STATE):
        return _imitation(path)
    data = path / "data" if os.path.lexists(path / "data") else path
    if os.path.lexists(data / METADATA):
        return _minari(data)
    raise ValueError("it holds neither the state.json of imitation nor the data/metadata.json of Minari")


def _npz(path: Path) -> Recording:
    with opened(path, LARGEST) as file:
        if not zipfile.is_zipfile(file):
            raise ValueError("it is no .npz file; pickles are not read")
        file.seek(0)
        archive = np.load(file)
        names = set(archive.files)
        layout = next((one for one in (OWN, OTHER) if {*list(one.values())[:-1]} <= names), None)
        if layout is None:
            raise ValueError(f"it has none of the sets of arrays that are known, but {sorted(names)}")
        arrays = {name: archive[there] for name, there in layout.items() if there in names}
        bounds = archive[ACT_BOUNDS] if layout is OWN and ACT_BOUNDS in names else None
    if layout is OTHER:
        arrays["lengths"] = np.diff(arrays["lengths"], prepend=0, append=len(arrays["act"]))
    return Recording(OWN_FORM if layout is OWN else "imitation's npz", arrays, bounds)


def _imitation(path: Path) -> Recording:
    state = _json(path / STATE, State)
    if state.indices:
        raise ValueError("it shows a selection of its rows; save it after `flatten_indices()`")
    names = [entry["filename"] for entry in state.data_files]
    if any(Path(name).name != name for name in names):
        raise ValueError(f"its {STATE} names files that do not lie beside it")
    episodes = []
    for name in names:
        table = _table(path / name, "stream")
        for i in range(table.num_rows):
            obs, act = (_rows(table[column][i].values) for column in ("obs", "acts"))
            rewards = _rows(table["rews"][i].values) if "rews" in table.column_names else None
            episodes.append(Episode(obs, act, table["terminal"][i].as_py(), rewards))
    return Recording("imitation", joined(episodes))


def _minari(data: Path) -> Recording:
    facts = _json(data / METADATA, Metadata)
    episodes, unended = list[Episode](), list[int]()
    columns = _hdf5(data, facts) if facts.data_format == "hdf5" else _tables(data, facts)
    for i, one in enumerate(columns):
        terminations, truncations = (one[name].astype(bool) for name in STEPS[2:])
        act, ends = one["actions"], terminations | truncations
        if terminations.dtype != one["terminations"].dtype or ends.shape != act.shape[:1] or not len(ends):
            raise ValueError(f"episode {i} has no terminations and truncations for each of its steps")
        if ends[:-1].any():
            raise ValueError(f"episode {i} goes on after it ended")
        if not ends[-1]:
            unended.append(i)
        episodes.append(Episode(one["observations"], act, terminations[-1], one["rewards"]))
    arrays = joined(episodes)
    if facts.total_steps not in (None, steps := int(arrays["lengths"].sum())):
        raise ValueError(f"its {METADATA} tells of {facts.total_steps} steps, and its episodes have {steps}")
    space, bounds = _checked(facts.action_space, Space), None
    if space.type == "Box":
        low, high = (np.array(end, np.float64).ravel() for end in (space.low, space.high))
        bounds = np.array([low, high])
    first = space.start if bounds is None else None
    return Recording(f"Minari {facts.data_format}", arrays, bounds, first, tuple(unended))


def _json(path: Path, kind: type[T]) -> T:
    try:
        return _checked(content(path), kind)
    except ValueError as error:
        raise ValueError(f"its {path.name} cannot be used: {error}") from error


def _checked(text: str | bytes, kind: type[T]) -> T:
    """Return JSON as `kind`. Raises ValueError, with the place, where it does not fit."""
    try:
        return msgspec.convert(json.loads(text), kind)  # which takes Infinity
    except (msgspec.ValidationError, ValueError, RecursionError) as error:
        raise ValueError(printable(str(error)[:200])) from error


def _tables(data: Path, facts: Metadata) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each episode, whose last row is of the last observation alone."""
    for i in range(facts.total_episodes):
        table = _table(data / str(i) / f"part-0.{facts.data_format}", facts.data_format)
        steps = {name: _rows(table[name].combine_chunks())[:-1] for name in STEPS}
        yield steps | {"observations": _rows(table["observations"].combine_chunks())}


def _hdf5(data: Path, facts: Metadata) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each episode."""
    h5py = extra("h5py")
    with opened(data / "main_data.hdf5", LARGEST) as binary, h5py.File(binary, "r") as file:
        for i in range(facts.total_episodes):
            group = file[f"episode_{i}"]
            yield {name: np.asarray(group[name]) for name in ("observations", *STEPS)}


def _table(path: Path, kind: str) -> Any:
    """Return an Arrow table. kind: 'stream', 'arrow' (a file of such) or 'parquet'."""
    import pyarrow as pa  # which an .npz is read without
    from pyarrow import parquet

    with opened(path, LARGEST) as file:
        if kind == "parquet":
            table = parquet.read_table(file, use_threads=False)
        else:
            table = (pa.ipc.open_stream if kind == "stream" else pa.ipc.open_file)(file).read_all()
    table.validate(full=True)  # or damaged offsets would end this process
    return table


def _rows(values: Any) -> NDArray[Any]:
    """Return an Arrow array as (N,) numbers, or (N, W) of N lists of W numbers each."""
    from pyarrow import compute, types

    kind = values.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    widths = compute.list_value_length(values).to_numpy(zero_copy_only=False)
    if values.null_count or (widths != widths[:1]).any():
        raise ValueError("it has rows of several lengths, or gaps; flat rows of numbers are needed")
    return _rows(values.flatten()).reshape(len(values), -1)
