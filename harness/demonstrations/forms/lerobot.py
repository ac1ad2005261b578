"""Folders of LeRobot's datasets 2.0 to 3.0: meta/info.json, and a row for each step in data/chunk-*.

The columns are observation.state or others, action, episode_index and frame_index, and optionally next.reward
and next.done. Images and videos are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from harness.demonstrations.forms import steps
from harness.demonstrations.forms.content import beside, described, observed, rows, table
from harness.demonstrations.recording import Reading, Recording

INFO = "meta/info.json"
OBSERVATION = "observation."
NUMBERS = ("float", "int", "bool")


class Feature(msgspec.Struct):
    """A column. `shape`: of its value in a step."""

    dtype: str
    shape: list[int]


class Info(msgspec.Struct):
    """The meta/info.json. `total_frames`: number of steps."""

    features: dict[str, Feature]
    total_frames: int


def read(path: Path, how: Reading) -> Recording:
    """Return the episodes of a folder."""
    info = described(path / INFO, Info)
    flat = {
        name: feature.shape[0]
        for name, feature in info.features.items()
        if name.startswith(OBSERVATION) and len(feature.shape) == 1 and feature.dtype.startswith(NUMBERS)
    }
    keys = observed(flat, how)
    names = [*keys, "action", "episode_index", "frame_index", "next.reward", "next.done"]
    tables = [table(file, "parquet") for file in sorted(path.glob("data/chunk-*/*.parquet"))]
    columns: dict[str, Any] = {
        name: np.concatenate([rows(one[name].combine_chunks()) for one in tables])
        for name in names
        if tables and name in info.features
    }
    frames = columns.get("frame_index", np.zeros(0))
    if len(frames) != info.total_frames or not len(frames):
        raise ValueError(f"its {INFO} tells of {info.total_frames} steps, and its files have {len(frames)}")
    starts = np.flatnonzero(np.diff(columns["episode_index"], prepend=-1))
    counts = np.diff(np.append(starts, len(frames)))
    if (frames != np.arange(len(frames)) - starts.repeat(counts)).any():
        raise ValueError("its steps are not numbered from 0 on in each episode")
    known = {
        ours: columns[its]
        for ours, its in (("actions", "action"), ("rewards", "next.reward"))
        if its in columns
    }
    done = columns.get("next.done", np.zeros(len(frames))).reshape(len(frames)).astype(bool)
    return steps.recording("LeRobot", beside([columns[key] for key in keys]), known, starts[1:], done, how)
