"""Installed packages that numbers can come from, with their versions."""

from __future__ import annotations

import ast
import functools
import importlib.metadata
import importlib.util
import re
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROGRAM = "irl-bench"
VERSION = re.compile(r"^Version: *(.*?) *$", re.MULTILINE)
REQUIREMENT = re.compile(r"^Requires-Dist: *(.*?) *$", re.MULTILINE)
NO_NUMBERS = "Whatever it does shows in the keys themselves."
LEFT_OUT = {
    **dict.fromkeys(("irl-bench",), "keys are of its source"),
    **dict.fromkeys(("matplotlib", "jinja2", "markupsafe", "rich", "rerun-sdk"), "they show results"),
    **dict.fromkeys(("pillow", "imageio", "pygame-ce", "pygame", "glfw", "pyopengl"), "they draw"),
    **dict.fromkeys(("filelock", "pebble", "psutil", "tqdm"), "they start, lock or count"),
    **dict.fromkeys(("pandas",), "it makes tables of stored rows"),
    **dict.fromkeys(("pyarrow",), "it reads files of demonstrations, whose content is in the keys"),
}
"""Packages that change no number, and why. Packages that only they require are left out, too."""


def required(*roots: str) -> dict[str, str]:
    """Return the versions of these distributions and of all that they require, directly or not, by name.

    Extras are left out, and so is what `LEFT_OUT` names. A distribution that is not installed has version ''.
    Versions are read anew each time.
    """
    return {name: version_of(name) for name in _required(*roots)}


def version_of(name: str) -> str:
    """Return the version of a distribution, '' where it is not installed or says none."""
    stated = VERSION.search(_metadata(name))
    return stated[1] if stated else ""


def _metadata(name: str) -> str:
    """Return what a distribution says of itself before its description, '' where it is not installed.

    To parse all of it takes 1 ms, and each cell asks for sixty.
    """
    try:
        text = importlib.metadata.distribution(name).read_text("METADATA") or ""
    except importlib.metadata.PackageNotFoundError:
        return ""
    return text.partition("\n\n")[0]


@functools.cache
def _required(*roots: str) -> tuple[str, ...]:
    names = set[str]()
    waiting = [*roots] or [PROGRAM]
    while waiting:
        if (name := canonicalize_name(waiting.pop())) in names:
            continue
        names.add(name)
        try:  # A folder of sources says what it requires elsewhere.
            requirements = REQUIREMENT.findall(_metadata(name)) or importlib.metadata.requires(name) or ()
        except importlib.metadata.PackageNotFoundError:
            continue
        waiting += [
            one.name
            for one in map(Requirement, requirements)
            if canonicalize_name(one.name) not in LEFT_OUT
            and (one.marker is None or one.marker.evaluate({"extra": ""}))
        ]
    return tuple(sorted(names - {PROGRAM}))


def imported(module: str) -> dict[str, str]:
    """Return the versions of the distributions that a module of an installed package imports, lazily or not.

    Imports are followed within its package, and each distribution comes with all that it requires. So the
    simulator of a task is found that Gymnasium itself does not require.
    """
    return required(*_imported(module))


@functools.cache
def _imported(module: str) -> tuple[str, ...]:
    top = module.partition(".")[0]
    spec = importlib.util.find_spec(top)
    folders = [Path(folder) for folder in (spec and spec.submodule_search_locations) or ()]
    tops, waiting, seen = {top}, [module], {top}
    while waiting:
        name = waiting.pop()
        tops.add(name.partition(".")[0])
        if name in seen or not name.startswith(f"{top}."):
            continue
        seen.add(name)
        for folder in folders:
            path = folder.joinpath(*name.split(".")[1:])
            for file in (path.with_suffix(".py"), path / "__init__.py"):
                if file.is_file():
                    package = name if file.parent == path else name.rpartition(".")[0]
                    waiting += _imports(file.read_bytes(), package)
    known = distributions()
    return tuple(sorted({name for top in tops for name in known.get(top, ())}))


@functools.cache
def distributions() -> dict[str, list[str]]:
    """Return the names of distributions by module. They are asked once, for that takes a second."""
    return dict(importlib.metadata.packages_distributions())


def _imports(source: bytes, package: str) -> list[str]:
    """Modules, and names in modules, that a file of the package imports."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            module = importlib.util.resolve_name(relative, package) if node.level else relative
            names += [module, *(f"{module}.{alias.name}" for alias in node.names)]
    return names
