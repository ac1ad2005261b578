"""Demonstrations of others, and for others: read from files of several forms, written, and looked at."""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness import action_units, apart
from harness import demonstration_forms as forms
from harness.action_units import SLACK, Units
from harness.arguments import installed_version
from harness.judge.numbers import as_text
from harness.judge.results import Conditions
from harness.learn.seeds import demonstration_seeds
from harness.learn.simulator import Simulator
from harness.learn.world import without_rewards
from harness.registry import SPECS, BadInput, Demonstrator
from harness.run.experts import demonstrator, expert_for
from harness.store.files import write_atomic
from methods.base import Array, Episodes

BINS = 10
MOST_PAID = 1e100
"""What an episode may return, at most."""


@dataclass(frozen=True)
class Found:
    """What a file holds.

    episodes: actions in [-1, 1], or of choices. rewards: those in the file, (T,) an episode; None where it
    has none. form: of the file. guessed: how many episodes end at the horizon and are taken for cut there,
    though the file calls them terminal. cut: how many neither terminated nor last until the horizon.
    units: of actions in the file.
    """

    episodes: Episodes
    rewards: tuple[Array, ...] | None
    form: str
    guessed: int = 0
    cut: int = 0
    units: Units | None = None

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


def read(path: Path, spec: EnvSpec, bounds: forms.Bounds | None = None) -> Found:
    """Return what the file or folder holds, for the task.

    bounds: the lowest and the highest action there, of each component or of all; default: as the file says,
    or else the task's own. An episode that the file calls terminal and that is as long as the horizon is
    taken for cut there: some libraries call every end terminal. Raises BadInput for what is no such file, or
    does not fit the task.
    """
    try:
        return _found(apart.raw(path), spec, bounds)
    except (ValueError, MemoryError) as error:
        reason = str(error) or "it takes more memory than there is"
        raise BadInput(f"{path}: no demonstrations of {spec.name}: {reason}", "demonstrations") from error


def write(path: Path, episodes: Episodes, rewards: Sequence[Array] | None = None) -> None:
    """Write an `.npz` of this project. Raises BadInput for another name, or where it is there already, and
    ValueError for episodes with steps that are not shown."""
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
        "act_bounds": np.array(action_units.SCALED)[:, None].repeat(episodes.act[0].shape[1], axis=1),
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
        action_units.first_choice(SPECS[env]) if SPECS[env].discrete else 0,
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


def described(found: Found, spec: EnvSpec) -> list[str]:
    """Return what there is to know of it, a line each."""
    episodes, units = found.episodes, found.units
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
    if units and spec.discrete:
        lines.append(f"choices     {units.first} to {units.first + spec.act_size - 1} there, {units.why}")
    elif units:
        lines.append(f"bounds      {units} there, {units.why}")
    width = max(len(str(quantity)) for quantity in (*spec.obs_names, *spec.act_names))
    act = np.concatenate(episodes.act)
    there = units.native(act) if units and not spec.discrete else None
    for kind, names, values in (
        ("observed", spec.obs_names, np.concatenate(episodes.obs)),
        ("actions", spec.act_names, act),
    ):
        for i, (name, column) in enumerate(zip(names, values.T, strict=True)):
            spread = f"{_range(column)}, mean {column.mean():.3g}"
            if kind == "actions" and there is not None:
                spread = f"{_range(there[:, i])} there, {spread} in [-1, 1]"
            lines.append(f"{kind:<12}{name!s:<{width}}  {spread}")
    if found.returns is None:
        lines.append("returns     not told")
    else:
        lines += [
            f"returns     {as_text(found.returns.mean(), '.2f')} on average",
            *_histogram(found.returns),
        ]
    return lines


def _range(values: Array) -> str:
    return f"{values.min():.3g} to {values.max():.3g}"


def _histogram(values: Array) -> list[str]:
    if np.ptp(values) <= SLACK * np.abs(values).max():
        return []
    counts, edges = np.histogram(values, BINS)
    scale = 40 / counts.max()
    spans = [f"{as_text(a, '10.2f')} to {as_text(b, '10.2f')}" for a, b in pairwise(edges)]
    bars = [f"{'#' * round(count * scale)}{' ' * bool(count)}{count or ''}" for count in counts]
    return [f"  {span} {bar}".rstrip() for span, bar in zip(spans, bars, strict=True)]


def _found(raw: forms.Raw, spec: EnvSpec, bounds: forms.Bounds | None) -> Found:
    lengths = [len(rows) for rows in raw.act]
    if longest := [i for i, length in enumerate(lengths) if length > spec.horizon]:
        raise ValueError(
            f"episode {longest[0]} has {lengths[longest[0]]} steps, and the horizon is {spec.horizon}"
        )
    if short := [i for i, rows in enumerate(raw.obs) if 0 < len(rows) == lengths[i]]:
        raise ValueError(
            f"episode {short[0]} has {lengths[short[0]]} observations and as many actions; {forms.ONE_MORE}"
        )
    obs = [_numbers(rows, spec.obs_size, "observations", i) for i, rows in enumerate(raw.obs)]
    units = action_units.units(raw, spec, bounds)
    act = _actions(raw.act, spec, units)
    _check_possible(obs, spec)
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
    episodes = Episodes(tuple(obs), tuple(act), terminated)
    return Found(episodes, rewards, raw.form, sum(guessed), cut_short, units)


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


def _actions(there: Sequence[NDArray[Any]], spec: EnvSpec, units: Units) -> list[Array]:
    """Return actions of the file, an array (T, A) an episode, as `Episodes` has them."""
    if spec.discrete:
        return [_choices(rows, spec, units.first, i) for i, rows in enumerate(there)]
    act = [_numbers(rows, spec.act_size, "actions", i) for i, rows in enumerate(there)]
    excess = np.concatenate([units.excess(rows) for rows in there])
    if outside := int((excess > 0).any(axis=1).sum()):
        most, entry = excess.max(), excess.max(axis=0).argmax()
        raise ValueError(
            f"{outside} of {len(excess)} actions ({100 * outside / len(excess):.2g} %) are outside of "
            f"{units}, by {most:.6g} at most, in {spec.act_names[entry].name}; if the environment clipped "
            f"them, clip them in the file, and only if all are in other units, give {action_units.OPTION}"
        )
    return [units.scaled(rows) for rows in act]


def _choices(rows: NDArray[Any], spec: EnvSpec, first: int, episode: int) -> Array:
    if rows.ndim == 1:
        last = first + spec.act_size - 1
        if rows.dtype.kind not in "iu" or not (len(rows) and first <= rows.min() <= rows.max() <= last):
            raise ValueError(f"episode {episode}: choices must be whole numbers from {first} to {last}")
        return np.asarray(np.eye(spec.act_size)[rows.astype(np.int64) - first])
    act = _numbers(rows, spec.act_size, "actions", episode)
    if not (((act == 0) | (act == 1)).all() and (act.sum(axis=1) == 1).all()):
        raise ValueError(f"episode {episode} has actions that are no choice: one 1 among 0s is needed")
    return act
