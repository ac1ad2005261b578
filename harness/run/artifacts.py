"""What was learned, kept: pi*, R* and pi_R of a cell in one file, arrays as safetensors, all else as JSON in
its metadata. Loaded, they give the same outputs, bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from harness.judge.results import Cell, CellResult, Conditions, artifact_of
from harness.learn.stored import from_arrays, to_arrays
from harness.registry import BadInput
from harness.run.cache import Kept, as_bytes, from_bytes
from harness.run.codec import printable
from harness.run.files import LARGEST_OF_CELL, read, sha256_of
from methods.base import Policy, Reward

FORMAT = 2
KIND = "safetensors"
LARGEST = LARGEST_OF_CELL // 16 * 15
"""Bytes of what a cell learned, at most: its recordings have the rest."""
NOT_KEPT = "is not kept (docs/plugins.md)"
"""How a warning begins, after the names of a cell and what it learned, that says why that is in no file."""


def artifact(
    cell: Cell, conditions: Conditions, learned: Mapping[str, Policy | Reward | None]
) -> tuple[bytes, list[str]]:
    """The file of a cell, and why some of what was learned cannot be in it; '' where nothing can."""
    arrays, parts, troubles = dict[str, Any](), dict[str, Any](), []
    for name, thing in learned.items():
        try:
            its_arrays, parts[name] = to_arrays(thing, name)
            arrays |= its_arrays
        except (TypeError, ValueError, RecursionError) as error:
            troubles.append(f"{cell.name}: {name} {NOT_KEPT}: {error}")
    facts = {"format": FORMAT, "cell": asdict(cell), "conditions": asdict(conditions), "learned": parts}
    kept = [name for name in parts if learned[name] is not None]
    data = as_bytes(Kept(arrays, facts)) if kept else b""
    if len(data) > LARGEST:
        why = f"the file would be larger than {LARGEST >> 20} MiB"
        return b"", [*troubles, *(f"{cell.name}: {name} {NOT_KEPT}: {why}" for name in kept)]
    return data, troubles


def read_artifact(path: Path, stored: CellResult | None = None) -> dict[str, Any]:
    """Policies and rewards by name: 'pi_star', 'reward', None where the method learns none, and 'pi_R', or
    'expert', as far as there are any. Raises BadInput where the file is none, or damaged, or not the one that
    was stored with the cell `stored`."""
    try:
        data = read(path, LARGEST_OF_CELL)
        if stored and sha256_of(data) != stored.files.get(artifact_of(stored.cell)):
            raise ValueError("its checksum is not the one that its cell has")
        return learned_in(data, stored.cell if stored else None)
    except (OSError, ValueError, MemoryError) as error:
        raise BadInput(f"{path} holds nothing that was learned: {printable(str(error))}") from error


def learned_in(data: bytes, cell: Cell | None = None) -> dict[str, Any]:
    """The same, of what such a file holds. Raises ValueError where it is none, or damaged, or another's than
    the cell's."""
    found = from_bytes(data)
    try:
        if cell and found.facts["cell"] != asdict(cell):
            raise ValueError("it is of another cell")
        if found.facts["format"] != FORMAT:
            raise ValueError(f"it has another format than {FORMAT}")
        learned = {name: from_arrays(found.arrays, part) for name, part in found.facts["learned"].items()}
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    things = [thing for name, thing in learned.items() if (name, thing) != ("reward", None)]
    if not things:
        raise ValueError("policies and rewards of a plug-in's own kinds are not kept")
    if not all(map(callable, things)):
        raise ValueError("what is neither a policy nor a reward")
    return learned
