"""Policies, rewards and experts as arrays and a description of what they are, without pickle.

They are built of frozen dataclasses, arrays, tuples, numbers, text and None. A registered environment is
stored as its name.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.registry import KNOWN, SPECS

PACKAGES = ("envs", "methods", "harness.rl", "harness.judge", "harness.cell")
"""Packages whose dataclasses are stored and loaded: importing one of their modules does nothing else."""


def to_arrays(thing: object, name: str) -> tuple[dict[str, NDArray[Any]], Any]:
    """Return the arrays in it, by names that begin with `name`, and what JSON can hold of the rest. Raises
    TypeError for what cannot be stored."""
    arrays: dict[str, NDArray[Any]] = {}
    return arrays, _described(thing, name, arrays)


def from_arrays(arrays: Mapping[str, NDArray[Any]], described: Any) -> Any:
    """Return what `to_arrays` received. Raises ValueError for anything that it did not write."""
    try:
        return _built(arrays, described)
    except (LookupError, TypeError, AttributeError, ImportError, RecursionError, ArithmeticError) as error:
        raise ValueError(f"nothing that was stored here: {error}") from error


def _described(thing: object, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if type(thing) is np.ndarray:
        arrays[name] = compact(thing)
        return {"array": name}
    if type(thing) is tuple:
        return {"tuple": [_described(item, f"{name}.{i}", arrays) for i, item in enumerate(thing)]}
    if isinstance(thing, EnvSpec):
        known = SPECS[thing.name] if thing.name in KNOWN.entries["env"] else None
        if known is not None and thing.encoder != known.encoder:
            return {"env": thing.name, "encoder": thing.encoder}
        # What is stored asks no learner, so a task with another one is the same.
        if known is None or dataclasses.replace(thing, rl=known.rl, rl_steps=known.rl_steps) != known:
            raise TypeError(f"{thing.name} is no registered environment")
        return {"env": thing.name}
    kind = type(thing)
    if not dataclasses.is_dataclass(kind) or not _is_ours(kind.__module__):
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} is no dataclass of {', '.join(PACKAGES)}")
    fields = [field.name for field in dataclasses.fields(kind) if field.init]
    parts = {field: _described(getattr(thing, field), f"{name}.{field}", arrays) for field in fields}
    return {"class": f"{kind.__module__}:{kind.__qualname__}", "fields": parts}


def _built(arrays: Mapping[str, NDArray[Any]], described: Any) -> Any:
    match described:
        case None | bool() | int() | float() | str():
            return described
        case {"array": str(name)}:
            array = arrays[name]
            return array.astype(np.float64) if array.dtype == np.float32 else array
        case {"tuple": list(items)}:
            return tuple(_built(arrays, item) for item in items)
        case {"env": str(name), "encoder": str(encoder)}:
            return SPECS[name].encoded_by(encoder)
        case {"env": str(name)}:
            return SPECS[name]
        case {"class": str(target), "fields": dict(fields)}:
            module, _, attribute = target.partition(":")
            kind = getattr(importlib.import_module(module), attribute) if _is_ours(module) else None
            if isinstance(kind, type) and dataclasses.is_dataclass(kind):
                return kind(**{key: _built(arrays, value) for key, value in fields.items()})
    raise ValueError(f"{str(described)[:80]!r} is nothing that was stored here")


def compact(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array in 32 bits where that loses nothing, as in what was fitted in 32 bits. Raises
    TypeError for what cannot be stored."""
    if array.dtype != np.float64:
        if array.dtype.kind not in "biu" or not array.dtype.isnative:
            raise TypeError(f"an array of {array.dtype} cannot be stored")
        return np.asarray(array, order="C")
    with np.errstate(over="ignore"):
        half = array.astype(np.float32)
    return np.asarray(half if np.array_equal(half.astype(np.float64), array) else array, order="C")


def _is_ours(module: str) -> bool:
    return f"{module}.".startswith(tuple(f"{package}." for package in PACKAGES))
