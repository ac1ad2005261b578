"""Datasets of Minari 0.5: metadata.json, and episodes in main_data.hdf5, or in <number>/part-0.parquet or
.arrow. Where observations have parts, these are chosen by key, with / between the keys of nested ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.forms import hdf5
from harness.demonstrations.forms.content import beside, checked, described, observed, opened, rows, table
from harness.demonstrations.recording import Episode, Reading, Recording, extra, joined

METADATA = "metadata.json"
STEPS = ("actions", "rewards", "terminations", "truncations")
"""Columns of each step; observations have one row more."""


class Metadata(msgspec.Struct):
    """The metadata.json. `action_space`: JSON in a text."""

    data_format: Literal["hdf5", "parquet", "arrow"]
    total_episodes: Annotated[int, msgspec.Meta(ge=1)]
    total_steps: int | None = None
    action_space: str = '{"type": "Box"}'
    observation_space: str = '{"type": "Box"}'


class Space(msgspec.Struct):
    """A space of actions in Minari's JSON. `start`, `low`, `high`: nested lists of numbers."""

    type: Literal["Box", "Discrete", "MultiDiscrete", "MultiBinary"]
    start: Any = 0
    low: Any = -math.inf
    high: Any = math.inf


class Observed(msgspec.Struct):
    """A space of observations in Minari's JSON. `start`, `n`: whole numbers where it is 'Discrete'."""

    type: str
    start: Any = 0
    n: Any = 0


def read(data: Path, how: Reading) -> Recording:
    """Return the episodes of a folder `data`."""
    facts = described(data / METADATA, Metadata)
    episodes, unended = list[Episode](), list[int]()
    columns = (_hdf5 if facts.data_format == "hdf5" else _tables)(data, facts, how)
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
    space, bounds = checked(facts.action_space, Space), None
    if space.type == "Box":
        low, high = (np.array(end, np.float64).ravel() for end in (space.low, space.high))
        bounds = np.array([low, high])
    starts = np.ravel(space.start)  # combinations are numbered from 0 on
    first = (int(starts[0]) if len(starts) == 1 else 0) if bounds is None else None
    seen = checked(facts.observation_space, Observed)
    states = (int(seen.start), int(seen.n)) if seen.type == "Discrete" else None
    return Recording(f"Minari {facts.data_format}", arrays, bounds, first, tuple(unended), states)


def _tables(data: Path, facts: Metadata, how: Reading) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each episode, whose last row is of the last observation alone."""
    for i in range(facts.total_episodes):
        content = table(data / str(i) / f"part-0.{facts.data_format}", facts.data_format)
        steps = {name: rows(content[name].combine_chunks())[:-1] for name in STEPS}
        seen = content["observations"].combine_chunks()
        columns = dict(_parts(seen, ""))
        if "" in columns:
            yield steps | {"observations": columns[""]}
            continue
        widths = {key: one.size // max(1, len(one)) for key, one in columns.items()}
        yield steps | {"observations": beside([columns[key] for key in observed(widths, how)])}


def _parts(seen: Any, key: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the key and the rows of each part of an Arrow array, '' for one without parts."""
    from pyarrow import types

    if not types.is_struct(seen.type):
        yield key, rows(seen)
        return
    for field in seen.type:
        yield from _parts(seen.field(field.name), f"{key}/{field.name}".strip("/"))


def _hdf5(data: Path, facts: Metadata, how: Reading) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of each episode."""
    h5py = extra("h5py")
    with opened(data / "main_data.hdf5") as binary, h5py.File(binary, "r") as file:
        for i in range(facts.total_episodes):
            group = file[f"episode_{i}"]
            seen = group["observations"]
            if isinstance(seen, h5py.Group):
                obs = hdf5.columns(seen, observed(hdf5.widths(seen), how))
            else:
                obs = np.asarray(seen)
            yield {name: np.asarray(group[name]) for name in STEPS} | {"observations": obs}
