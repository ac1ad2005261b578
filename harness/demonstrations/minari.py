"""Datasets of Minari 0.5: metadata.json, and episodes in main_data.hdf5, or in <number>/part-0.parquet or
.arrow.

They are read without Minari, which could make environments, and written by it, in parquet.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.recording import (
    MOST_EPISODES,
    Bounds,
    Recording,
    check_observed,
    check_size,
    checked_bounds,
    extra,
    opened_to_read,
)
from harness.store.files import read as content

if TYPE_CHECKING:  # which the process that reads does without
    from envs import EnvSpec
    from methods.base import Array, Episodes

METADATA = "metadata.json"
STEPS = ("actions", "rewards", "terminations", "truncations")
"""Columns of each step; observations have one row more."""
FOLDER = "MINARI_DATASETS_PATH"
"""Name of the variable that says where Minari writes."""
Columns = dict[str, NDArray[Any]]


def read(data: Path) -> Recording:
    """Return what a dataset's folder `data` holds. Raises ValueError for anything else, and BadInput where it
    is in HDF5 and h5py is missing."""
    kind, count, steps, bounds, first = _described(data)
    episodes, size = list[Columns](), 0
    for episode in _hdf5(data, count) if kind == "hdf5" else _tables(data, count, kind):
        size += sum(values.size for values in episode.values())
        check_size(size)
        episodes.append(episode)
    endings = [_ending(episode, i) for i, episode in enumerate(episodes)]
    lengths = [len(episode["actions"]) if episode["actions"].ndim else 0 for episode in episodes]
    if steps not in (None, sum(lengths)):
        raise ValueError(f"its {METADATA} tells of {steps!r:.20} steps, and its episodes have {sum(lengths)}")
    check_observed([len(episode["observations"]) for episode in episodes], lengths)
    arrays = {
        "obs": _joined(episodes, "observations"),
        "act": _joined(episodes, "actions"),
        "lengths": np.array(lengths),
        "terminated": np.array([end == "terminated" for end in endings]),
        "rewards": _joined(episodes, "rewards"),
    }
    unended = tuple(i for i, end in enumerate(endings) if not end)
    return Recording(f"Minari {kind}", arrays, bounds, first, unended)


def write(
    path: Path,
    name: str,
    spec: EnvSpec,
    episodes: Episodes,
    rewards: Sequence[Array],
    first: int,
    **facts: str,
) -> None:
    """Write a new dataset called `name`, the folder `path`. Actions are in [-1, 1], or choices.

    first: number of the first choice. facts: for `create_dataset_from_buffers`. Raises BadInput where Minari
    is missing.
    """
    from gymnasium import spaces

    minari = extra("minari")
    box = spaces.Box(-1.0, 1.0, (spec.act_size,), np.float64)
    path = path.absolute()  # or Minari joins a relative one twice
    path.parent.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent) as scratch,
        _minari_writes_to(scratch),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # about a missing environment
        minari.create_dataset_from_buffers(
            name,
            _buffers(minari, spec, episodes, rewards, first),
            action_space=spaces.Discrete(spec.act_size, start=first) if spec.discrete else box,
            observation_space=spaces.Box(-np.inf, np.inf, (spec.obs_size,), np.float64),
            data_format="parquet",
            **facts,
        )
        (Path(scratch) / name).rename(path)


def _buffers(
    minari: Any, spec: EnvSpec, episodes: Episodes, rewards: Sequence[Array], first: int
) -> list[Any]:
    """Return an `EpisodeBuffer` for each episode."""
    buffers = []
    for obs, act, ended, paid in zip(episodes.obs, episodes.act, episodes.terminated, rewards, strict=True):
        last = np.arange(len(act)) == len(act) - 1
        steps = {"terminations": last & ended, "truncations": last & (not ended), "rewards": paid}
        actions = act.argmax(axis=1) + first if spec.discrete else act
        buffers.append(
            minari.data_collector.EpisodeBuffer(observations=obs, actions=actions, infos={}, **steps)
        )
    return buffers


@contextmanager
def _minari_writes_to(folder: str) -> Iterator[None]:
    before = os.environ.get(FOLDER)
    os.environ[FOLDER] = folder
    try:
        yield
    finally:
        del os.environ[FOLDER]
        if before is not None:
            os.environ[FOLDER] = before


def _joined(episodes: Sequence[Columns], name: str) -> NDArray[Any]:
    """Return a column of all episodes. Raises ValueError where its rows have several shapes."""
    columns = [episode[name] for episode in episodes]
    if any(not column.ndim or column.shape[1:] != columns[0].shape[1:] for column in columns):
        raise ValueError(f"its {name} have rows of several shapes, or none")
    return np.concatenate(columns)


def _described(data: Path) -> tuple[str, int, Any, Bounds | None, int | None]:
    """Return the kind of its files, its episodes, its steps if it says so, and the bounds or the first
    choice of its actions."""
    try:
        facts = json.loads(content(data / METADATA))
        kind, count = facts["data_format"], facts["total_episodes"]
        bounds, first = _space(json.loads(facts.get("action_space", "null")))
        if type(count) is not int or not 0 < count <= MOST_EPISODES:
            raise ValueError(f"it has {count!r:.20} episodes where 1 to {MOST_EPISODES:,} are read")
        if kind not in ("hdf5", "parquet", "arrow"):
            raise ValueError(f"its data_format is {kind!r:.20} where hdf5, parquet or arrow is read")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"its {METADATA} cannot be used: {error}") from error
    return kind, count, facts.get("total_steps"), bounds, first


def _space(space: Any) -> tuple[Bounds | None, int | None]:
    """Return the bounds of a space of actions in Minari's JSON, infinite where it says none, or else the
    number of its first choice."""
    if space is None:
        return np.array([[-math.inf], [math.inf]]), None
    if space["type"] == "Discrete" and type(space["start"]) is int:
        return None, space["start"]
    if space["type"] != "Box":
        raise ValueError(f"its actions are neither numbers nor choices, but {space!r:.80}")
    low, high = (np.array(space[end], np.float64).ravel() for end in ("low", "high"))
    return checked_bounds(low, high, "its action_space"), None


def _ending(episode: Columns, number: int) -> str:
    """Return 'terminated', 'cut', or '' where the episode says neither."""
    flags = episode["terminations"], episode["truncations"]
    for column in flags:
        if column.dtype != bool or column.ndim != 1 or len(column) != len(flags[0]) or not len(column):
            raise ValueError(f"episode {number} has no terminations and truncations for each of its steps")
    terminations, truncations = flags
    if (terminations | truncations)[:-1].any():
        raise ValueError(f"episode {number} goes on after it ended")
    if terminations[-1]:
        return "terminated"
    return "cut" if truncations[-1] else ""


def _tables(data: Path, count: int, kind: str) -> Iterator[Columns]:
    """Yield the columns of each episode, whose last row is of the last observation alone."""
    from harness.demonstrations import arrow

    for i in range(count):
        folder = data / str(i)
        if folder.is_symlink():
            raise ValueError(f"its {i} is a link")
        table = arrow.table(folder / f"part-0.{kind}", kind, ("observations", *STEPS))
        columns = {
            name: arrow.rows(arrow.column(table, name), f"episode {i} has {name}")
            for name in ("observations", *STEPS)
        }
        yield {name: rows if name == "observations" else rows[:-1] for name, rows in columns.items()}


def _hdf5(data: Path, count: int) -> Iterator[Columns]:
    """Yield the columns of each episode, plain arrays of the file itself."""
    h5py = extra("h5py")
    with opened_to_read(data / "main_data.hdf5") as binary, h5py.File(binary, "r") as file:
        size = os.fstat(binary.fileno()).st_size
        for i in range(count):
            group = _member(file, f"episode_{i}", h5py.Group)
            members = {name: _member(group, name, h5py.Dataset) for name in ("observations", *STEPS)}
            yield {name: _values(member, size) for name, member in members.items()}


def _member(group: Any, name: str, kind: type) -> Any:
    """Return a member of a group of HDF5, where links may lead to other files."""
    if type(group.get(name, getlink=True)).__name__ != "HardLink" or not isinstance(group[name], kind):
        raise ValueError(
            f"{name} of {group.name} is no {kind.__name__.lower()} in the file itself; "
            "links, dictionaries and tuples are not read"
        )
    return group[name]


def _values(dataset: Any, size: int) -> NDArray[Any]:
    """Return a plain array. For others, and for some that are damaged, HDF5 would read other files, or
    without an end. size: bytes of the file."""
    if dataset.is_virtual or dataset.external or dataset.id.get_create_plist().get_nfilters():
        raise ValueError(f"{dataset.name} is compressed, or not in the file")
    if dataset.shape is None or dataset.dtype.kind not in "fiub":
        raise ValueError(f"{dataset.name} holds {dataset.dtype} {dataset.shape}; numbers are needed")
    chunk = dataset.chunks or (0,) * dataset.ndim
    claimed = max(dataset.nbytes, math.prod(chunk) * dataset.dtype.itemsize)
    if len(chunk) != dataset.ndim or claimed > min(dataset.id.get_storage_size(), size):
        raise ValueError(f"{dataset.name} {dataset.shape} is not whole")
    return np.asarray(dataset[()])
