"""This program's packages are found before others of their names, such as those beside a user's script."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from harness.registry.names import BadInput

NO_NUMBERS = "It says where Python finds the program, whose source is in the keys."
PROGRAM = ("envs", "methods", "harness")
PUBLIC = "irl_bench"
"""The module that gives names of the program's modules."""
ROOT = Path(__file__).resolve().parents[2]


class _First:
    """A finder of this program's packages, and of the public module."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        is_ours = path is None and name in (*PROGRAM, PUBLIC)
        return PathFinder.find_spec(name, [str(ROOT)]) if is_ours else None


def first() -> None:
    """Make Python find this program's packages first. Raises BadInput for another one that is imported."""
    if _First not in sys.meta_path:
        sys.meta_path.insert(0, _First)
    for name in PROGRAM:
        there = sys.modules.get(name)
        places = [*getattr(there, "__path__", []), getattr(there, "__file__", None)]
        files = [Path(place).resolve() for place in places if place]
        if there and ROOT / name not in files:
            raise BadInput(f"{files[-1]} hides this program's package {name!r}: rename it", page="plugins")
