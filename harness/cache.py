"""What is computed once and kept for other runs: arrays and a few facts, in a file whose name says all that
can change them. `IRL_BENCH_CACHE` names another folder for it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.numpy
from safetensors import safe_open

from envs import EnvSpec
from harness.environment import cache_folder
from harness.files import opened, write_atomic
from harness.keys import EXPERT_SOURCES, key_of
from harness.results import Library
from harness.rl_settings import rl_settings_for
from methods.base import Array


@dataclass(frozen=True)
class Kept:
    """Arrays by name, and what JSON can hold."""

    arrays: dict[str, Array]
    facts: dict[str, Any]


def kept(name: str, spec: EnvSpec, budget: str, library: Library, compute: Callable[[], Kept]) -> Kept:
    """What an earlier call with the same arguments computed, or what `compute` returns now. Where the cache
    cannot be written to, that is kept with the run's temporary files."""
    path = cache_file(name, spec, budget, library)
    spare = Path(tempfile.gettempdir()) / "cache" / path.name
    if found := load(path) or load(spare):
        return found
    computed = compute()
    facts = json.dumps(computed.facts)
    metadata = {"facts": facts, "checksum": _checksum(computed.arrays, facts)}
    data = safetensors.numpy.save(computed.arrays, metadata)
    try:
        _write(path, data)
    except OSError:
        _write(spare, data)
    return computed


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, data)


def load(path: Path) -> Kept | None:
    """None where there is no such file or it is not as it was written."""
    try:
        with opened(path):  # raises for what would block
            pass
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata()
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        facts = metadata["facts"]
        return Kept(arrays, json.loads(facts)) if metadata["checksum"] == _checksum(arrays, facts) else None
    except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        return None


def cache_file(name: str, spec: EnvSpec, budget: str, library: Library) -> Path:
    """Where something of this environment's expert is kept."""
    settings = rl_settings_for(spec.name)
    ingredients = [library, spec.name, spec.rl_steps[budget], dataclasses.asdict(settings)]
    key = key_of(EXPERT_SOURCES, ingredients)
    return cache_folder() / f"{name}__{spec.name}__{budget}__{key}.safetensors"


def _checksum(arrays: dict[str, Array], facts: str) -> str:
    digest = hashlib.sha256(facts.encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
