"""Episodes as arrays for storage: in files, in the cache and between processes.

N episodes of T steps stand one after the other: obs (sum of T+1, O), act (sum of T, A), lengths (N,),
terminated (N,). Rewards (sum of T,) are there where they are known. Where only some steps are shown, obs and
act hold these alone, `shown` (N,) counts them, and `times` (sum of shown,) numbers them within their
episodes. `preferences` (P, 2) are as of `methods.base.Episodes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from methods.base import Array, Episodes


def to_arrays(episodes: Episodes, rewards: Sequence[Array] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of episodes, and of their rewards, (T,) each, where these are known."""
    arrays: dict[str, NDArray[Any]] = {
        "obs": np.concatenate(episodes.obs),
        "act": np.concatenate(episodes.act),
        "lengths": episodes.lengths,
        "terminated": np.array(episodes.terminated),
    }
    if episodes.times is not None:
        arrays["times"] = np.concatenate(episodes.times)
        arrays["shown"] = np.array([len(times) for times in episodes.times])
    if episodes.preferences is not None:
        arrays["preferences"] = episodes.preferences
    if rewards is not None:
        arrays["rewards"] = np.concatenate(rewards)
    return arrays


def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> Episodes:
    """Return the episodes of such arrays. Raises ValueError as `Episodes` does."""
    lengths = arrays["lengths"]
    shown, times = arrays.get("shown", lengths), arrays.get("times")
    return Episodes(
        split(arrays["obs"], shown + (times is None)),
        split(arrays["act"], shown),
        tuple(bool(flag) for flag in arrays["terminated"]),
        None if times is None else split(times, shown),
        tuple(int(length) for length in lengths),
        arrays.get("preferences"),
    )


def split(rows: NDArray[Any], counts: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return the rows of each episode. counts: (N,) how many each has."""
    return tuple(np.split(rows, np.cumsum(counts)[:-1]))
