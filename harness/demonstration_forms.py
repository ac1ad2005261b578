"""The forms that demonstrations have on disk: each read as it is there, and Minari's written.

`.npz` of this project: arrays obs (sum of T+1, O), act (sum of T, A) in [-1, 1], lengths (N,) and
terminated (N,), and optionally rewards (sum of T,).
`.npz` of `imitation` before 1.0: obs, acts, indices, terminal and optionally rews.
A folder of `imitation` 1.0, which is one of Hugging Face's `datasets`: Arrow streams that state.json names.
Its `infos`, texts that stand for any Python object, are not looked at.
A dataset of Minari 0.5, or the folder `data` in it: metadata.json, and episodes in main_data.hdf5 or, one
each, in <number>/part-0.parquet or .arrow. They are read without Minari, which could make environments.

No pickle is read, and no link below a folder is followed, be it of the file system or of HDF5.
"""

from __future__ import annotations

import importlib
import io
import json
import math
import os
import tempfile
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs import EnvSpec
from harness.registry import BadInput
from harness.run.files import read
from methods.base import Array, Episodes

LARGEST = 1 << 30
"""Bytes of a file that is read, and of what is in it, at most."""
MOST_EPISODES = 100_000
STEPS = ("actions", "rewards", "terminations", "truncations")
"""What Minari has of each step, besides observations."""
PLACE = "MINARI_DATASETS_PATH"
"""The variable that says where Minari writes."""
Columns = dict[str, NDArray[Any]]
Bounds = tuple[float, float] | tuple[Array, Array]
"""Of actions: the lowest and the highest, of each entry or of all."""


@dataclass(frozen=True)
class Raw:
    """As a file has it, an entry an episode.

    terminated: None where nothing is said of how the episode ended. vague: whether it may call terminal what
    was cut at the horizon. bounds: of actions; None where such a file has none to say, infinite ones where it
    does not tell them.
    """

    form: str
    obs: list[NDArray[Any]]
    act: list[NDArray[Any]]
    terminated: list[bool | None]
    rewards: list[NDArray[Any]] | None
    vague: bool = False
    bounds: Bounds | None = None


def extra(module: str) -> Any:
    """The module, which the extra `minari` installs. Raises BadInput where it cannot be imported."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        why = f"{module} cannot be imported: pip install 'irl-bench[minari]'"
        raise BadInput(why, page="demonstrations") from error


def raw(path: Path) -> Raw:
    """What is in the file or folder. Raises BadInput where an extra is missing, and for what is damaged
    whatever libraries raise."""
    if not path.is_dir():
        return _npz(path)
    if os.path.lexists(path / "state.json"):
        return _imitation(path)
    data = path / "data" if os.path.lexists(path / "data") else path
    if data != path and data.is_symlink():
        raise ValueError("its data is a link")
    if os.path.lexists(data / "metadata.json"):
        return _minari(data)
    raise ValueError("it holds neither the state.json of imitation nor the data/metadata.json of Minari")


def write_minari(
    path: Path, dataset_id: str, spec: EnvSpec, episodes: Episodes, rewards: Sequence[Array], **said: str
) -> None:
    """A new dataset of Minari, the folder `path`, in parquet. Actions are in [-1, 1], or choices.

    said: what `create_dataset_from_buffers` is told of where they come from. Raises BadInput where Minari is
    missing.
    """
    minari = extra("minari")
    buffers = [
        minari.data_collector.EpisodeBuffer(
            observations=obs,
            actions=act.argmax(axis=1) if spec.discrete else act,
            rewards=paid,
            terminations=_last(len(act), terminated),
            truncations=_last(len(act), not terminated),
            infos={},
        )
        for obs, act, terminated, paid in zip(
            episodes.obs, episodes.act, episodes.terminated, rewards, strict=True
        )
    ]
    box = spaces.Box(-1.0, 1.0, (spec.act_size,), np.float64)
    path = path.absolute()  # for Minari joins a relative one twice
    path.parent.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent) as scratch,
        _minari_writes_to(scratch),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # of an environment, which it is not given
        minari.create_dataset_from_buffers(
            dataset_id,
            buffers,
            action_space=spaces.Discrete(spec.act_size) if spec.discrete else box,
            observation_space=spaces.Box(-np.inf, np.inf, (spec.obs_size,), np.float64),
            data_format="parquet",
            **said,
        )
        (Path(scratch) / dataset_id).rename(path)


@contextmanager
def _minari_writes_to(folder: str) -> Iterator[None]:
    before = os.environ.get(PLACE)
    os.environ[PLACE] = folder
    try:
        yield
    finally:
        del os.environ[PLACE]
        if before is not None:
            os.environ[PLACE] = before


def _last(steps: int, value: bool) -> NDArray[np.bool_]:
    """(T,): false but for the last, which is the value."""
    flags = np.zeros(steps, bool)
    flags[-1] = value
    return flags


def _npz(path: Path) -> Raw:
    data = read(path, LARGEST)
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise ValueError("it is no .npz file; pickles are not read")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > LARGEST:
        raise ValueError(f"it holds more than {LARGEST >> 20} MiB")
    with np.load(io.BytesIO(data)) as there:
        names = set(there.files)
        if {"obs", "act", "lengths", "terminated"} <= names:
            lengths = _whole(there["lengths"])
            rewards = there["rewards"] if "rewards" in names else None
            obs, act, flags = there["obs"], there["act"], there["terminated"]
            form, vague = "npz", False
        elif {"obs", "acts", "indices", "terminal"} <= names:
            act, flags = there["acts"], there["terminal"]
            obs, rewards = there["obs"], there["rews"] if "rews" in names else None
            lengths = np.diff([0, *_whole(there["indices"]), len(act)])
            form, vague = "imitation's npz", True
        else:
            raise ValueError(f"it has none of the sets of arrays that are known, but {sorted(names)}")
    if not 0 < len(lengths) <= MOST_EPISODES or lengths.min() < 1 or flags.shape != lengths.shape:
        raise ValueError("its lengths and endings do not list the same episodes, each of a step or more")
    if (len(obs), len(act)) != (lengths.sum() + len(lengths), lengths.sum()):
        raise ValueError(f"{len(obs)} observations and {len(act)} actions are not those of its episodes")
    if rewards is not None and rewards.shape != (len(act),):
        raise ValueError(f"it has rewards {rewards.shape} for {len(act)} steps")
    ends = np.cumsum(lengths)
    return Raw(
        form,
        np.split(obs, (ends + np.arange(1, len(ends) + 1))[:-1]),
        np.split(act, ends[:-1]),
        _endings(flags.tolist()),
        None if rewards is None else np.split(rewards, ends[:-1]),
        vague,
    )


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"whole numbers are needed where it has {values.dtype} {values.shape}")
    return values.astype(np.int64)


def _endings(flags: list[Any]) -> list[bool | None]:
    if odd := [flag for flag in flags if flag not in (0, 1)]:
        raise ValueError(f"its endings must be true or false, not {odd[0]!r:.40}")
    return [bool(flag) for flag in flags]


def _imitation(path: Path) -> Raw:
    state = json.loads(read(path / "state.json", LARGEST))
    names = [entry["filename"] for entry in state["_data_files"]]
    if not names or not all(isinstance(name, str) and Path(name).name == name for name in names):
        raise ValueError("its state.json names no files beside it")
    obs, act, rewards = list[NDArray[Any]](), list[NDArray[Any]](), list[NDArray[Any]]()
    ended: list[bool | None] = []
    for name in names:
        table = _table(path / name, "stream")
        if table.num_rows + len(obs) > MOST_EPISODES:
            raise ValueError(f"it has more than {MOST_EPISODES:,} episodes")
        obs += [np.array(row) for row in table["obs"].to_pylist()]
        act += [np.array(row) for row in table["acts"].to_pylist()]
        ended += _endings(table["terminal"].to_pylist())
        if "rews" in table.column_names:
            rewards += [np.array(row) for row in table["rews"].to_pylist()]
    return Raw("imitation", obs, act, ended, rewards if len(rewards) == len(obs) else None, vague=True)


def _table(path: Path, kind: str) -> Any:
    """kind: 'stream' or 'arrow', which is a file of such, with all their columns; or 'parquet', with those of
    Minari. Raises ValueError for what is no such file."""
    import pyarrow as pa
    from pyarrow import parquet

    data = pa.py_buffer(read(path, LARGEST))
    try:
        if kind == "parquet":
            file = parquet.ParquetFile(pa.BufferReader(data))
            widths = [getattr(column, "list_size", 1) for column in file.schema_arrow.types]
            if file.metadata.num_rows * sum(widths) > LARGEST // 8:  # for which few bytes may stand
                raise ValueError(f"it holds more than {LARGEST >> 20} MiB")
            table = file.read(columns=["observations", *STEPS], use_threads=False)
        else:
            table = (pa.ipc.open_stream if kind == "stream" else pa.ipc.open_file)(data).read_all()
        table.validate(full=True)  # or damaged offsets would end this process
    except pa.ArrowException as error:
        raise ValueError(f"{path.name} is no file of the kind {kind}: {error}") from error
    return table


def _minari(data: Path) -> Raw:
    try:
        facts = json.loads(read(data / "metadata.json"))
        count, kind = facts["total_episodes"], facts["data_format"]
        space = json.loads(facts["action_space"]) if "action_space" in facts else None
        bounds = _bounds_of(space) if space is not None else (-math.inf, math.inf)
        if type(count) is not int or not 0 < count <= MOST_EPISODES:
            raise ValueError(f"it has {count!r:.20} episodes where 1 to {MOST_EPISODES:,} are read")
        if kind not in ("hdf5", "parquet", "arrow"):
            raise ValueError(f"its data_format is {kind!r:.20} where hdf5, parquet or arrow is read")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise ValueError(f"its metadata.json cannot be used: {error}") from error
    rewards, size = list[NDArray[Any]](), 0
    found = Raw(f"Minari {kind}", [], [], [], rewards, bounds=bounds)
    for i, episode in enumerate(_hdf5(data, count) if kind == "hdf5" else _tables(data, count, kind)):
        size += sum(values.nbytes for values in episode.values())
        if size > LARGEST:
            raise ValueError(f"it holds more than {LARGEST >> 20} MiB")
        found.obs.append(episode["observations"])
        found.act.append(episode["actions"])
        found.terminated.append(_ending(episode["terminations"], episode["truncations"], i))
        rewards.append(episode["rewards"])
    return found


def _bounds_of(space: Any) -> Bounds | None:
    """Those of a space of actions in Minari's JSON, where it is a box."""
    if space["type"] == "Discrete" and space["start"] == 0:
        return None
    if space["type"] != "Box":
        raise ValueError(f"its actions are neither numbers nor choices from 0 on, but {space!r:.80}")
    low, high = (np.array(space[end], np.float64).ravel() for end in ("low", "high"))
    if not (low < high).all():
        raise ValueError(f"its action_space has a low bound that is not below the high one: {space!r:.80}")
    return low, high


def _ending(terminations: NDArray[Any], truncations: NDArray[Any], episode: int) -> bool | None:
    """Whether the episode terminated; None where it neither did nor was cut."""
    for flags in (terminations, truncations):
        if flags.dtype != bool or flags.ndim != 1 or len(flags) != len(terminations) or not len(flags):
            raise ValueError(f"episode {episode} has no terminations and truncations for each of its steps")
    if (terminations | truncations)[:-1].any():
        raise ValueError(f"episode {episode} goes on after it ended")
    return bool(terminations[-1]) if terminations[-1] or truncations[-1] else None


def _tables(data: Path, count: int, kind: str) -> Iterator[Columns]:
    for i in range(count):
        folder = data / str(i)
        if folder.is_symlink():
            raise ValueError(f"its {i} is a link")
        table = _table(folder / f"part-0.{kind}", kind)
        obs, *steps = (_column(table[name], f"episode {i} has {name}") for name in ("observations", *STEPS))
        # The last row is of the last observation, and holds nothing else.
        yield {"observations": obs} | {name: rows[:-1] for name, rows in zip(STEPS, steps, strict=True)}


def _column(column: Any, where: str) -> NDArray[Any]:
    from pyarrow import types

    rows = column.combine_chunks()
    width = (rows.type.list_size,) if types.is_fixed_size_list(rows.type) else ()
    values = rows.flatten() if width else rows
    kinds = (types.is_integer, types.is_floating, types.is_boolean)
    if not any(kind(values.type) for kind in kinds) or rows.null_count or values.null_count:
        raise ValueError(f"{where} of type {rows.type!s:.80}, or with gaps; flat rows of numbers are needed")
    return np.asarray(values.to_numpy(zero_copy_only=False)).reshape(len(rows), *width)


def _hdf5(data: Path, count: int) -> Iterator[Columns]:
    h5py = extra("h5py")
    whole = read(data / "main_data.hdf5", LARGEST)
    with h5py.File(io.BytesIO(whole), "r") as file:
        for i in range(count):
            group = _member(file, f"episode_{i}", h5py.Group)
            members = {name: _member(group, name, h5py.Dataset) for name in ("observations", *STEPS)}
            yield {name: _values(member, len(whole)) for name, member in members.items()}


def _member(group: Any, name: str, kind: type) -> Any:
    """What has that name in a group of HDF5, where links may lead to other files."""
    if type(group.get(name, getlink=True)).__name__ != "HardLink" or not isinstance(group[name], kind):
        raise ValueError(
            f"{name} of {group.name} is no {kind.__name__.lower()} in the file itself; "
            "links, dictionaries and tuples are not read"
        )
    return group[name]


def _values(dataset: Any, most: int) -> NDArray[Any]:
    """Of an array that is in the file itself, as it is. Of others, and of some that are damaged, HDF5 would
    read other files, or without an end."""
    if dataset.is_virtual or dataset.external or dataset.id.get_create_plist().get_nfilters():
        raise ValueError(f"{dataset.name} is compressed, or not in the file")
    if dataset.shape is None or dataset.dtype.kind not in "fiub":
        raise ValueError(f"{dataset.name} holds {dataset.dtype} {dataset.shape}; numbers are needed")
    chunk = dataset.chunks or (0,) * dataset.ndim
    size = max(dataset.nbytes, math.prod(chunk) * dataset.dtype.itemsize)
    if len(chunk) != dataset.ndim or size > min(dataset.id.get_storage_size(), most):
        raise ValueError(f"{dataset.name} {dataset.shape} is not whole")
    return np.asarray(dataset[()])
