"""Versions of results: those of one version can be compared."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping

from harness.records import REFERENCE, Cell, CellResult
from harness.registry.keys import task_of

NO_NUMBERS = "It leaves results out and changes none."


def of_other_versions(results: Mapping[Cell, CellResult]) -> list[Cell]:
    """Return the cells that cannot be compared with the rest of their environment.

    The version of an environment is that of most of its references, or of most cells where it has none. Cells
    that differ by their seed alone are of one version, too.
    """
    others = set[Cell]()
    by_env: dict[str, dict[Cell, str]] = {}
    for cell in sorted(results):
        by_env.setdefault(cell.env, {})[cell] = results[cell].key
    for keys in by_env.values():
        deciding = {cell: key for cell, key in keys.items() if cell.method == REFERENCE} or keys
        task = _most(map(task_of, deciding.values()))
        others |= {cell for cell, key in keys.items() if task_of(key) != task}
        by_method: dict[Cell, dict[Cell, str]] = {}
        for cell in sorted(keys.keys() - others):
            by_method.setdefault(dataclasses.replace(cell, seed=0), {})[cell] = keys[cell]
        for of_seeds in by_method.values():
            most = _most(of_seeds.values())
            others |= {cell for cell, key in of_seeds.items() if key != most}
    return sorted(others)


def _most(keys: Iterable[str]) -> str:
    """Return the most frequent key, the first one of equals."""
    ((most, _),) = Counter(keys).most_common(1)
    return most
