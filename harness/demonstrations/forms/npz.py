"""Archives `.npz`: this project's, those of `imitation` before 1.0, and D4RL's and il-datasets' columns
(`harness.demonstrations.forms.steps`).

This project's have the arrays of `harness.demonstrations.arrays`, actions in [-1, 1] or choices, and
optionally act_bounds (2, A), the lowest and highest actions of the file. Without act, actions are not known.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.forms import steps
from harness.demonstrations.forms.content import without_keys
from harness.demonstrations.recording import OWN_FORM, Reading, Recording, completed

OWN = {"obs": "obs", "lengths": "lengths", "terminated": "terminated", "act": "act", "rewards": "rewards"}
OTHER = {"obs": "obs", "act": "acts", "lengths": "indices", "terminated": "terminal", "rewards": "rews"}
"""Arrays of this project and of `imitation`."""
ACT_BOUNDS = "act_bounds"


def read(file: BinaryIO, how: Reading) -> Recording:
    """Return the episodes of an archive."""
    archive = np.load(file)
    names = {*archive.files}
    for columns, of_steps in ((steps.D4RL, steps.of_d4rl), (steps.IL_DATASETS, steps.of_il_datasets)):
        if {columns[0], columns[3]} <= names:
            return of_steps({name: _array(archive, name) for name in columns if name in names}, how)
    layout = next((one for one, least in ((OWN, 3), (OTHER, 4)) if {*[*one.values()][:least]} <= names), None)
    if layout is None:
        raise ValueError(f"it has none of the sets of arrays that are known, but {sorted(names)}")
    form = OWN_FORM if layout is OWN else "imitation's npz"
    without_keys(form, how)
    arrays = {name: _array(archive, there) for name, there in layout.items() if there in names}
    if layout is OTHER:
        arrays["lengths"] = np.diff(arrays["lengths"], prepend=0, append=len(arrays["act"]))
    elif "act" not in arrays:
        arrays["act"] = np.zeros((len(arrays["obs"]) - arrays["lengths"].size, 0))
    bounds = archive[ACT_BOUNDS] if layout is OWN and ACT_BOUNDS in names else None
    return Recording(form, completed(arrays, how.last_observation), bounds)


def _array(archive: Any, name: str) -> NDArray[Any]:
    try:
        return np.asarray(archive[name])
    except ValueError as error:  # such as for Python objects, which lists of several lengths become
        raise ValueError(f"its {name} cannot be read: {error}; rows of one length are needed") from error
