"""Demonstrations of a file for a task: read, checked and scaled; and written."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from envs.flat import vectors
from harness.demonstrations import apart, preferences
from harness.demonstrations.arrays import from_arrays, split, to_arrays
from harness.demonstrations.forms.npz import ACT_BOUNDS
from harness.demonstrations.recording import AS_IT_IS, OWN_FORM, Bounds, Reading, Recording
from harness.demonstrations.units import (
    OPTION,
    SCALED,
    SLACK,
    Units,
    choices,
    space_observed,
    units_of,
)
from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import write_atomic
from methods.base import Array, Episodes

LARGEST_RETURN = 1e100
"""Largest sum of the sizes of an episode's rewards."""
MOST_OF_NAMES = 200
"""Most characters of the names of merged files."""


@dataclass(frozen=True)
class Demonstrations:
    """Demonstrations of a file, as a task has them.

    `episodes`: actions in [-1, 1], or choices, or none. `rewards`: (T,) an episode; None where the file has
    none. `form`: name of the file's form. `guessed`: number of episodes that end at the horizon and count as
    cut there, though the file calls them terminal. `cut`: number of those that neither terminated nor last
    until the horizon. `units`: units of actions in the file, None where it has none. `clipped`: number of
    actions that rounding had put outside of these. `files`: names of the files, where several are merged.
    `preferences`: digest of those of a file.
    """

    episodes: Episodes
    rewards: tuple[Array, ...] | None
    form: str
    guessed: int = 0
    cut: int = 0
    units: Units | None = None
    clipped: int = 0
    files: tuple[str, ...] = ()
    preferences: str = ""

    @property
    def returns(self) -> Array | None:
        """Returns of the episodes by the file's rewards, (N,)."""
        return None if self.rewards is None else np.array([rewards.sum() for rewards in self.rewards])

    @property
    def digest(self) -> str:
        """Digest of observations, actions and endings, whatever the file's form."""
        digest = hashlib.sha256()
        for obs, act in zip(self.episodes.obs, self.episodes.act, strict=True):
            digest.update(f"{obs.shape} {act.shape}".encode() + obs.tobytes() + act.tobytes())
        digest.update(bytes(self.episodes.terminated))
        return digest.hexdigest()[:16]

    def __str__(self) -> str:
        """Return the content in a line, without the file's form, which does not matter."""
        paid = ""
        if self.rewards is not None and self.returns is not None:
            digest = hashlib.sha256(np.concatenate(self.rewards).tobytes()).hexdigest()[:8]
            paid = f", return {self.returns.mean():.6g} by rewards {digest}"
        episodes, steps = len(self.episodes), int(self.episodes.lengths.sum())
        of_files = f" of {', '.join(self.files)}"[:MOST_OF_NAMES] if self.files else ""
        preferred = f", preferences {self.preferences}" if self.preferences else ""
        return f"{self.digest}: {episodes} episodes, {steps} steps{paid}{preferred}{of_files}"


def read(path: Path, spec: EnvSpec, bounds: Bounds | None = None, how: Reading = AS_IT_IS) -> Demonstrations:
    """Return the demonstrations of a file or folder, in the units of the task.

    `bounds`: the lowest and the highest actions there; default: by the file, or else the task's own. An
    episode as long as the horizon counts as cut there where the form may call such an end terminal. Raises
    BadInput for any other file, and for what does not fit the task.
    """
    try:
        return fitted(apart.recording_in(path, how), spec, bounds)
    except (ValueError, MemoryError) as error:
        reason = str(error) or "it takes more memory than there is"
        raise BadInput(f"{path}: no demonstrations of {spec.name}: {reason}", "demonstrations") from error


def read_all(
    paths: Sequence[Path],
    spec: EnvSpec,
    bounds: Bounds | None = None,
    how: Reading = AS_IT_IS,
    preferred: Path | None = None,
) -> Demonstrations:
    """Return the demonstrations of one file, or of several, with preferences: those of the file `preferred`,
    or of higher returns where rewards are known. Raises BadInput as `merged` and `preferences.in_file` do."""
    found = merged(paths, spec, bounds, how)
    pairs, digest = None if found.returns is None else preferences.by_returns(found.returns), ""
    if preferred is not None:
        pairs = preferences.in_file(preferred, len(found.episodes))
        digest = hashlib.sha256(pairs.tobytes()).hexdigest()[:8]
    return replace(found, episodes=replace(found.episodes, preferences=pairs), preferences=digest)


def merged(paths: Sequence[Path], spec: EnvSpec, bounds: Bounds | None, how: Reading) -> Demonstrations:
    """Return the demonstrations of one file, or of several, one after the other. Rewards are known where all
    files have them. Raises BadInput as `read` does, and where some files alone have actions."""
    every = [read(path, spec, bounds, how) for path in paths]
    if len(every) == 1:
        return every[0]
    if len({one.episodes.has_actions for one in every}) > 1:
        raise BadInput("some of these files have actions, and others have none", "demonstrations")
    rewards = [one.rewards for one in every if one.rewards is not None]
    return Demonstrations(
        Episodes(
            tuple(obs for one in every for obs in one.episodes.obs),
            tuple(act for one in every for act in one.episodes.act),
            tuple(ended for one in every for ended in one.episodes.terminated),
        ),
        tuple(paid for its in rewards for paid in its) if len(rewards) == len(every) else None,
        ", ".join(dict.fromkeys(one.form for one in every)),
        guessed=sum(one.guessed for one in every),
        cut=sum(one.cut for one in every),
        clipped=sum(one.clipped for one in every),
        files=tuple(printable(path.name) for path in paths),
    )


def write(path: Path, episodes: Episodes, rewards: Sequence[Array] | None = None) -> None:
    """Write an `.npz` of this project. Raises BadInput for another name, or where it is there already, and
    ValueError for episodes with steps that are not shown."""
    check_new(path)
    if path.suffix != ".npz":
        raise BadInput(f"{path}: give a name that ends in .npz")
    if not episodes.whole:
        raise ValueError("only episodes whose every step is shown can be written")
    buffer, arrays = io.BytesIO(), to_arrays(episodes, rewards)
    if episodes.has_actions:
        arrays[ACT_BOUNDS] = SCALED.repeat(arrays["act"].shape[1], axis=1)
    else:
        del arrays["act"]
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    write_atomic(path, buffer.getvalue())


def check_new(path: Path) -> None:
    """Raise BadInput where something is at `path`, or it lies in no folder."""
    if os.path.lexists(path):
        raise BadInput(f"{path} is there already; give another name")
    if not path.parent.is_dir() and os.path.lexists(path.parent):
        raise BadInput(f"{path}: {path.parent} is no folder")


def fitted(recording: Recording, spec: EnvSpec, bounds: Bounds | None) -> Demonstrations:
    """Return a recording's episodes as the task's. Raises ValueError for what does not fit."""
    arrays, lengths, env = recording.arrays, recording.arrays["lengths"].astype(np.int64), spec.make()
    if lengths.max() > spec.horizon:
        longest = int(lengths.argmax())
        raise ValueError(f"episode {longest} has {lengths[longest]} steps, and the horizon is {spec.horizon}")
    obs = _numbers(_observed(recording, env), spec.obs_size, "observations")
    units, clipped = None, 0
    if not recording.has_actions:
        if bounds is not None:
            raise ValueError(f"it has no actions that {OPTION} could be of")
        act = np.zeros((len(arrays["act"]), 0))
    else:
        units = units_of(recording, spec, env, bounds)
        if spec.discrete:
            act = _choices(recording, spec, choices(env))
        else:
            act, clipped = _scaled(arrays["act"], spec, units)
    _check_possible(obs, lengths, spec, env.observation_space)
    full, rewards = lengths == spec.horizon, None
    if unended := [i for i in recording.unended if not full[i]]:
        raise ValueError(
            f"episode {unended[0]} neither terminated nor was cut where it ends, before the horizon"
        )
    terminated = arrays["terminated"].astype(bool)
    guessed = terminated & full & recording.calls_all_ends_terminal
    terminated &= ~guessed
    if "rewards" in arrays:
        paid = _numbers(arrays["rewards"][:, None], 1, "rewards")[:, 0]
        if np.abs(paid).max() > LARGEST_RETURN / lengths.max():
            raise ValueError(f"it has rewards that sum to more than {LARGEST_RETURN:g}")
        rewards = split(paid, lengths)
    episodes = from_arrays({"obs": obs, "act": act, "lengths": lengths, "terminated": terminated})
    cut = int((~terminated & ~full).sum())
    return Demonstrations(episodes, rewards, recording.form, int(guessed.sum()), cut, units, clipped)


def _observed(recording: Recording, env: gym.Env[Any, Any]) -> NDArray[Any]:
    """Return a file's observations, which the task makes vectors if they are of its space, or images. Raises
    ValueError for choices that the space does not have, and for a file with others."""
    rows, states, space = recording.arrays["obs"], recording.states, space_observed(env)
    if env.has_wrapper_attr("encoded"):
        episodes = split(rows, recording.arrays["lengths"].astype(np.int64) + 1)
        return np.concatenate([*map(env.get_wrapper_attr("encoded"), episodes)])
    if states is not None:
        known = isinstance(space, gym.spaces.Discrete) and (int(space.start), int(space.n))
        if known != states:
            its = f"numbers from {states[0]} to {sum(states) - 1}"
            raise ValueError(f"its observations are {its}, and the task's are {space or 'vectors'}")
    return rows if space is None else vectors(space, rows)


def _check_possible(obs: Array, lengths: NDArray[Any], spec: EnvSpec, space: gym.Space[Any]) -> None:
    """Raise ValueError for observations that the task's space does not have."""
    assert isinstance(space, gym.spaces.Box)
    low, high = (end.astype(np.float64) for end in (space.low, space.high))
    beyond = SLACK * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    if (outside := (obs < low - beyond) | (obs > high + beyond)).any():
        row, entry = np.argwhere(outside)[0]
        raise ValueError(
            f"episode {_episode(row, lengths + 1)} observes {obs[row, entry]:.6g} as "
            f"{spec.observations[entry].name}, which lies in [{low[entry]:g}, {high[entry]:g}]"
        )


def _episode(row: int, counts: NDArray[Any]) -> int:
    """Return the episode that a row belongs to. counts: (N,) rows of each."""
    return int(np.searchsorted(np.cumsum(counts), row, side="right"))


def _numbers(rows: NDArray[Any], size: int, name: str) -> Array:
    if rows.ndim != 2 or rows.shape[1] != size:
        raise ValueError(f"it has {name} {rows.dtype} {rows.shape}; ({len(rows)}, {size}) are needed")
    values = np.array(rows, np.float64)
    if not np.isfinite(values).all():
        row = int(np.argwhere(~np.isfinite(values))[0, 0])
        raise ValueError(f"it has {name} that are not finite, the first in row {row} of all")
    return values


def _scaled(rows: NDArray[Any], spec: EnvSpec, units: Units) -> tuple[Array, int]:
    """Return actions (T, A) of the file in [-1, 1], and the number of those that rounding had put outside.
    Raises ValueError for some farther outside of its bounds."""
    act = _numbers(rows, spec.act_size, "actions")
    excess = units.excess(rows)
    if outside := int((excess > 0).any(axis=1).sum()):
        entry = excess.max(axis=0).argmax()
        raise ValueError(
            f"{outside} of {len(excess)} actions ({100 * outside / len(excess):.2g} %) are outside of "
            f"{units}, by {excess.max():.6g} at most, in {spec.actions[entry].name}; if the environment "
            f"clipped them, clip them in the file, and only if all are in other units, give {OPTION}"
        )
    return units.scaled(act), int((units.beyond(act) > 0).any(axis=1).sum())


def _choices(recording: Recording, spec: EnvSpec, table: NDArray[Any]) -> Array:
    """Return the choices of a file (T, A). They are numbers (T,) or (T, 1), the parts of the task's own
    choices (T, P), or rows of one 1 among 0s (T, A). Raises ValueError for others.

    table: as of `harness.demonstrations.units.choices`.
    """
    rows, lengths, own_width = recording.arrays["act"], recording.arrays["lengths"], table.shape[1]
    own = recording.form == OWN_FORM
    if rows.ndim == 2 and rows.shape[1] == spec.act_size and (own or own_width != spec.act_size):
        act = _numbers(rows, spec.act_size, "actions")
        odd = ~((act == 0) | (act == 1)).all(axis=1) | (act.sum(axis=1) != 1)
        if odd.any():
            number = _episode(int(odd.argmax()), lengths)
            raise ValueError(f"episode {number} has actions that are no choice: one 1 among 0s is needed")
        return act
    rows = rows[:, None] if rows.ndim == 1 else rows
    if rows.shape[1:] == (1,) and own_width > 1:
        table = np.arange(len(table))[:, None]
    if rows.shape[1:] != table.shape[1:]:
        raise ValueError(
            f"it has actions {rows.dtype} {rows.shape}; for each step the number of a choice is needed"
            f"{f', or its {own_width} parts' * (own_width > 1)}"
        )
    chosen = (rows[:, None] == table).all(axis=2)
    if (odd := ~chosen.any(axis=1)).any():
        if table.shape[1] == 1:
            raise ValueError(f"its choices must be whole numbers from {table[0, 0]} to {table[-1, 0]}")
        row, number = rows[odd][0].tolist(), _episode(int(odd.argmax()), lengths)
        raise ValueError(f"episode {number} has the action {row}, which is none of the task's {len(table)}")
    return np.asarray(chosen, np.float64)
