"""JSON of everything that a run stores, and the checks of whatever claims to be such JSON."""

from __future__ import annotations

import hashlib
import json
import math
import re
from typing import Any, TypeVar

import msgspec

from harness.records import Cell, CellResult, policies_of
from harness.registry.bounds import CONTROL_CHARACTERS, usable

T = TypeVar("T")
LONGEST_REASON = 200


def encode(value: object) -> str:
    """Return the JSON of a dataclass; numbers that are not `usable` become null. Raises TypeError for values
    that JSON cannot hold."""
    return json.dumps(_plain(msgspec.to_builtins(value, enc_hook=_as_builtin)))


def decode(data: bytes | str) -> CellResult:
    """Return the result that `encode` wrote. Raises ValueError for anything that it did not write."""
    result = parsed(data, CellResult)
    cell = result.cell
    for row in result.rows:
        if Cell(row.env, row.method, row.seed, row.shown, row.dynamics) != cell:
            raise ValueError(f"it holds a row of {row.task}, {row.method}, seed {row.seed}")
    policies = [row.policy for row in result.rows]
    for policy in (*policies, *result.endings):
        if policy not in policies_of(cell) or policies.count(policy) > 1:
            raise ValueError(f"it holds {policy!r} where a policy of {cell.method} should be, once")
    return result


def parsed(data: bytes | str, kind: type[T]) -> T:
    """Return the dataclass of this kind that `encode` wrote; fields that the data lacks have their defaults.
    Raises ValueError, with the place, where the data is anything else."""
    try:
        return msgspec.convert(_with_nan(json.loads(data)), kind)
    except msgspec.ValidationError as error:
        reason = re.sub("matching regex '.*'", "of one plain line, or a plain name", str(error))
        raise ValueError(printable(reason[:LONGEST_REASON])) from error
    except (TypeError, RecursionError, json.JSONDecodeError, UnicodeError) as error:
        raise ValueError("it is no JSON of a run") from error


def checksum(payload: Any) -> str:
    """Return the SHA-256 of JSON, however it is written. Raises TypeError for what JSON cannot hold."""
    return hashlib.sha256(json.dumps(payload, sort_keys=True).encode()).hexdigest()


def printable(text: str) -> str:
    """Return the text with every character escaped that would change how it is shown."""
    return re.sub(f"[{CONTROL_CHARACTERS}]", lambda match: ascii(match[0])[1:-1], text)


def _as_builtin(value: Any) -> Any:
    """Return NumPy's and other subclasses of float, int and str as Python's own."""
    for kind in (float, int, str):
        if isinstance(value, kind):
            return kind(value)
    raise TypeError(f"{type(value).__name__} is no JSON")


def _plain(value: Any) -> Any:
    """Return the value with None for numbers that are not usable."""
    if isinstance(value, float):
        return value if usable(value) else None
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _with_nan(value: Any) -> Any:
    """Return the value with NaN for None. Raises ValueError for a number that is not usable."""
    if isinstance(value, float) and not usable(value):
        raise ValueError(f"{value} is out of range")
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return math.nan if value is None else value
