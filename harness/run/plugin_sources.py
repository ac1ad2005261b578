"""What the numbers of a plug-in come from: its source and that of the modules it imports, as far as those are
neither Python's own nor of an installed package, of which the version counts, and of all that it requires.

Imports are read in the source, lazy ones too. What is imported by a name that is made up as the program runs
is not found, nor are data files.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib
import importlib.metadata
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from pathlib import Path

from harness.run.packages import distributions, required

NO_NUMBERS = "Whatever it does shows in the keys themselves."

PROGRAM = ("envs", "methods", "harness")
PUBLIC = "irl_bench"
"""The module that gives names of the program's modules."""
PUBLIC_MODULES = ("envs", "methods")
"""Those of which a plug-in's numbers can come."""
CODE = (".py", *EXTENSION_SUFFIXES)
"""How the names of files end that Python imports."""


@dataclass(frozen=True)
class Sources:
    """digests: of files, and versions of distributions. program: modules of this program, and names in
    them."""

    digests: list[str]
    program: list[str]


def sources_of(*modules: str) -> Sources:
    """Return the sources of the modules, which can be imported, and of what they import."""
    from harness.store.codec import printable  # here, for `--help` does without its packages

    digests, program = dict[str, str](), set[str]()
    waiting, seen = [*modules], set[str]()
    while waiting:
        name = waiting.pop()
        top = name.partition(".")[0]
        if top in PROGRAM:
            program.add(name)
        elif top == PUBLIC:
            program.update(_behind(name))
        elif top not in seen and top not in sys.stdlib_module_names:
            seen.add(top)
            versions, files = _found(top)
            digests |= {said: said for said in versions}
            for file, said in files:
                content = file.read_bytes()
                digests[said] = f"{printable(said)} {hashlib.sha256(content).hexdigest()}"
                waiting += _imports(content)
    return Sources(sorted(digests.values()), sorted(program))


def _behind(name: str) -> Iterable[str]:
    """Return the modules that names of the public module come from."""
    where = importlib.import_module(PUBLIC).WHERE
    asked = name.split(".")[1:2]
    found = {where[one] for one in asked if one in where} or {*where.values()}
    return {module for module in found if module.partition(".")[0] in PUBLIC_MODULES}


def _found(top: str) -> tuple[list[str], list[tuple[Path, str]]]:
    """Return the versions of a module or package that is installed, even in part, and its files that are
    not, with their names.

    Of a package that is installed no file is looked at: there may be thousands. But what lies among them and
    is of no distribution has no version, so its files count.
    """
    loaded = sys.modules.get(top)
    folders = [Path(folder) for folder in getattr(loaded, "__path__", [])]
    origin = getattr(loaded, "__file__", None)
    if loaded is None:
        spec = _spec(top)
        if spec is None:
            return [], []
        folders, origin = [Path(folder) for folder in spec.submodule_search_locations or ()], spec.origin
    if not folders and not (origin and origin.endswith(CODE)):
        return [], []
    alone = [] if folders else [Path(str(origin))]
    among = [place for place in (*folders, *alone) if _is_installed(place)]
    versions = _versions(top) if among else []
    installed = among if versions else []
    files = [(file, f"{top}/{name}") for at in folders if at not in installed for file, name in _files(at)]
    files += [(file, file.name) for file in alone if file not in installed]
    return versions, files


def _spec(top: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None


def _files(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield the code in a folder, with its path there, in order. Links to folders are followed, as Python
    does, but for one that leads back to where it is."""
    for at, folders, names in os.walk(folder, followlinks=True):
        here = os.path.realpath(at)
        folders[:] = sorted(
            name
            for name in folders
            if name != "__pycache__" and not f"{here}/".startswith(f"{os.path.realpath(Path(at, name))}/")
        )
        for name in sorted(names):
            file = Path(at, name)
            if name.endswith(CODE) and file.is_file():
                yield file, file.relative_to(folder).as_posix()


@functools.cache
def _places() -> tuple[Path, ...]:
    names = ("purelib", "platlib", "stdlib", "platstdlib")
    return tuple({Path(sysconfig.get_path(name)).resolve() for name in names})


def _is_installed(place: Path) -> bool:
    return any(place.resolve().is_relative_to(installed) for installed in _places())


def _versions(top: str) -> list[str]:
    """Return the installed distributions that a module may be of, and all that they require, with
    versions."""
    names = [top] if _is_called(top) else sorted(set(distributions().get(top, [])))
    return [f"{name} {version}" for name, version in required(*names).items()] if names else []


@functools.cache
def _is_called(top: str) -> bool:
    """Return whether the distribution that has a module is called as the module is. Most are, and to ask all
    distributions takes a second."""
    try:
        distribution = importlib.metadata.distribution(top)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return False
    its = (distribution.read_text("top_level.txt") or "").split()
    record = f"\n{distribution.read_text('RECORD') or ''}"
    return distribution.metadata["Name"] == top and (top in its or f"\n{top}/__init__.py," in record)


@functools.cache
def _imports(source: bytes) -> tuple[str, ...]:
    """Return modules, and names in modules, that a file imports; those of its own package are read anyway."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return ()
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(found)
