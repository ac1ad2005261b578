"""The forms of files of demonstrations, all read into a `Recording`, and one file here for each owner.

No pickle is read, nor the column `infos` of `imitation`, whose texts stand for any Python object.
"""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

from harness.demonstrations.forms import hdf5, imitation, lerobot, minari, npz, steps
from harness.demonstrations.forms.content import opened
from harness.demonstrations.recording import Reading, Recording

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
