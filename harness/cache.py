"""What is computed once and kept for other runs: arrays and a few facts, in a file whose name says all that
can change them. `IRL_BENCH_CACHE` names another folder for it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.numpy
from safetensors import safe_open

from envs import EnvSpec
from harness.files import write_atomic
from harness.keys import EXPERT_SOURCES, key_of
from harness.results import Library
from harness.rl_settings import rl_settings_for
from methods.base import Array

CACHE_VARIABLE = "IRL_BENCH_CACHE"
DEFAULT_CACHE = Path("results") / "cache"


@dataclass(frozen=True)
class Kept:
    """Arrays by name, and what JSON can hold."""

    arrays: dict[str, Array]
    facts: dict[str, Any]


def kept(name: str, spec: EnvSpec, budget: str, library: Library, compute: Callable[[], Kept]) -> Kept:
    """What an earlier call with the same arguments computed, or what `compute` returns now."""
    path = cache_file(name, spec, budget, library)
    if (found := load(path)) is None:
        found = compute()
        facts = json.dumps(found.facts)
        metadata = {"facts": facts, "checksum": _checksum(found.arrays, facts)}
        write_atomic(path, safetensors.numpy.save(found.arrays, metadata))
    return found


def load(path: Path) -> Kept | None:
    """None where there is no such file or it is not as it was written."""
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata()
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        facts = metadata["facts"]
        return Kept(arrays, json.loads(facts)) if metadata["checksum"] == _checksum(arrays, facts) else None
    except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError):
        return None


def cache_file(name: str, spec: EnvSpec, budget: str, library: Library) -> Path:
    """Where something of this environment's expert is kept."""
    settings = rl_settings_for(spec.name)
    ingredients = [library, spec.name, spec.rl_steps[budget], dataclasses.asdict(settings)]
    key = key_of(EXPERT_SOURCES, ingredients)
    folder = Path(os.environ.get(CACHE_VARIABLE, DEFAULT_CACHE))
    return folder / f"{name}__{spec.name}__{budget}__{key}.safetensors"


def _checksum(arrays: dict[str, Array], facts: str) -> str:
    digest = hashlib.sha256(facts.encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
