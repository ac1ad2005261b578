"""Cells as JSON with a checksum, and the door that checks whatever claims to be one."""

from __future__ import annotations

import hashlib
import json
import math
import re
from typing import Any, NoReturn, TypeVar

import msgspec

from harness.judge.results import CONTROL_CHARACTERS, Cell, CellResult, policies_of, usable

T = TypeVar("T")
LONGEST_REASON = 100
"""Characters of a reason's beginning and of its end, where it is longer."""


def encode(result: CellResult) -> str:
    """JSON of the result and its checksum; numbers that are not `usable` become null. Raises TypeError for no
    JSON."""
    payload = _plain(msgspec.to_builtins(result, enc_hook=_as_builtin))
    flat = json.dumps({"sha256": checksum(payload), "result": payload})
    return msgspec.json.format(flat, indent=1) + "\n"


def decode(data: bytes | str) -> CellResult:
    """The inverse of `encode`. Raises ValueError for anything that it did not write."""
    try:
        stored = json.loads(data, parse_constant=_refuse)
        payload = stored["result"]
        if stored["sha256"] != checksum(payload):
            raise ValueError("its checksum does not match")
        known = _nan_for_none(payload)
    except (KeyError, TypeError, RecursionError, json.JSONDecodeError, UnicodeError) as error:
        raise ValueError("it is no stored cell") from error
    result = checked(known, CellResult)
    if not _holds(_plain(msgspec.to_builtins(result)), payload):
        raise ValueError("it holds more than a cell does")
    cell = result.cell
    for row in result.rows:
        if Cell(row.env, row.method, row.seed, row.shown, row.dynamics) != cell:
            raise ValueError(f"it holds a row of {row.task}, {row.method}, seed {row.seed}")
    policies = [row.policy for row in result.rows]
    for policy in (*policies, *result.endings):
        if policy not in policies_of(cell) or policies.count(policy) > 1:
            raise ValueError(f"it holds {policy!r} where a policy of {cell.method} should be, once")
    return result


def checked(data: Any, kind: type[T]) -> T:
    """What JSON held, as `kind`. Raises ValueError, with the place, where it is none."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        reason = re.sub("matching regex '.*'", "of one plain line, or a plain name", str(error))
        if len(reason) > LONGEST_REASON:
            reason = f"{reason[:LONGEST_REASON]} … {reason[-LONGEST_REASON:]}"
        raise ValueError(printable(reason)) from error


def checksum(payload: Any) -> str:
    """Of JSON, however it is written. Raises TypeError for no JSON."""
    return hashlib.sha256(json.dumps(payload, sort_keys=True).encode()).hexdigest()


def printable(text: str) -> str:
    """The text with everything escaped that would change how it is shown."""
    return re.sub(f"[{CONTROL_CHARACTERS}]", lambda found: ascii(found[0])[1:-1], text)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number")


def _holds(known: Any, stored: Any) -> bool:
    """Whether nothing is stored that is not known; fields that were not there yet have their defaults."""
    if known == stored:
        return True
    if isinstance(known, dict) and isinstance(stored, dict):
        return all(key in known and _holds(known[key], value) for key, value in stored.items())
    if isinstance(known, list) and isinstance(stored, list):
        return len(known) == len(stored) and all(map(_holds, known, stored))
    return False


def _as_builtin(value: Any) -> Any:
    """NumPy's kinds of float and str are Python's as well, and others may be."""
    for kind in (float, int, str):
        if isinstance(value, kind):
            return kind(value)
    raise TypeError(f"{type(value).__name__} is no JSON")


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if usable(value) else None
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _nan_for_none(value: Any) -> Any:
    if isinstance(value, float):
        if not usable(value):
            raise ValueError(f"{value} is out of range")
        return value
    if isinstance(value, dict):
        return {key: _nan_for_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_nan_for_none(item) for item in value]
    return math.nan if value is None else value
