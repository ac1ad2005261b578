"""A folder of `imitation` 1.0: a dataset of Hugging Face's `datasets`, Arrow streams that state.json names.

Its column `infos`, texts that stand for any Python object, is not looked at.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.recording import MOST_EPISODES, Recording, check_observed, endings
from harness.run.files import read as content

STATE = "state.json"


def read(path: Path) -> Recording:
    """Return what such a folder holds. Raises ValueError for anything else."""
    parts = [part for name in _names(path) if len((part := _part(path / name))["lengths"])]
    if not parts:
        raise ValueError("it holds no episode")
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return Recording("imitation", {name: np.concatenate([part[name] for part in parts]) for name in names})


def _names(path: Path) -> list[str]:
    """Return the names of the files that state.json lists."""
    try:
        state = json.loads(content(path / STATE))
        names = [entry["filename"] for entry in state["_data_files"]]
        selection = state.get("_indices_data_files")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError("its state.json does not list files of data, as that of a dataset does") from error
    if selection:
        raise ValueError("it shows a selection of its rows; save it after `flatten_indices()`")
    plain = all(isinstance(name, str) and Path(name).name == name for name in names)
    if not 0 < len(names) <= MOST_EPISODES or not plain:
        raise ValueError("its state.json names no files beside it, or too many")
    return names


def _part(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a file's episodes, as of `harness.demonstrations.arrays`."""
    from harness.demonstrations import arrow  # which an .npz is read without

    columns = arrow.table(path, "stream", ("obs", "acts", "terminal", "rews"))
    obs, observed = arrow.lists(arrow.column(columns, "obs"), f"{path.name} has obs")
    act, lengths = arrow.lists(arrow.column(columns, "acts"), f"{path.name} has acts")
    check_observed(observed.tolist(), lengths.tolist())
    terminal = arrow.rows(arrow.column(columns, "terminal"), f"{path.name} has terminal")
    arrays = {
        "obs": arrow.rows(obs, f"{path.name} has obs"),
        "act": arrow.rows(act, f"{path.name} has acts"),
        "lengths": lengths,
        "terminated": endings(terminal),
    }
    if "rews" in columns.column_names:
        paid, counts = arrow.lists(arrow.column(columns, "rews"), f"{path.name} has rews")
        if not np.array_equal(counts, lengths):
            raise ValueError("an episode has not as many rewards as steps")
        arrays["rewards"] = arrow.rows(paid, f"{path.name} has rews")
    return arrays
