"""A description of demonstrations, for `demos inspect`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.demonstrations.reading import Demonstrations
from harness.demonstrations.recording import Recording
from harness.demonstrations.units import as_pairs
from harness.judge.numbers import as_text
from methods.base import Array


def described(found: Demonstrations, spec: EnvSpec) -> list[str]:
    """Return what is known of a file's demonstrations, a line each."""
    episodes = found.episodes
    lines = [
        f"form        {found.form}",
        f"content     {found.digest}",
        *_counts(episodes.lengths, sum(episodes.terminated)),
    ]
    if found.cut:
        lines.append(f"endings     {found.cut} neither terminated nor last until the horizon")
    if found.guessed:
        lines.append(f"endings     {found.guessed} called terminal at the horizon are taken for cut there")
    if found.clipped:
        lines.append(f"clipped     {found.clipped} actions, outside of their bounds by rounding")
    return [*lines, *_columns(found, spec), _returns(found.returns)]


def described_without_task(recording: Recording) -> list[str]:
    """Return what is known of a file for whatever task, a line each, with its entries by their numbers."""
    arrays = recording.arrays
    lines = [f"form        {recording.form}", *_counts(arrays["lengths"], int(arrays["terminated"].sum()))]
    if recording.bounds is not None:
        lines.append(f"bounds      {as_pairs(recording.bounds)}, as the file says")
    for name, rows in (("observed", arrays["obs"]), ("actions", arrays["act"])):
        columns = rows.reshape(len(rows), -1).T
        lines += [
            f"{name:<12}{i:<3}  {_range(column)}, mean {column.mean():.3g}"
            for i, column in enumerate(columns)
        ]
    returns = None
    if "rewards" in arrays:
        starts = np.cumsum(arrays["lengths"]) - arrays["lengths"]
        returns = np.add.reduceat(arrays["rewards"].astype(np.float64), starts.astype(np.int64))
    return [*lines, _returns(returns)]


def _counts(lengths: NDArray[Any], terminated: int) -> list[str]:
    return [
        f"episodes    {len(lengths)}, of which {terminated} terminated",
        f"steps       {lengths.sum()}; {lengths.min()} to {lengths.max()} an episode",
    ]


def _columns(found: Demonstrations, spec: EnvSpec) -> list[str]:
    """Return the units of actions, and the range of each entry of observations and actions."""
    units, lines, native = found.units, list[str](), None
    obs, act = np.concatenate(found.episodes.obs), np.concatenate(found.episodes.act)
    if units and spec.discrete:
        lines = [f"choices     {units.first} to {units.first + spec.act_size - 1} there, {units.why}"]
    elif units:
        lines, native = [f"bounds      {units} there, {units.why}"], units.native(act)
    width = max(len(str(quantity)) for quantity in (*spec.observations, *spec.actions))
    for name, column in zip(spec.observations, obs.T, strict=True):
        lines.append(f"observed    {name!s:<{width}}  {_range(column)}, mean {column.mean():.3g}")
    if not found.episodes.has_actions:
        lines.append("actions     none")
    for i, (name, column) in enumerate(zip(spec.actions, act.T, strict=False)):
        spread = f"{_range(column)}, mean {column.mean():.3g}"
        if native is not None:
            spread = f"{_range(native[:, i])} there, {spread} in [-1, 1]"
        lines.append(f"actions     {name!s:<{width}}  {spread}")
    return lines


def _range(values: NDArray[Any]) -> str:
    return f"{values.min():.3g} to {values.max():.3g}"


def _returns(returns: Array | None) -> str:
    if returns is None:
        return "returns     not told"
    low, mean, high = (as_text(value, ".2f") for value in (returns.min(), returns.mean(), returns.max()))
    return f"returns     {mean} on average, {low} to {high}"
