"""Preferences between demonstrations: pairs of episodes' numbers (P, 2), the better one last."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.registry import BadInput
from harness.store.codec import printable
from harness.store.files import read
from methods.base import Episodes

MOST = 50_000
"""Most preferences that are made of returns, but for rounding."""
COLUMNS = ["first", "second", "better"]


def by_returns(returns: Sequence[float] | NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the preferences of higher returns (N,), for all pairs, or for about `MOST` at even distances in
    their order. Episodes with equal returns make no pair."""
    values = np.asarray(returns)
    order, count = np.argsort(values, kind="stable"), len(values)
    distances = range(1, count, max(1, count**2 // (2 * MOST)))
    pairs = [np.column_stack([order[:-distance], order[distance:]]) for distance in distances]
    every = np.concatenate([np.zeros((0, 2), np.int64), *pairs])
    return np.asarray(every[values[every[:, 0]] < values[every[:, 1]]])


def in_file(path: Path, episodes: int) -> NDArray[np.int64]:
    """Return the preferences of a CSV file with the columns first, second and better: numbers of episodes,
    from 0. Raises BadInput for any other file, and for numbers of no episode."""
    import pandas as pd

    try:
        table = pd.read_csv(io.BytesIO(read(path)))
        first, second, better = (table[name].to_numpy() for name in COLUMNS)
    except Exception as error:  # whatever pandas raises
        why = printable(" ".join(str(error).split()))[:200]
        needed = f"{path}: the columns {', '.join(COLUMNS)} are needed: {why}"
        raise BadInput(needed, "demonstrations") from error
    numbers = np.column_stack([first, second])
    known = numbers.dtype.kind in "iu" and ((numbers >= 0) & (numbers < episodes)).all()
    if not (known and (first != second).all() and (numbers == better[:, None]).any(axis=1).all()):
        raise BadInput(
            f"{path}: each row needs two numbers of episodes, 0 to {episodes - 1}, and the better one again",
            "demonstrations",
        )
    return np.column_stack([np.where(first == better, second, first), better]).astype(np.int64)


def chosen(episodes: Episodes, numbers: NDArray[np.int64]) -> Episodes:
    """Return the episodes of these numbers, whose every step is shown, with the preferences among them."""
    obs, act = (tuple(column[i] for i in numbers) for column in (episodes.obs, episodes.act))
    some = Episodes(obs, act, tuple(episodes.terminated[i] for i in numbers))
    if episodes.preferences is None:
        return some
    places = np.full(len(episodes), -1)
    places[numbers] = np.arange(len(numbers))
    pairs = places[episodes.preferences]
    return replace(some, preferences=pairs[(pairs >= 0).all(axis=1)])
