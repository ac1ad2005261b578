"""Demonstrations of others, and for others: read from files of several formats, written, and looked at.

`.npz` of this project: arrays obs (sum of T+1, O), act (sum of T, A) in [-1, 1], lengths (N,) and
terminated (N,), and optionally rewards (sum of T,).
`.npz` of `imitation` before 1.0: obs, acts, indices, terminal and optionally rews.
A folder of `imitation` 1.0, which is one of Hugging Face's `datasets`: Arrow streams that state.json names.
Its `infos`, texts that stand for any Python object, are not looked at.

No pickle is read.
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.judge.results import Conditions
from harness.learn.seeds import demonstration_seeds
from harness.learn.simulator import Simulator
from harness.learn.world import without_rewards
from harness.registry import SPECS, BadInput, Demonstrator
from harness.run.codec import printable
from harness.run.experts import demonstrator, expert_for
from harness.run.files import opened, write_atomic
from methods.base import Array, Episodes

LARGEST = 1 << 30
"""Bytes of a file that is read, at most."""
MOST_EPISODES = 100_000
SLACK = 1e-6
"""How far outside the bounds an action may be, by rounding; it is moved to the bound."""
BINS = 10
_DAMAGES = (
    *(OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, MemoryError),
    *(RuntimeError, zipfile.BadZipFile, zlib.error, struct.error),
)
"""What libraries raise on files that are no such thing."""


@dataclass(frozen=True)
class Found:
    """What a file holds.

    episodes: actions in [-1, 1], or of choices. rewards: those in the file, (T,) an episode; None where it
    has none. form: of the file. guessed: how many episodes end at the horizon and are taken for cut there,
    though the file calls them terminal.
    """

    episodes: Episodes
    rewards: tuple[Array, ...] | None
    form: str
    guessed: int = 0

    @property
    def returns(self) -> Array | None:
        """(N,): of the episodes, by the file's rewards."""
        return None if self.rewards is None else np.array([rewards.sum() for rewards in self.rewards])

    @property
    def digest(self) -> str:
        """Of observations, actions and endings, whatever the file's form."""
        found = hashlib.sha256()
        for obs, act in zip(self.episodes.obs, self.episodes.act, strict=True):
            found.update(f"{obs.shape} {act.shape}".encode() + obs.tobytes() + act.tobytes())
        found.update(bytes(self.episodes.terminated))
        return found.hexdigest()[:16]

    def __str__(self) -> str:
        """In a line, without the file's form, which does not matter."""
        paid = "" if self.returns is None else f", return {self.returns.mean():.1f}"
        episodes, steps = len(self.episodes), int(self.episodes.lengths.sum())
        return f"{self.digest}: {episodes} episodes, {steps} steps{paid}"


def read(path: Path, spec: EnvSpec, bounds: tuple[float, float] | None = None) -> Found:
    """What the file or folder holds, for the task. bounds: of the actions there; default: [-1, 1].

    An episode that the file calls terminal and that is as long as the horizon is taken for cut there: some
    libraries call every end terminal. Raises BadInput for what is no such file, or does not fit the task.
    """
    try:
        if path.is_dir():
            form, raw = "imitation", _arrow(path)
        else:
            form, raw = _npz(path)
        return _found(form, raw, spec, bounds)
    except _DAMAGES as error:
        reason = printable(" ".join(str(error).split()))[:300] or type(error).__name__
        raise BadInput(f"{path}: no demonstrations of {spec.name}: {reason}") from error


def write(path: Path, episodes: Episodes, rewards: Sequence[Array] | None = None) -> None:
    """An `.npz` of this project. Raises BadInput for another name, ValueError for episodes of which not every
    step is shown."""
    if path.suffix != ".npz":
        raise BadInput(f"{path}: give a name that ends in .npz")
    if not episodes.whole:
        raise ValueError("only episodes of which every step is shown can be written")
    arrays: dict[str, NDArray[Any]] = {
        "obs": np.concatenate(episodes.obs),
        "act": np.concatenate(episodes.act),
        "lengths": episodes.lengths,
        "terminated": np.array(episodes.terminated),
    }
    if rewards is not None:
        arrays["rewards"] = np.concatenate(rewards)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    write_atomic(path, buffer.getvalue())


def of_expert(env: str, seed: int, count: int, kind: Demonstrator) -> tuple[Episodes, list[Array]]:
    """Demonstrations that a run of that seed shows, and their true rewards."""
    conditions = Conditions("full", "absorbing", "sbx")
    policy = demonstrator(expert_for(env, seed, conditions).policy, env, seed, kind, conditions)
    trajectories = Simulator(SPECS[env]).run(policy, demonstration_seeds(seed, count))
    return without_rewards(trajectories), [trajectory.rewards for trajectory in trajectories]


def described(found: Found) -> list[str]:
    """What there is to know of it, a line each."""
    episodes = found.episodes
    lengths, ended = episodes.lengths, sum(episodes.terminated)
    lines = [
        f"form        {found.form}",
        f"content     {found.digest}",
        f"episodes    {len(episodes)}, of which {ended} terminated",
        f"steps       {lengths.sum()}; {lengths.min()} to {lengths.max()} an episode",
    ]
    if found.guessed:
        lines.append(f"endings     {found.guessed} called terminal at the horizon are taken for cut there")
    for name, arrays in (("observed", episodes.obs), ("actions", episodes.act)):
        values = np.concatenate(arrays)
        for i, column in enumerate(values.T):
            spread = f"{column.min():.3g} to {column.max():.3g}, mean {column.mean():.3g}"
            lines.append(f"{name} {i:<3}{spread}")
    if found.returns is None:
        lines.append("returns     not told")
    else:
        lines += [f"returns     {found.returns.mean():.2f} on average", *_histogram(found.returns)]
    return lines


def _histogram(values: Array) -> list[str]:
    counts, edges = np.histogram(values, BINS)
    scale = 40 / counts.max()
    return [
        f"  {low:10.2f} to {high:10.2f} {'#' * round(count * scale)}{' ' * bool(count)}{count or ''}".rstrip()
        for count, low, high in zip(counts, edges, edges[1:], strict=False)
    ]


@dataclass(frozen=True)
class _Raw:
    """As a file has it, an entry an episode."""

    obs: list[NDArray[Any]]
    act: list[NDArray[Any]]
    terminated: list[bool]
    rewards: list[NDArray[Any]] | None
    vague: bool
    """Whether it may call terminal what was cut at the horizon."""


def _npz(path: Path) -> tuple[str, _Raw]:
    with opened(path) as file:
        data = file.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise ValueError(f"it is larger than {LARGEST >> 20} MiB")
    if not zipfile.is_zipfile(path):
        raise ValueError("it is no .npz file; pickles are not read")
    with zipfile.ZipFile(path) as archive:
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
    return form, _Raw(
        np.split(obs, (ends + np.arange(1, len(ends) + 1))[:-1]),
        np.split(act, ends[:-1]),
        [bool(flag) for flag in flags],
        None if rewards is None else np.split(rewards, ends[:-1]),
        vague,
    )


def _arrow(path: Path) -> _Raw:
    import pyarrow as pa

    with opened(path / "state.json") as file:
        state = json.loads(file.read(LARGEST))
    names = [entry["filename"] for entry in state["_data_files"]]
    if not names or not all(isinstance(name, str) and Path(name).name == name for name in names):
        raise ValueError("its state.json names no files beside it")
    obs, act, rewards = list[NDArray[Any]](), list[NDArray[Any]](), list[NDArray[Any]]()
    ended: list[bool] = []
    for name in names:
        with opened(path / name) as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise ValueError(f"{name} is larger than {LARGEST >> 20} MiB")
        try:
            table = pa.ipc.open_stream(pa.py_buffer(data)).read_all()
            table.validate(full=True)  # or damaged offsets would end this process
        except pa.ArrowException as error:
            raise ValueError(f"{name} is no Arrow stream: {error}") from error
        if table.num_rows + len(obs) > MOST_EPISODES:
            raise ValueError(f"it has more than {MOST_EPISODES:,} episodes")
        obs += [np.array(row) for row in table["obs"].to_pylist()]
        act += [np.array(row) for row in table["acts"].to_pylist()]
        ended += [bool(flag) for flag in table["terminal"].to_pylist()]
        if "rews" in table.column_names:
            rewards += [np.array(row) for row in table["rews"].to_pylist()]
    return _Raw(obs, act, ended, rewards if len(rewards) == len(obs) else None, vague=True)


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"whole numbers are needed where it has {values.dtype} {values.shape}")
    return values.astype(np.int64)


def _found(form: str, raw: _Raw, spec: EnvSpec, bounds: tuple[float, float] | None) -> Found:
    obs = [_numbers(rows, spec.obs_size, "observations", i) for i, rows in enumerate(raw.obs)]
    act = [_actions(rows, spec, bounds, i) for i, rows in enumerate(raw.act)]
    lengths = [len(rows) for rows in act]
    if longest := [i for i, length in enumerate(lengths) if length > spec.horizon]:
        raise ValueError(
            f"episode {longest[0]} has {lengths[longest[0]]} steps, and the horizon is {spec.horizon}"
        )
    full = [length == spec.horizon for length in lengths]
    guessed = [raw.vague and end and cut for end, cut in zip(raw.terminated, full, strict=True)]
    terminated = tuple(end and not cut for end, cut in zip(raw.terminated, guessed, strict=True))
    rewards = None
    if raw.rewards is not None:
        rewards = tuple(_numbers(r[:, None], 1, "rewards", i)[:, 0] for i, r in enumerate(raw.rewards))
    return Found(Episodes(tuple(obs), tuple(act), terminated), rewards, form, sum(guessed))


def _numbers(rows: NDArray[Any], size: int, what: str, episode: int) -> Array:
    if rows.dtype.kind not in "fiub" or rows.ndim != 2 or rows.shape[1] != size:
        raise ValueError(f"episode {episode} has {what} {rows.dtype} {rows.shape}; (T, {size}) are needed")
    values = np.array(rows, np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"episode {episode} has {what} that are not finite")
    return values


def _actions(rows: NDArray[Any], spec: EnvSpec, bounds: tuple[float, float] | None, episode: int) -> Array:
    """(T, A), as `Episodes` has them."""
    if spec.discrete and rows.ndim == 1:
        if rows.dtype.kind not in "iu" or not (len(rows) and 0 <= rows.min() <= rows.max() < spec.act_size):
            raise ValueError(f"episode {episode}: choices must be whole numbers below {spec.act_size}")
        return np.asarray(np.eye(spec.act_size)[rows])
    act = _numbers(rows, spec.act_size, "actions", episode)
    if spec.discrete:
        return spec.executed(act)
    low, high = bounds or (-1.0, 1.0)
    if bounds is not None:
        act = 2 * (act - low) / (high - low) - 1
    if (outside := np.abs(act).max(initial=0.0)) > 1 + SLACK:
        hint = "" if bounds else "; give others as --action-bounds"
        raise ValueError(
            f"episode {episode} has an action {outside:.3g} times as large as [{low:g}, {high:g}]{hint}"
        )
    return np.asarray(np.clip(act, -1, 1))
