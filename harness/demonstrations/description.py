"""A description of demonstrations, for `demos inspect`."""

from __future__ import annotations

import numpy as np

from envs import EnvSpec
from harness.demonstrations.reading import Demonstrations
from harness.judge.numbers import as_text
from methods.base import Array


def described(found: Demonstrations, spec: EnvSpec) -> list[str]:
    """Return what is known of a file's demonstrations, a line each."""
    episodes, lengths = found.episodes, found.episodes.lengths
    lines = [
        f"form        {found.form}",
        f"content     {found.digest}",
        f"episodes    {len(episodes)}, of which {sum(episodes.terminated)} terminated",
        f"steps       {lengths.sum()}; {lengths.min()} to {lengths.max()} an episode",
    ]
    if found.cut:
        lines.append(f"endings     {found.cut} neither terminated nor last until the horizon")
    if found.guessed:
        lines.append(f"endings     {found.guessed} called terminal at the horizon are taken for cut there")
    return [*lines, *_columns(found, spec), _returns(found.returns)]


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
    for i, (name, column) in enumerate(zip(spec.actions, act.T, strict=True)):
        spread = f"{_range(column)}, mean {column.mean():.3g}"
        if native is not None:
            spread = f"{_range(native[:, i])} there, {spread} in [-1, 1]"
        lines.append(f"actions     {name!s:<{width}}  {spread}")
    return lines


def _range(values: Array) -> str:
    return f"{values.min():.3g} to {values.max():.3g}"


def _returns(returns: Array | None) -> str:
    if returns is None:
        return "returns     not told"
    low, mean, high = (as_text(value, ".2f") for value in (returns.min(), returns.mean(), returns.max()))
    return f"returns     {mean} on average, {low} to {high}"
