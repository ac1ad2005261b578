"""The policies and the reward that a cell learned, as bytes: arrays as safetensors, the rest as its metadata.

Loaded, they give the same outputs, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from harness.records import Cell, Conditions
from harness.rl.stored import from_arrays, to_arrays
from harness.store.cache import Kept, as_bytes, from_bytes
from harness.store.files import LARGEST_OF_CELL
from methods.base import Policy, Reward

FORMAT = 2
LARGEST = LARGEST_OF_CELL // 16 * 15
"""Most bytes of what a cell learned: its recordings have the rest."""
NOT_KEPT = "is not kept (docs/plugins.md)"
"""Part of the warning that names a cell and the thing that could not be kept, and says why."""


def artifact(
    cell: Cell, conditions: Conditions, learned: Mapping[str, Policy | Reward | None]
) -> tuple[bytes, list[str]]:
    """Return the bytes of what a cell learned, empty where nothing can be kept, and why parts are missing."""
    arrays, parts, troubles = dict[str, Any](), dict[str, Any](), []
    for name, thing in learned.items():
        try:
            own_arrays, parts[name] = to_arrays(thing, name)
            arrays |= own_arrays
        except (TypeError, ValueError, RecursionError) as error:
            troubles.append(f"{cell.name}: {name} {NOT_KEPT}: {error}")
    facts = {"format": FORMAT, "cell": asdict(cell), "conditions": asdict(conditions), "learned": parts}
    names = [name for name in parts if learned[name] is not None]
    data = as_bytes(Kept(arrays, facts)) if names else b""
    if len(data) > LARGEST:
        why = f"the file would be larger than {LARGEST >> 20} MiB"
        return b"", [*troubles, *(f"{cell.name}: {name} {NOT_KEPT}: {why}" for name in names)]
    return data, troubles


def learned_in(data: bytes, cell: Cell | None = None) -> dict[str, Any]:
    """Return policies and rewards by name: 'pi_star', 'pi_R' or 'expert', and 'reward', None where the method
    learns none. Raises ValueError where the bytes are damaged, or another cell's."""
    stored = from_bytes(data)
    try:
        if cell and stored.facts["cell"] != asdict(cell):
            raise ValueError("it is of another cell")
        if stored.facts["format"] != FORMAT:
            raise ValueError(f"it has another format than {FORMAT}")
        learned = {name: from_arrays(stored.arrays, part) for name, part in stored.facts["learned"].items()}
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    things = [thing for name, thing in learned.items() if (name, thing) != ("reward", None)]
    if not things:
        raise ValueError("policies and rewards of a plug-in's own kinds are not kept")
    if not all(map(callable, things)):
        raise ValueError("it holds something that is neither a policy nor a reward")
    return learned
