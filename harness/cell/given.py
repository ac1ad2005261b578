"""Demonstrations of a file, stored in the cache by their content for the cells of a run."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from harness.demonstrations.arrays import to_arrays
from harness.process.environment import cache_folder
from harness.registry import BadInput
from harness.store.cache import Kept, as_bytes, load
from harness.store.files import write_atomic
from methods.base import Array, Episodes


def store(summary: str, episodes: Episodes, rewards: Sequence[Array] | None) -> None:
    """Store episodes, and their rewards, (T,) each, where these are known.

    summary: `Conditions.demonstrations`, their digest first. Raises BadInput where the cache cannot be
    written to.
    """
    file = file_of(summary)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, as_bytes(Kept(to_arrays(episodes, rewards), {})))
    except OSError as error:
        raise BadInput(f"the cache {file.parent} cannot be written to: {error.strerror}") from error


def stored(summary: str) -> dict[str, NDArray[Any]]:
    """Return their arrays (`harness.demonstrations.arrays`). Raises ValueError where they are gone."""
    if (content := load(file_of(summary))) is None:
        raise ValueError("the demonstrations are gone from the cache; give --demos-from again")
    return content.arrays


def file_of(summary: str) -> Path:
    """Return where they are stored."""
    return cache_folder() / f"given_{hashlib.sha256(summary.encode()).hexdigest()[:16]}.safetensors"
