"""Demonstrations that were given in a file, kept in the cache by their content, as cells are shown them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from harness.judge.results import Shown
from harness.learn.seeds import rng_for
from harness.registry import BadInput
from harness.run.cache import Kept, as_bytes, load
from harness.run.environment import cache_folder
from harness.run.files import write_atomic
from methods.base import Episodes


def keep(said: str, episodes: Episodes) -> None:
    """Keeps them. said: what `Conditions.demonstrations` says of them, their digest first. Raises BadInput
    where the cache cannot be written to."""
    file = file_of(said)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, as_bytes(_as_kept(episodes)))
    except OSError as error:
        raise BadInput(f"the cache {file.parent} cannot be written to: {error.strerror}") from error


def file_of(said: str) -> Path:
    """Where they are kept."""
    return cache_folder() / f"given_{said.partition(':')[0]}.safetensors"


def shown(said: str, env: str, seed: int, asked: Shown) -> Kept:
    """What is shown of them to every method: as many episodes as are asked for, drawn by the run's seed, or
    all. Raises ValueError where there are not so many, or they are gone from the cache."""
    found = load(file_of(said))
    if found is None:
        raise ValueError("the demonstrations are gone from the cache; give --demos-from again")
    arrays = found.arrays
    ends = np.cumsum(arrays["lengths"])
    count = len(ends)
    if asked.demos > count:
        raise ValueError(f"{asked.demos} demonstrations are asked for, and there are {count}")
    chosen = np.arange(count)
    if asked.demos:
        chosen = np.sort(rng_for(seed, env, "demonstrations given").permutation(count)[: asked.demos])
    obs = np.split(arrays["obs"], (ends + np.arange(1, count + 1))[:-1])
    act = np.split(arrays["act"], ends[:-1])
    episodes = Episodes(
        tuple(obs[i].copy() for i in chosen),
        tuple(act[i].copy() for i in chosen),
        tuple(bool(arrays["terminated"][i]) for i in chosen),
    )
    return _as_kept(
        episodes.every(asked.every, rng_for(seed, env, "steps shown")) if asked.every > 1 else episodes
    )


def _as_kept(episodes: Episodes) -> Kept:
    arrays: dict[str, Any] = {"obs": np.concatenate(episodes.obs), "act": np.concatenate(episodes.act)}
    arrays |= {"lengths": episodes.lengths, "terminated": np.array(episodes.terminated)}
    if episodes.times is not None:
        arrays |= {"times": np.concatenate(episodes.times), "shown": np.array([*map(len, episodes.times)])}
    return Kept(arrays, {})
