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
    for env in {cell.env for cell in results}:
        keys = {cell: results[cell].key for cell in sorted(results) if cell.env == env}
        deciding = [key for cell, key in keys.items() if cell.method == REFERENCE] or keys.values()
        task = _most(map(task_of, deciding))
        of_seeds: dict[Cell, list[str]] = {}
        for cell, key in keys.items():
            if task_of(key) == task:
                of_seeds.setdefault(dataclasses.replace(cell, seed=0), []).append(key)
        most = {_most(of_one) for of_one in of_seeds.values()}
        others |= {cell for cell, key in keys.items() if key not in most}
    return sorted(others)


def _most(keys: Iterable[str]) -> str:
    """Return the most frequent key, the first one of equals."""
    ((most, _),) = Counter(keys).most_common(1)
    return most
