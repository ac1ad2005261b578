"""A recording: episodes as a file holds them, and how much a file may hold."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.registry import BadInput
from harness.run.files import opened

LARGEST = 1 << 30
"""Bytes of a file, and of its numbers at 8 bytes each, at most."""
MOST_EPISODES = 100_000
FLAT = "flat rows of numbers are needed"
Bounds = NDArray[np.float64]
"""Lowest and highest actions: (2, A), or (2, 1) where all components have the same."""


@dataclass(frozen=True)
class Recording:
    """Episodes as a file holds them, for whatever task.

    `form`: name of the file's form. `arrays`: as of `harness.demonstrations.arrays`, with the file's types
    and units; choices may be whole numbers (sum of T,). `bounds`: None where an `.npz` has none, infinite
    where another form lacks them. `first`: number of the first choice, if the file says it. `unended`:
    episodes that neither terminated nor were cut. Raises ValueError for arrays of different episodes.
    """

    form: str
    arrays: dict[str, NDArray[Any]]
    bounds: Bounds | None = None
    first: int | None = None
    unended: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name, array in self.arrays.items():
            if array.dtype.kind not in "fiub" or array.ndim == 0:
                raise ValueError(f"its {name} is {array.dtype} {array.shape}; numbers are needed")
        check_size(sum(array.size * max(1, array.itemsize // 8) for array in self.arrays.values()))
        lengths, steps = self.arrays["lengths"], len(self.arrays["act"])
        if not 0 < len(lengths) <= MOST_EPISODES or self.arrays["terminated"].shape != lengths.shape:
            raise ValueError("its lengths and endings do not list the same episodes")
        if lengths.min() < 1 or lengths.max() > steps or lengths.sum() != steps:
            raise ValueError(f"its {steps} actions are not those of its episodes, each of a step or more")
        rows = {name: len(array) for name, array in self.arrays.items()}
        if rows["obs"] != steps + len(lengths):
            hint = f"; {ONE_MORE}" if rows["obs"] == steps else ""
            raise ValueError(f"it has {rows['obs']} observations for {steps} actions{hint}")
        if rows.get("rewards", steps) != steps or self.arrays.get("rewards", lengths).ndim != 1:
            raise ValueError(f"it has rewards {self.arrays['rewards'].shape} for {steps} steps")

    @property
    def calls_all_ends_terminal(self) -> bool:
        """True where an end at the horizon may be called terminal, though it was cut there."""
        return self.form.startswith("imitation")


ONE_MORE = "an episode has one observation more than actions, of where its last one led"


def check_size(numbers: int) -> None:
    """Raise ValueError for more numbers than are read."""
    if 8 * numbers > LARGEST:
        raise ValueError(f"it holds more than {LARGEST >> 20} MiB")


def check_observed(observed: Sequence[int], lengths: Sequence[int]) -> None:
    """Raise ValueError for an episode that has not one observation more than actions."""
    for i, (rows, steps) in enumerate(zip(observed, lengths, strict=True)):
        if rows != steps + 1:
            hint = f" and as many actions; {ONE_MORE}" if rows == steps else f" for {steps} actions"
            raise ValueError(f"episode {i} has {rows} observations{hint}")


def endings(flags: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (N,) flags as booleans. Raises ValueError for any but true, false, 0 and 1."""
    if odd := [flag for flag in flags.tolist() if flag not in (0, 1)]:
        raise ValueError(f"its endings must be true or false, not {odd[0]!r:.40}")
    return flags.astype(bool)


def checked_bounds(low: NDArray[Any], high: NDArray[Any], where: str) -> Bounds:
    """Return bounds (2, A). Raises ValueError where a low one is above its high one, or not a number."""
    if low.shape != high.shape:
        raise ValueError(f"{where} has {low.size} low bounds and {high.size} high ones")
    if not (low <= high).all():
        raise ValueError(f"{where} has a low bound that is not below the high one")
    return np.array([low, high], np.float64)


@contextmanager
def opened_to_read(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file. Raises OSError for a link or a pipe, and ValueError for more than is read."""
    with opened(path) as file:
        if os.fstat(file.fileno()).st_size > LARGEST:
            raise ValueError(f"{path.name}: it is larger than {LARGEST >> 20} MiB")
        yield file


def extra(module: str) -> Any:
    """Return a module that the extra `minari` installs. Raises BadInput where it cannot be imported."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        reason = f"{module} cannot be imported: pip install 'irl-bench[minari]'"
        raise BadInput(reason, page="demonstrations") from error
