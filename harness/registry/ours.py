"""This program's packages are found before others of their names, such as those beside a user's script."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

NO_NUMBERS = "It says where Python finds the program, whose source is in the keys."
SHARED = ("envs", "methods")
"""Packages that a user's script may have, too."""
PROGRAM = (*SHARED, "harness")
PUBLIC = "irl_bench"
"""The module that gives names of the program's modules."""
ROOT = Path(__file__).resolve().parents[2]


class _First:
    """A finder of this program's packages, and of the public module.

    `depth`: contexts in which all are this program's; 0 where a user's own of these names are found.
    `aside`: modules of this program whose names a user's have meanwhile.
    """

    depth = 0
    aside: dict[str, ModuleType] = {}  # noqa: RUF012, one for the process

    @classmethod
    def find_spec(cls, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if path is not None or name not in (*PROGRAM, PUBLIC):
            return None
        is_theirs = name in SHARED and not cls.depth and _is_hidden(name)
        return None if is_theirs else PathFinder.find_spec(name, [str(ROOT)])


@contextmanager
def meanwhile() -> Iterator[None]:
    """Find this program's packages until the context ends, and a user's of the same names afterwards."""
    theirs = _enter()
    try:
        yield
    finally:
        _First.depth -= 1
        if not _First.depth and (theirs or any(map(_is_hidden, SHARED))):
            _First.aside |= _taken(ours=True)
            sys.modules.update(theirs)


def first() -> None:
    """Make Python find this program's packages until the process ends."""
    _enter()


def _enter() -> dict[str, ModuleType]:
    """Begin to find this program's packages. Return a user's modules that are not found meanwhile."""
    if _First not in sys.meta_path:
        sys.meta_path.insert(0, _First)
    _First.depth += 1
    theirs = _taken(ours=False)
    sys.modules.update(_First.aside)
    _First.aside.clear()
    return theirs


def _taken(ours: bool) -> dict[str, ModuleType]:
    """Return the modules of shared names that are this program's, or those that are not, and forget them."""
    tops = {name for name in SHARED if name in sys.modules and _is_ours(name) == ours}
    return {name: sys.modules.pop(name) for name in [*sys.modules] if name.partition(".")[0] in tops}


def _is_ours(name: str) -> bool:
    module = sys.modules[name]
    return _lies_here(name, [*getattr(module, "__path__", []), getattr(module, "__file__", None)])


def _is_hidden(name: str) -> bool:
    """Return whether Python would find another package of that name."""
    spec = PathFinder.find_spec(name)
    return spec is not None and not _lies_here(name, [*(spec.submodule_search_locations or []), spec.origin])


def _lies_here(name: str, places: list[str | None]) -> bool:
    return ROOT / name in [Path(place).resolve() for place in places if place]
