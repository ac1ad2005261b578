"""The cache: arrays and facts that are computed once, in files whose names say all that can change them.

`harness.process.environment.cache_folder` says where they lie.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.numpy

from harness.process.environment import cache_folder
from harness.registry.keys import expert_key
from harness.registry.machine import machine
from harness.store.files import can_write, opened, write_atomic

COMPILED_VARIABLE = "JAX_COMPILATION_CACHE_DIR"


@dataclass(frozen=True)
class Kept:
    """Arrays by name, and facts that JSON can hold."""

    arrays: dict[str, Any]
    facts: dict[str, Any]


def kept(name: str, env: str, asked: object, compute: Callable[[], Kept]) -> Kept:
    """Return the result of an earlier call with the same arguments, or else of `compute`, called now.

    asked: any JSON. Nothing is kept where the cache cannot be written to.
    """
    path = cache_file(name, env, asked)
    if stored := load(path):
        return stored
    computed = compute()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, as_bytes(computed))
    return computed


def compiled_once(spare: Path | None = None) -> dict[str, str]:
    """Return the variables with which JAX compiles each program once for all processes of this machine.

    Programs are kept in the folder that the user names, else in the cache, by processor and versions. spare:
    the folder for them where the cache cannot be written to.
    """
    folder: str | Path | None = os.environ.get(COMPILED_VARIABLE)
    if not folder:
        made_with = hashlib.sha256(json.dumps(machine()).encode()).hexdigest()[:16]
        usual = cache_folder().absolute() / f"compiled_{made_with}"
        folder = usual if can_write(usual) else spare
    if not folder:
        return {}
    return {COMPILED_VARIABLE: str(folder), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}


def as_bytes(what: Kept) -> bytes:
    """Return the bytes that `from_bytes` and `load` read; the same things are the same bytes."""
    facts = json.dumps(what.facts)
    metadata = {"facts": facts, "checksum": _checksum(what.arrays, facts)}
    data = safetensors.numpy.save(what.arrays, metadata)
    size = int.from_bytes(data[:8], "little")
    # The library writes its header's entries in any order.
    header = json.dumps(json.loads(data[8 : 8 + size]), sort_keys=True).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + data[8 + size :]


def from_bytes(data: bytes) -> Kept:
    """Return the things that `as_bytes` wrote. Raises ValueError for anything else."""
    try:
        arrays = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        facts, checksum = (header["__metadata__"][name] for name in ("facts", "checksum"))
        if checksum == _checksum(arrays, facts):
            return Kept(arrays, json.loads(facts))
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError("it is not as it was written") from error
    raise ValueError("its checksum does not match")


def load(path: Path) -> Kept | None:
    """Return the content of a file, None where it is absent or damaged."""
    with suppress(OSError, ValueError), opened(path) as file:
        return from_bytes(file.read())
    return None


def cache_file(name: str, env: str, asked: object) -> Path:
    """Return the file in which something of this environment's expert is kept."""
    return cache_folder() / f"{name}__{env}__{expert_key(env, [env, asked])}.safetensors"


def _checksum(arrays: dict[str, Any], facts: str) -> str:
    digest = hashlib.sha256(facts.encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
