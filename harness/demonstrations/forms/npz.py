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
COLUMNS = {"D4RL's": (steps.D4RL, steps.of_d4rl), "il-datasets'": (steps.IL_DATASETS, steps.of_il_datasets)}
"""Forms with a row for each step, and their readers."""
NEEDED = {
    "D4RL's": {"observations", "terminals"},
    "il-datasets'": {"obs", "episode_starts"},
    "this project's": {"obs", "lengths", "terminated"},
    "imitation's": {"obs", "acts", "indices", "terminal"},
}
"""Arrays that a form has at least."""
ACT_BOUNDS = "act_bounds"


def read(file: BinaryIO, how: Reading) -> Recording:
    """Return the episodes of an archive."""
    archive = np.load(file)
    names = {*archive.files}
    lacking = {form: sorted(needed - names) for form, needed in NEEDED.items()}
    if (form := next((form for form, lacks in lacking.items() if not lacks), None)) is None:
        missing = "; ".join(f"{', '.join(lacks)} for {form} form" for form, lacks in lacking.items())
        raise ValueError(f"it has {', '.join(sorted(names)) or 'no arrays'}, and lacks {missing}")
    if form in COLUMNS:
        columns, of_steps = COLUMNS[form]
        return of_steps({name: _array(archive, name) for name in columns if name in names}, how)
    layout, form = (OWN, OWN_FORM) if form == "this project's" else (OTHER, "imitation's npz")
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
