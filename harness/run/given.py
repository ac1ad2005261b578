"""Demonstrations that were given in a file, kept in the cache by their content, as cells are shown them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from harness.judge.results import Shown
from harness.learn.seeds import rng_for
from harness.registry import BadInput
from harness.run.environment import cache_folder
from harness.store.cache import Kept, as_bytes, load
from harness.store.files import write_atomic
from methods.base import Array, Episodes


def keep(said: str, episodes: Episodes, rewards: Sequence[Array] | None) -> None:
    """Keeps them, and their rewards, (T,) each, where those are known. said: what `Conditions.demonstrations`
    says of them, their digest first. Raises BadInput where the cache cannot be written to."""
    found = _as_kept(episodes)
    if rewards is not None:
        found.arrays["rewards"] = np.concatenate(rewards)
    file = file_of(said)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, as_bytes(found))
    except OSError as error:
        raise BadInput(f"the cache {file.parent} cannot be written to: {error.strerror}") from error


def source_of(said: str) -> str:
    """What the column `expert` says of them."""
    return f"file:{said.partition(':')[0]}"


def file_of(said: str) -> Path:
    """Where they are kept."""
    return cache_folder() / f"given_{hashlib.sha256(said.encode()).hexdigest()[:16]}.safetensors"


def rewards(said: str) -> list[Array]:
    """Of all of them, (T,) each. Raises ValueError where they are gone from the cache."""
    arrays = _arrays(said)
    return np.split(arrays["rewards"], np.cumsum(arrays["lengths"])[:-1])


def shown(said: str, env: str, seed: int, asked: Shown) -> Kept:
    """What is shown of them to every method: as many episodes as are asked for, drawn by the run's seed, or
    all. Raises ValueError where there are not so many, or they are gone from the cache."""
    arrays = _arrays(said)
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


def _arrays(said: str) -> dict[str, Any]:
    found = load(file_of(said))
    if found is None:
        raise ValueError("the demonstrations are gone from the cache; give --demos-from again")
    return found.arrays


def _as_kept(episodes: Episodes) -> Kept:
    arrays: dict[str, Any] = {"obs": np.concatenate(episodes.obs), "act": np.concatenate(episodes.act)}
    arrays |= {"lengths": episodes.lengths, "terminated": np.array(episodes.terminated)}
    if episodes.times is not None:
        arrays |= {"times": np.concatenate(episodes.times), "shown": np.array([*map(len, episodes.times)])}
    return Kept(arrays, {})
