"""The forms that demonstrations have on disk: each read as it is there, and Minari's written.

`.npz` of this project: arrays obs (sum of T+1, O), act (sum of T, A) in [-1, 1], lengths (N,) and
terminated (N,), and optionally rewards (sum of T,) and act_bounds (2, A), the lowest and highest actions.
`.npz` of `imitation` before 1.0: obs, acts, indices, terminal and optionally rews.
A folder of `imitation` 1.0, which is one of Hugging Face's `datasets`: Arrow streams that state.json names.
Its `infos`, texts that stand for any Python object, are not looked at.
A dataset of Minari 0.5, or the folder `data` in it: metadata.json, and episodes in main_data.hdf5 or, one
each, in <number>/part-0.parquet or .arrow. They are read without Minari, which could make environments.

No pickle is read, and no link below a folder is followed, be it of the file system or of HDF5. Strangers'
files may ask for any memory and end a process: `harness.apart` reads them in another one.
"""

from __future__ import annotations

import importlib
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
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import opened, read

if TYPE_CHECKING:  # not for the process that reads, which starts in less time without
    from envs import EnvSpec
    from methods.base import Array, Episodes

LARGEST = 1 << 30
"""Bytes of a file that is read, and of the numbers in it, 8 for each, at most."""
MOST_EPISODES = 100_000
ONE_MORE = "an episode has one observation more than actions, of where its last one led"
FLAT = "flat rows of numbers are needed"
STEPS = ("actions", "rewards", "terminations", "truncations")
"""What Minari has of each step, besides observations."""
PLACE = "MINARI_DATASETS_PATH"
"""The variable that says where Minari writes."""
Columns = dict[str, NDArray[Any]]
Bounds = tuple[float, float] | tuple[NDArray[np.float64], NDArray[np.float64]]
"""The lowest and the highest action, of each component or of all."""


@dataclass(frozen=True)
class Raw:
    """As a file has it, an entry an episode.

    terminated: None where nothing is said of how the episode ended. vague: whether it may call terminal what
    was cut at the horizon. own: whether it is this project's `.npz`. bounds: of actions; None where such a
    file says none, infinite ones where it should. first: number of the first choice, where it is said.
    """

    form: str
    obs: list[NDArray[Any]]
    act: list[NDArray[Any]]
    terminated: list[bool | None]
    rewards: list[NDArray[Any]] | None
    vague: bool = False
    own: bool = False
    bounds: Bounds | None = None
    first: int | None = None

    @property
    def arrays(self) -> Iterator[tuple[int, str, NDArray[Any]]]:
        """Number of the episode, what it is, and the array."""
        for name, arrays in (("observations", self.obs), ("actions", self.act), ("rewards", self.rewards)):
            for i, array in enumerate(arrays or []):
                yield i, name, array


def extra(module: str) -> Any:
    """The module, which the extra `minari` installs. Raises BadInput where it cannot be imported."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        why = f"{module} cannot be imported: pip install 'irl-bench[minari]'"
        raise BadInput(why, page="demonstrations") from error


def raw(path: Path) -> Raw:
    """Return what is in the file or folder, arrays of numbers. Raises BadInput where an extra is missing, and
    ValueError for all that cannot be used."""
    try:
        found = _raw(path)
        for i, name, array in found.arrays:
            if array.dtype.kind not in "fiub" or not array.ndim:
                raise ValueError(f"episode {i} has {name} {array.dtype} {array.shape}; numbers are needed")
        _check_size(sum(array.size * max(1, array.itemsize // 8) for _, _, array in found.arrays))
    except BadInput:
        raise
    except MemoryError as error:
        raise ValueError("reading it takes more memory than is allowed") from error
    except Exception as error:  # whatever libraries raise for files that are no such thing
        said = str(error)
        if isinstance(error, OSError) and error.strerror:
            inside = error.filename is not None and Path(error.filename) != path
            said = f"{error.strerror}: {error.filename}" if inside else error.strerror
        raise ValueError(printable(" ".join(said.split()))[:300] or type(error).__name__) from error
    return found


def _check_size(numbers: int) -> None:
    if 8 * numbers > LARGEST:
        raise ValueError(f"it holds more than {LARGEST >> 20} MiB")


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    with opened(path) as file:
        if os.fstat(file.fileno()).st_size > LARGEST:
            raise ValueError(f"{path.name}: it is larger than {LARGEST >> 20} MiB")
        yield file


def _raw(path: Path) -> Raw:
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
    path: Path,
    dataset_id: str,
    spec: EnvSpec,
    episodes: Episodes,
    rewards: Sequence[Array],
    first: int,
    **said: str,
) -> None:
    """Write a new dataset of Minari, the folder `path`, in parquet. Actions are in [-1, 1], or choices.

    first: number of the first choice. said: what `create_dataset_from_buffers` is told of where they come
    from. Raises BadInput where Minari is missing.
    """
    from gymnasium import spaces

    minari = extra("minari")
    buffers = [
        minari.data_collector.EpisodeBuffer(
            observations=obs,
            actions=act.argmax(axis=1) + first if spec.discrete else act,
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
            action_space=spaces.Discrete(spec.act_size, start=first) if spec.discrete else box,
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
    bounds, own, vague = None, False, False
    with _opened(path) as file:
        if not zipfile.is_zipfile(file):
            raise ValueError("it is no .npz file; pickles are not read")
        file.seek(0)
        with _loaded(file) as there:
            _check_size(sum(entry.file_size for entry in there.zip.infolist()) // 8)
            names = set(there.files)
            if len(names) < len(there.files):
                raise ValueError("it has two arrays of one name")
            if {"obs", "act", "lengths", "terminated"} <= names:
                lengths = _whole(_array(there, "lengths"))
                rewards = _array(there, "rewards") if "rewards" in names else None
                obs, act, flags = (_array(there, name) for name in ("obs", "act", "terminated"))
                if "act_bounds" in names:
                    bounds = _two_rows(_array(there, "act_bounds"))
                form, own = "npz", True
            elif {"obs", "acts", "indices", "terminal"} <= names:
                obs, act, flags = (_array(there, name) for name in ("obs", "acts", "terminal"))
                rewards = _array(there, "rews") if "rews" in names else None
                lengths = np.diff([0, *_whole(_array(there, "indices")), len(act)])
                form, vague = "imitation's npz", True
            else:
                raise ValueError(f"it has none of the sets of arrays that are known, but {sorted(names)}")
    if not 0 < len(lengths) <= MOST_EPISODES or lengths.min() < 1 or flags.shape != lengths.shape:
        raise ValueError("its lengths and endings do not list the same episodes, each of a step or more")
    if (len(obs), len(act)) != (lengths.sum() + len(lengths), lengths.sum()):
        why = f"{len(obs)} observations and {len(act)} actions are not those of its episodes"
        raise ValueError(f"{why}; {ONE_MORE}" if len(obs) == len(act) else why)
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
        own,
        bounds,
    )


def _loaded(file: BinaryIO) -> Any:
    """Return NumPy's view of an archive. Raises ValueError for a damaged one."""
    try:
        return np.load(file)
    except MemoryError:
        raise
    except Exception as error:  # whatever NumPy and zipfile raise
        raise ValueError("it is no .npz file, or damaged; pickles are not read") from error


def _array(there: Any, name: str) -> NDArray[Any]:
    """Return an array (N, ...) of an archive. Raises ValueError where that name is of none, or a pickle."""
    try:
        array = there[name]
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(f"its {name} is damaged, or no array of numbers; pickles are not read") from error
    if not isinstance(array, np.ndarray) or not array.ndim:
        raise ValueError(f"its {name} is no array of a row or more")
    return array


def _two_rows(values: NDArray[Any]) -> Bounds:
    """Return the bounds in an array (2, A). Raises ValueError for no such ones."""
    if values.ndim != 2 or len(values) != 2 or values.dtype.kind not in "fiu":
        raise ValueError(f"its act_bounds {values.dtype} {values.shape} are no (2, A) of lows and highs")
    low, high = values.astype(np.float64)
    return _checked(low, high, "its act_bounds")


def _checked(low: NDArray[Any], high: NDArray[Any], where: str) -> Bounds:
    if not (low <= high).all():
        raise ValueError(f"{where} have a low bound that is not below the high one")
    return low, high


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"whole numbers are needed where it has {values.dtype} {values.shape}")
    return values.astype(np.int64)


def _endings(flags: list[Any]) -> list[bool | None]:
    if odd := [flag for flag in flags if flag not in (0, 1)]:
        raise ValueError(f"its endings must be true or false, not {odd[0]!r:.40}")
    return [bool(flag) for flag in flags]


def _imitation(path: Path) -> Raw:
    try:
        state = json.loads(read(path / "state.json"))
        names, chosen = (
            [entry["filename"] for entry in state["_data_files"]],
            state.get("_indices_data_files"),
        )
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError("its state.json does not list files of data, as that of a dataset does") from error
    if chosen:
        raise ValueError("it shows a selection of its rows; save it after `flatten_indices()`")
    if not 0 < len(names) <= MOST_EPISODES or not all(
        isinstance(name, str) and Path(name).name == name for name in names
    ):
        raise ValueError("its state.json names no files beside it, or too many")
    obs, act, rewards = list[NDArray[Any]](), list[NDArray[Any]](), list[NDArray[Any]]()
    ended, size = list[bool | None](), 0
    for name in names:
        table = _table(path / name, "stream", ("obs", "acts", "terminal", "rews"))
        if table.num_rows + len(obs) > MOST_EPISODES:
            raise ValueError(f"it has more than {MOST_EPISODES:,} episodes")
        for column, arrays in (("obs", obs), ("acts", act), ("rews", rewards)):
            if column in table.column_names or column != "rews":
                new = _lists(table[column], f"{name} has {column}")
                size += sum(array.size for array in new)
                _check_size(size)
                arrays.extend(new)
        ended += _endings(_column(table["terminal"], f"{name} has terminal").tolist())
    if not obs:
        raise ValueError("it holds no episode")
    return Raw("imitation", obs, act, ended, rewards if len(rewards) == len(obs) else None, vague=True)


def _table(path: Path, kind: str, names: Sequence[str]) -> Any:
    """Return the named columns of numbers and lists of them, as far as they are there.

    kind: 'stream' or 'arrow', which is a file of such, or 'parquet'. Raises ValueError for what is no such
    file.
    """
    import pyarrow as pa
    from pyarrow import parquet

    with _opened(path) as data:
        try:
            if kind == "parquet":
                file = parquet.ParquetFile(data)
                schema = file.schema_arrow
            else:
                open_ = pa.ipc.open_stream if kind == "stream" else pa.ipc.open_file
                schema = open_(data).schema
            if len(set(schema.names)) < len(schema.names):
                raise ValueError(f"{path.name} has two columns of one name")
            wanted = [i for i, name in enumerate(schema.names) if name in names]
            for i in wanted:
                _check_type(schema.types[i], f"{path.name} has {schema.names[i]}")
            if kind == "parquet":
                table = file.read(columns=[schema.names[i] for i in wanted], use_threads=False)
            else:
                data.seek(0)
                options = pa.ipc.IpcReadOptions(included_fields=wanted, use_threads=False)
                table = open_(data, options=options).read_all()
            table.validate(full=True)  # or damaged offsets would end this process
        except pa.ArrowException as error:
            if isinstance(error, MemoryError):
                raise
            raise ValueError(f"{path.name} is no file of the kind {kind}: {error}") from error
    return table


def _check_type(kind: Any, where: str) -> None:
    """Raise ValueError unless it is of numbers or lists of them, each with values of its own: of others, few
    bytes may stand for many numbers."""
    from pyarrow import types

    inner = kind
    while types.is_list(inner) or types.is_large_list(inner) or types.is_fixed_size_list(inner):
        inner = inner.value_type
    if not (types.is_integer(inner) or types.is_floating(inner) or types.is_boolean(inner)):
        raise ValueError(f"{where} of type {kind!s:.80}; {FLAT}")


def _lists(column: Any, where: str) -> list[NDArray[Any]]:
    """Return an array for each list in a column: (T,) of numbers, or (T, W) of lists of W numbers."""
    found = list[NDArray[Any]]()
    for chunk in column.chunks:
        rows, lengths = _flat(chunk, where)
        ends = np.cumsum(lengths)
        if _is_flat(rows.type):
            values = _plain(rows, where)
        else:
            inner, widths = _flat(rows, where)
            values = _plain(inner, where)
            if len(widths) and (widths != widths[0]).any():
                raise ValueError(f"{where} whose rows have {widths.min()} to {widths.max()} numbers")
            values = values.reshape(len(widths), -1 if len(values) else 0)
        found += np.split(values, ends[:-1]) if len(ends) else []
    return found


def _is_flat(kind: Any) -> bool:
    return not hasattr(kind, "value_type")


def _flat(lists: Any, where: str) -> tuple[Any, NDArray[np.int64]]:
    """Return all that is in the lists, one after the other, and how long each is."""
    from pyarrow import compute

    if _is_flat(lists.type) or lists.null_count:
        raise ValueError(f"{where} of type {lists.type!s:.80}, or with gaps; lists of rows are needed")
    values = lists.flatten()
    _check_size(len(values))
    return values, compute.list_value_length(lists).to_numpy(zero_copy_only=False).astype(np.int64)


def _plain(values: Any, where: str) -> NDArray[Any]:
    if not _is_flat(values.type) or values.null_count:
        raise ValueError(f"{where} of type {values.type!s:.80}, or with gaps; {FLAT}")
    return np.asarray(values.to_numpy(zero_copy_only=False))


def _minari(data: Path) -> Raw:
    try:
        facts = json.loads(read(data / "metadata.json"))
        count, kind = facts["total_episodes"], facts["data_format"]
        space = json.loads(facts["action_space"]) if "action_space" in facts else None
        bounds, first = _bounds_of(space) if space is not None else ((-math.inf, math.inf), None)
        steps = facts.get("total_steps")
        if type(count) is not int or not 0 < count <= MOST_EPISODES:
            raise ValueError(f"it has {count!r:.20} episodes where 1 to {MOST_EPISODES:,} are read")
        if kind not in ("hdf5", "parquet", "arrow"):
            raise ValueError(f"its data_format is {kind!r:.20} where hdf5, parquet or arrow is read")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise ValueError(f"its metadata.json cannot be used: {error}") from error
    rewards, size = list[NDArray[Any]](), 0
    found = Raw(f"Minari {kind}", [], [], [], rewards, bounds=bounds, first=first)
    for i, episode in enumerate(_hdf5(data, count) if kind == "hdf5" else _tables(data, count, kind)):
        size += sum(values.size for values in episode.values())
        _check_size(size)
        found.obs.append(episode["observations"])
        found.act.append(episode["actions"])
        found.terminated.append(_ending(episode["terminations"], episode["truncations"], i))
        rewards.append(episode["rewards"])
    there = sum(len(rows) for rows in found.act if rows.ndim)
    if steps not in (None, there):
        raise ValueError(f"its metadata.json tells of {steps!r:.20} steps, and its episodes have {there}")
    return found


def _bounds_of(space: Any) -> tuple[Bounds | None, int | None]:
    """Return the bounds of a space of actions in Minari's JSON, if it is a box, or else its first choice."""
    if space["type"] == "Discrete" and type(space["start"]) is int:
        return None, space["start"]
    if space["type"] != "Box":
        raise ValueError(f"its actions are neither numbers nor choices, but {space!r:.80}")
    low, high = (np.array(space[end], np.float64).ravel() for end in ("low", "high"))
    if low.shape != high.shape:
        raise ValueError(f"its action_space has {len(low)} low bounds and {len(high)} high ones")
    return _checked(low, high, "its action_space"), None


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
        table = _table(folder / f"part-0.{kind}", kind, ("observations", *STEPS))
        obs, *steps = (_column(table[name], f"episode {i} has {name}") for name in ("observations", *STEPS))
        # The last row is of the last observation, and holds nothing else.
        yield {"observations": obs} | {name: rows[:-1] for name, rows in zip(STEPS, steps, strict=True)}


def _column(column: Any, where: str) -> NDArray[Any]:
    from pyarrow import types

    rows = column.combine_chunks()
    width = (rows.type.list_size,) if types.is_fixed_size_list(rows.type) else ()
    if rows.null_count:
        raise ValueError(f"{where} of type {rows.type!s:.80}, or with gaps; {FLAT}")
    return _plain(rows.flatten() if width else rows, where).reshape(len(rows), *width)


def _hdf5(data: Path, count: int) -> Iterator[Columns]:
    h5py = extra("h5py")
    with _opened(data / "main_data.hdf5") as whole, h5py.File(whole, "r") as file:
        most = os.fstat(whole.fileno()).st_size
        for i in range(count):
            group = _member(file, f"episode_{i}", h5py.Group)
            members = {name: _member(group, name, h5py.Dataset) for name in ("observations", *STEPS)}
            yield {name: _values(member, most) for name, member in members.items()}


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
