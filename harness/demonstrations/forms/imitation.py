"""Folders of Hugging Face's `datasets`, Arrow streams that state.json names.

They hold trajectories of `imitation` 1.0, or steps of il-datasets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from harness.demonstrations.forms import steps
from harness.demonstrations.forms.content import described, rows, table, without_keys
from harness.demonstrations.recording import Episode, Reading, Recording, completed, joined

STATE = "state.json"


class State(msgspec.Struct):
    """The state.json of a dataset."""

    data_files: list[dict[str, str]] = msgspec.field(name="_data_files")
    indices: list[Any] | None = msgspec.field(name="_indices_data_files", default=None)


def read(path: Path, how: Reading) -> Recording:
    """Return the episodes of a folder."""
    state = described(path / STATE, State)
    if state.indices:
        raise ValueError("it shows a selection of its rows; save it after `flatten_indices()`")
    names = [entry["filename"] for entry in state.data_files]
    if any(Path(name).name != name for name in names):
        raise ValueError(f"its {STATE} names files that do not lie beside it")
    tables = [table(path / name, "stream") for name in names]
    if tables and all(steps.IL_DATASETS[3] in content.column_names for content in tables):
        return steps.of_tables(tables, how)
    without_keys("imitation", how)
    episodes = []
    for content in tables:
        for i in range(content.num_rows):
            obs, act = (rows(content[column][i].values) for column in ("obs", "acts"))
            rewards = rows(content["rews"][i].values) if "rews" in content.column_names else None
            episodes.append(Episode(obs, act, content["terminal"][i].as_py(), rewards))
    return Recording("imitation", completed(joined(episodes), how.last_observation))
