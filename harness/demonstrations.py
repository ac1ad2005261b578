"""Demonstrations of others, and for others: read from files of several forms, written, and looked at."""

from __future__ import annotations

import hashlib
import io
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness import demonstration_forms as forms
from harness.arguments import installed_version
from harness.judge.numbers import as_text
from harness.judge.results import Conditions
from harness.learn.seeds import demonstration_seeds
from harness.learn.simulator import Simulator
from harness.learn.world import without_rewards
from harness.registry import SPECS, BadInput, Demonstrator
from harness.run.codec import printable
from harness.run.experts import demonstrator, expert_for
from harness.run.files import write_atomic
from methods.base import Array, Episodes

SLACK = 1e-6
"""How far outside the bounds an action may be, by rounding; it is moved to the bound."""
FARTHEST = 1e6
"""Bounds of actions beyond it are none."""
BINS = 10
MOST_PAID = 1e100
"""What an episode may return, at most."""
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
    though the file calls them terminal. cut: how many neither terminated nor last until the horizon.
    """

    episodes: Episodes
    rewards: tuple[Array, ...] | None
    form: str
    guessed: int = 0
    cut: int = 0

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
        paid = ""
        if self.rewards is not None and self.returns is not None:
            digest = hashlib.sha256(np.concatenate(self.rewards).tobytes()).hexdigest()[:8]
            paid = f", return {self.returns.mean():.6g} by rewards {digest}"
        episodes, steps = len(self.episodes), int(self.episodes.lengths.sum())
        return f"{self.digest}: {episodes} episodes, {steps} steps{paid}"


def read(path: Path, spec: EnvSpec, bounds: tuple[float, float] | None = None) -> Found:
    """What the file or folder holds, for the task. bounds: of the actions there; default: [-1, 1].

    An episode that the file calls terminal and that is as long as the horizon is taken for cut there: some
    libraries call every end terminal. Raises BadInput for what is no such file, or does not fit the task.
    """
    try:
        return _found(forms.raw(path), spec, bounds)
    except _DAMAGES as error:
        said = str(error)
        if isinstance(error, OSError) and error.strerror:
            inside = error.filename is not None and Path(error.filename) != path
            said = f"{error.strerror}: {error.filename}" if inside else error.strerror
        reason = printable(" ".join(said.split()))[:300] or type(error).__name__
        raise BadInput(f"{path}: no demonstrations of {spec.name}: {reason}", "demonstrations") from error


def write(path: Path, episodes: Episodes, rewards: Sequence[Array] | None = None) -> None:
    """An `.npz` of this project. Raises BadInput for another name, or where it is there already, ValueError
    for episodes of which not every step is shown."""
    _check_new(path)
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


def _check_new(path: Path) -> None:
    if os.path.lexists(path):
        raise BadInput(f"{path} is there already; give another name")
    if not path.parent.is_dir() and os.path.lexists(path.parent):
        raise BadInput(f"{path}: {path.parent} is no folder")


def export(path: Path, env: str, seed: int, count: int, kind: Demonstrator) -> None:
    """Writes demonstrations that a run of that seed shows: an `.npz`, or a folder of Minari where the name
    ends in something else. Raises BadInput where that is there already, or Minari is missing."""
    _check_new(path)
    if path.suffix == ".npz":
        write(path, *of_expert(env, seed, count, kind))
        return
    forms.extra("minari")
    episodes, rewards = of_expert(env, seed, count, kind)
    forms.write_minari(
        path,
        f"irl-bench/{re.sub(r'[^-_a-zA-Z0-9]', '_', env)}/{kind}-v0",
        SPECS[env],
        episodes,
        rewards,
        author="irl-bench",
        algorithm_name=kind,
        description=f"What a run of seed {seed} shows of {env}'s {kind} in irl-bench {installed_version()}, "
        "with actions in [-1, 1] or choices.",
    )


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
    if found.cut:
        lines.append(f"endings     {found.cut} neither terminated nor last until the horizon")
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
        lines += [
            f"returns     {as_text(found.returns.mean(), '.2f')} on average",
            *_histogram(found.returns),
        ]
    return lines


def _histogram(values: Array) -> list[str]:
    if np.ptp(values) <= SLACK * np.abs(values).max():
        return []
    counts, edges = np.histogram(values, BINS)
    scale = 40 / counts.max()
    spans = [f"{as_text(a, '10.2f')} to {as_text(b, '10.2f')}" for a, b in pairwise(edges)]
    bars = [f"{'#' * round(count * scale)}{' ' * bool(count)}{count or ''}" for count in counts]
    return [f"  {span} {bar}".rstrip() for span, bar in zip(spans, bars, strict=True)]


def _found(raw: forms.Raw, spec: EnvSpec, bounds: tuple[float, float] | None) -> Found:
    obs = [_numbers(rows, spec.obs_size, "observations", i) for i, rows in enumerate(raw.obs)]
    act = [_actions(rows, spec, bounds or raw.bounds or (-1.0, 1.0), i) for i, rows in enumerate(raw.act)]
    _check_possible(obs, spec)
    lengths = [len(rows) for rows in act]
    if longest := [i for i, length in enumerate(lengths) if length > spec.horizon]:
        raise ValueError(
            f"episode {longest[0]} has {lengths[longest[0]]} steps, and the horizon is {spec.horizon}"
        )
    full = [length == spec.horizon for length in lengths]
    for i, (end, cut) in enumerate(zip(raw.terminated, full, strict=True)):
        if end is None and not cut:
            raise ValueError(f"episode {i} neither terminated nor was cut where it ends, before the horizon")
    guessed = [raw.vague and bool(end) and cut for end, cut in zip(raw.terminated, full, strict=True)]
    terminated = tuple(bool(end) and not cut for end, cut in zip(raw.terminated, guessed, strict=True))
    rewards = None
    if raw.rewards is not None:
        rewards = tuple(
            _numbers(np.atleast_1d(r)[:, None], 1, "rewards", i)[:, 0] for i, r in enumerate(raw.rewards)
        )
        if [len(paid) for paid in rewards] != lengths:
            raise ValueError("an episode has not as many rewards as steps")
        if rewards and np.abs(np.concatenate(rewards)).max() > MOST_PAID / max(lengths):
            raise ValueError(f"it has rewards that sum to more than {MOST_PAID:g}")
    cut_short = sum(not end and not cut for end, cut in zip(terminated, full, strict=True))
    return Found(Episodes(tuple(obs), tuple(act), terminated), rewards, raw.form, sum(guessed), cut_short)


def _check_possible(obs: Sequence[Array], spec: EnvSpec) -> None:
    """Raises ValueError for observations that the task's space does not have."""
    space = spec.make().observation_space
    assert isinstance(space, gym.spaces.Box)
    low, high = (end.astype(np.float64) for end in (space.low, space.high))
    beyond = SLACK * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    for i, rows in enumerate(obs):
        if (outside := (rows < low - beyond) | (rows > high + beyond)).any():
            step, entry = np.argwhere(outside)[0]
            raise ValueError(
                f"episode {i} observes {rows[step, entry]:.6g} as {spec.obs_names[entry].name}, "
                f"which lies in [{low[entry]:g}, {high[entry]:g}]"
            )


def _numbers(rows: NDArray[Any], size: int, what: str, episode: int) -> Array:
    if rows.dtype.kind not in "fiub" or rows.ndim != 2 or rows.shape[1] != size:
        raise ValueError(f"episode {episode} has {what} {rows.dtype} {rows.shape}; (T, {size}) are needed")
    values = np.array(rows, np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"episode {episode} has {what} that are not finite")
    return values


def _actions(rows: NDArray[Any], spec: EnvSpec, bounds: forms.Bounds, episode: int) -> Array:
    """(T, A), as `Episodes` has them."""
    if spec.discrete and rows.ndim == 1:
        if first := spec.first_choice:
            raise ValueError(
                f"choices of this task begin at {first}; give them in rows, one 1 among 0s, for a file does "
                "not tell where its numbers begin"
            )
        if rows.dtype.kind not in "iu" or not (len(rows) and 0 <= rows.min() <= rows.max() < spec.act_size):
            raise ValueError(f"episode {episode}: choices must be whole numbers below {spec.act_size}")
        return np.asarray(np.eye(spec.act_size)[rows])
    act = _numbers(rows, spec.act_size, "actions", episode)
    if spec.discrete:
        if not (((act == 0) | (act == 1)).all() and (act.sum(axis=1) == 1).all()):
            raise ValueError(f"episode {episode} has actions that are no choice: one 1 among 0s is needed")
        return act
    if any(np.size(end) not in (1, spec.act_size) for end in bounds):
        raise ValueError("its bounds are of other actions than the task's")
    low, high = (np.broadcast_to(end, spec.act_size) for end in bounds)
    if not max(np.abs(low).max(), np.abs(high).max()) <= FARTHEST:
        raise ValueError("it does not tell the bounds of its actions; give them as --action-bounds")
    if (low != -1).any() or (high != 1).any():  # or rounding would change some
        act = 2 * (act - low) / (high - low) - 1
    outside = np.abs(act).max(axis=0, initial=0.0)
    if (most := outside.max()) > 1 + SLACK:
        there = f"[{low[outside.argmax()]:g}, {high[outside.argmax()]:g}]"
        raise ValueError(
            f"episode {episode} has an action outside of {there}, {most:.6g} times as far from its middle; "
            "give others as --action-bounds"
        )
    return np.asarray(np.clip(act, -1, 1))
