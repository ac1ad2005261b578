"""The forms of files of demonstrations, all read into a `Recording`, and one file here for each owner.

No pickle is read, nor the column `infos` of `imitation`, whose texts stand for any Python object.
"""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import NamedTuple

from harness.demonstrations.forms import hdf5, imitation, lerobot, minari, npz, steps
from harness.demonstrations.forms.content import opened
from harness.demonstrations.recording import Reading, Recording


class Form(NamedTuple):
    """A form in words: how its files are recognised, where episodes end, and the bounds of actions."""

    name: str
    recognised: str
    endings: str
    bounds: str


TASKS = "those of the task's environment, beneath wrappers that scale"
LISTED = (
    Form(
        "this project's `.npz`",
        "arrays `obs`, `lengths`, `terminated`, and optionally `act`, `rewards` and `act_bounds`",
        "as the file says",
        "its `act_bounds`, or [-1, 1] where it has none",
    ),
    Form(
        "`.npz` of `imitation` before 1.0",
        "arrays `obs`, `acts`, `indices`, `terminal`",
        "an episode as long as the horizon counts as cut there",
        TASKS,
    ),
    Form(
        "a folder of `imitation` 1.0",
        f"`{imitation.STATE}` and Arrow streams",
        "the same: it calls every end terminal",
        TASKS,
    ),
    Form(
        "a dataset of Minari 0.5, or the folder `data` in it",
        f"`data/{minari.METADATA}`, and `main_data.hdf5`, parquet or arrow",
        "as the file says; one that neither terminated nor was truncated must be as long as the horizon",
        "those of its `action_space`; they must be the task's, or [-1, 1]",
    ),
    Form(
        "D4RL's HDF5, or an `.npz` of such arrays",
        "`observations`, `terminals`, and optionally `actions`, `rewards`, `timeouts`, `next_observations`",
        "at each terminal and timeout",
        TASKS,
    ),
    Form(
        "robomimic's HDF5",
        "groups `data/demo_0` and so on of `obs`, and optionally `actions`, `rewards`, `dones`, `next_obs`",
        "by the last of `dones`; an episode as long as the horizon counts as cut there",
        TASKS,
    ),
    Form(
        "a folder of LeRobot 2.0 to 3.0",
        f"`{lerobot.INFO}`, and parquet in `data/chunk-000` and so on",
        "by the last `next.done`; an episode as long as the horizon counts as cut there",
        TASKS,
    ),
    Form(
        "`.npz`, `.jsonl` or folder of il-datasets",
        "`obs`, `episode_starts`, and optionally `actions` and `rewards`",
        "every end is terminal, but one at the horizon",
        TASKS,
    ),
)
"""Every form, in the documentation's words."""
MAGIC = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file."""


def read(path: Path, how: Reading) -> Recording:
    """Return what a file or folder holds. Raises whatever libraries do for anything else, BadInput where
    an extra is missing."""
    if path.is_dir():
        return _folder(path, how)
    with opened(path) as file:
        start = file.read(len(MAGIC))
        file.seek(0)
        if start == MAGIC:
            return hdf5.read(file, how)
        if zipfile.is_zipfile(file):
            return npz.read(file, how)
    if path.suffix == ".jsonl":
        return steps.of_lines(path, how)
    raise ValueError("it is no .npz, HDF5 or .jsonl file; pickles are not read")


def _folder(path: Path, how: Reading) -> Recording:
    if os.path.lexists(path / imitation.STATE):
        return imitation.read(path, how)
    if os.path.lexists(path / lerobot.INFO):
        return lerobot.read(path, how)
    data = path / "data" if os.path.lexists(path / "data") else path
    if os.path.lexists(data / minari.METADATA):
        return minari.read(data, how)
    raise ValueError(
        f"it holds neither the {imitation.STATE} of imitation, the data/{minari.METADATA} of Minari, nor the "
        f"{lerobot.INFO} of LeRobot"
    )
