"""What the numbers of a plug-in come from: its source and that of the modules it imports, as far as those are
neither Python's own nor of an installed package, of which the version counts.

Imports are read in the source, lazy ones too. What is imported by a name that is made up as the program runs
is not found, nor are data files.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.metadata
import importlib.util
import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

NO_NUMBERS = "Whatever it does shows in the keys themselves."

PROGRAM = ("envs", "methods", "harness")
PUBLIC = "irl_bench"
"""The module that gives names of the program's modules."""
PUBLIC_MODULES = ("envs", "methods")
"""Those of which a plug-in's numbers can come."""


@dataclass(frozen=True)
class Sources:
    """digests: of files, and versions of distributions. program: modules of this program, and names in
    them."""

    digests: list[str]
    program: list[str]


def sources_of(module: str) -> Sources:
    """Of the module, which can be imported, and of what it imports."""
    digests, program = dict[str, str](), set[str]()
    waiting, seen = [module], set[str]()
    while waiting:
        name = waiting.pop()
        top = name.partition(".")[0]
        if top in PROGRAM:
            program.add(name)
        elif top == PUBLIC:
            program.update(_behind(name))
        elif top not in seen and top not in sys.stdlib_module_names:
            seen.add(top)
            digests |= {said: said for said in _distributions(top)}
            for file, said in _own_files(top):
                content = file.read_bytes()
                digests[said] = f"{said} {hashlib.sha256(content).hexdigest()}"
                waiting += _imports(content)
    return Sources(sorted(digests.values()), sorted(program))


def _behind(name: str) -> Iterable[str]:
    """Where names of the public module come from."""
    where = importlib.import_module(PUBLIC).WHERE
    asked = name.split(".")[1:2]
    found = {where[one] for one in asked if one in where} or {*where.values()}
    return {module for module in found if module.partition(".")[0] in PUBLIC_MODULES}


def _own_files(top: str) -> list[tuple[Path, str]]:
    """Those of a module or package, with what they are called; none where it is installed, or built in."""
    loaded = sys.modules.get(top)
    folders = [Path(folder) for folder in getattr(loaded, "__path__", [])]
    origin = getattr(loaded, "__file__", None)
    if loaded is None:
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
        if spec is None:
            return []
        folders, origin = [Path(folder) for folder in spec.submodule_search_locations or ()], spec.origin
    files = [(file, folder) for folder in folders for file in sorted(folder.rglob("*.py"))]
    if not folders and origin and origin.endswith(".py"):
        files = [(Path(origin), Path(origin).parent)]
    return [
        (file, file.relative_to(folder).as_posix() if not folders else f"{top}/{file.relative_to(folder)}")
        for file, folder in files
        if not _is_installed(file)
    ]


def _is_installed(file: Path) -> bool:
    places = {sysconfig.get_path(name) for name in ("purelib", "platlib", "stdlib", "platstdlib")}
    return any(file.resolve().is_relative_to(Path(place).resolve()) for place in places)


def _distributions(top: str) -> list[str]:
    """Installed distributions that a module may be of, with versions."""
    names = importlib.metadata.packages_distributions().get(top, [])
    return sorted({f"{name} {importlib.metadata.version(name)}" for name in names})


def _imports(source: bytes) -> list[str]:
    """Modules, and names in modules, that a file imports; those of its own package are read anyway."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return []
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found
