"""Import graphs: every file that numbers can come from, of this program and of plug-ins alike.

A file counts by what it does: comments and docstrings do not. Imports are read in the source, lazy ones too.
Data files count where a text in the source names them, from the source's folder. A module says under
`NO_NUMBERS` which of its places change no number: one reason for all of it, or a reason by place, such as
'Class.method'. Modules under a name that is made up as the program runs are not found.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib
import importlib.util
import os
import posixpath
import sys
import sysconfig
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import NamedTuple

from harness.registry import packages
from harness.registry.names import plain
from harness.registry.ours import PROGRAM, PUBLIC

NO_NUMBERS = "Its results are the keys themselves."

DECLARATION = "NO_NUMBERS"
CODE = (".py", *EXTENSION_SUFFIXES)
"""Endings of files that Python imports."""
LONGEST = 200
"""Characters of a text that may name a data file."""
_DEFINITIONS = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


class Code(NamedTuple):
    """Facts about a source file.

    `imports`: modules, and names in modules; relative ones begin with dots. `texts`: possible names of data
    files. `counts`: whether the file can change a number.
    """

    digest: str
    imports: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    counts: bool = True


def reach(finder: OfProgram | OfOthers, modules: Iterable[str]) -> dict[str, str]:
    """Return the digests of all files that the modules' numbers can come from, by name."""
    digests, seen, waiting = dict[str, str](), set[str](), [*modules]
    while waiting:
        if (module := waiting.pop()) in seen:
            continue
        seen.add(module)
        for name, content in finder.files(module):
            code = read_code(content)
            if name in digests or not code.counts:
                continue
            digests[name] = code.digest
            package = posixpath.dirname(name).replace("/", ".")
            for one in code.imports:
                with suppress(ImportError):  # A relative import may lead out of its package.
                    waiting.append(importlib.util.resolve_name(one, package))
            for data in filter(None, (finder.data(name, text) for text in code.texts)):
                digests[data[0]] = hashlib.sha256(data[1]).hexdigest()
    return digests


@functools.cache
def read_code(source: bytes) -> Code:
    """Return the facts about a source file. A file that cannot be parsed imports nothing."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return Code(hashlib.sha256(source).hexdigest())
    declared = no_numbers(tree)
    strip(tree, {DECLARATION, *([] if isinstance(declared, str) else declared)})
    imports, texts = list[str](), list[str]()
    for part in ast.walk(tree):
        if isinstance(part, ast.Import):
            imports += [alias.name for alias in part.names]
        elif isinstance(part, ast.ImportFrom):
            module = "." * part.level + (f"{part.module}." if part.module else "")
            imports += [f"{module}{alias.name}" for alias in part.names]
        elif isinstance(part, ast.Constant) and isinstance(part.value, str):
            texts.append(part.value)
    digest = hashlib.sha256(ast.dump(tree).encode(errors="surrogatepass")).hexdigest()
    names = tuple(text for text in texts if "." in text and len(text) <= LONGEST and text.isprintable())
    return Code(digest, tuple(imports), names, not isinstance(declared, str))


def no_numbers(tree: ast.Module) -> str | dict[str, str]:
    """Return a module's declaration: reasons by place, or one reason for the whole module."""
    for node in tree.body:
        match node:
            case ast.Assign([ast.Name(name)]) if name == DECLARATION:
                with suppress(ValueError):
                    value = ast.literal_eval(node.value)
                    return value if isinstance(value, str | dict) else {}
    return {}


def strip(node: ast.AST, left_out: Collection[str], within: str = "") -> None:
    """Take docstrings, also those of fields, and the places `left_out` from a tree, in place."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        if isinstance(parts := getattr(node, name, None), list):
            parts = [part for part in parts if not _is_left_out(part, left_out, within)]
            setattr(node, name, parts)
            for part in parts:
                inside = f"{within}{part.name}." if isinstance(part, _DEFINITIONS) else within
                strip(part, left_out, inside)


def _is_left_out(part: ast.AST, left_out: Collection[str], within: str) -> bool:
    match part:
        case ast.Expr(ast.Constant(str())):
            return True
        case ast.ClassDef(name) | ast.FunctionDef(name) | ast.AsyncFunctionDef(name):
            names = [name]
        case ast.Assign(targets):
            names = [target.id for target in targets if isinstance(target, ast.Name)]
        case ast.AnnAssign(ast.Name(name)):
            names = [name]
        case _:
            return False
    return any(f"{within}{name}" in left_out for name in names)


@dataclass(frozen=True)
class OfProgram:
    """A finder of this program's files. `contents`: one reading of them, by path."""

    contents: Mapping[str, bytes]

    def files(self, module: str) -> Iterable[tuple[str, bytes]]:
        """Return the names and contents of the files that an import of the module, or of a name in one,
        executes."""
        parts = module.split(".")
        starts = ["/".join(parts[: i + 1]) for i in range(len(parts))]
        names = [name for start in starts for name in (f"{start}.py", f"{start}/__init__.py")]
        return [(name, self.contents[name]) for name in names if name in self.contents]

    def data(self, file: str, text: str) -> tuple[str, bytes] | None:
        """Return the data file that a text in a source file names, with its name."""
        name = posixpath.normpath(posixpath.join(posixpath.dirname(file), text))
        return (name, self.contents[name]) if name in self.contents else None


@dataclass(frozen=True)
class Sources:
    """Sources of plug-ins. `digests`: of files, and versions of distributions.
    `program`: modules of this program, and names in them."""

    digests: list[str] = field(default_factory=list)
    program: list[str] = field(default_factory=list)


def sources_of(*modules: str) -> Sources:
    """Return the sources of modules that are imported, or can be, and of their imports."""
    finder = OfOthers()
    files = [f"{plain(name)} {digest}" for name, digest in reach(finder, modules).items()]
    return Sources(sorted([*files, *finder.versions]), sorted(finder.program))


class OfOthers:
    """A finder of files outside this program. A package counts whole.

    The version of an installed package counts, with the versions of its requirements. Its files are not read.
    `versions`: of installed distributions. `program`: the modules of this program that were asked for.
    """

    def __init__(self) -> None:
        self.versions, self.program = set[str](), set[str]()
        self._seen = set[str]()
        self._paths = dict[str, Path]()

    def files(self, module: str) -> Iterator[tuple[str, bytes]]:
        """Yield as `OfProgram.files` returns."""
        top = module.partition(".")[0]
        if top in PROGRAM:
            self.program.add(module)
        elif top == PUBLIC:
            self.program |= _behind(module)
        elif top and top not in self._seen and top not in sys.stdlib_module_names:
            self._seen.add(top)
            places = _places_of(top)
            versions = packages.versions_of_module(top) if any(map(is_installed, places)) else {}
            self.versions |= {f"{name} {version}" for name, version in versions.items()}
            for place in places:
                if not (versions and is_installed(place)):
                    for path in _code_in(place) if place.is_dir() else [place]:
                        name = path.relative_to(place.parent).as_posix()
                        self._paths[name] = path
                        yield name, path.read_bytes()

    def data(self, file: str, text: str) -> tuple[str, bytes] | None:
        """Return as `OfProgram.data` does."""
        path = self._paths[file].parent / text
        if path.suffix in CODE or not path.is_file():
            return None
        return posixpath.join(posixpath.dirname(file), text), path.read_bytes()


def _behind(name: str) -> set[str]:
    """Return the modules of tasks and methods that a name of the public module comes from."""
    where = importlib.import_module(PUBLIC).WHERE
    asked = name.split(".")[1:2]
    modules = {where[one] for one in asked if one in where} or {*where.values()}
    return {module for module in modules if not module.startswith("harness")}


def _places_of(top: str) -> list[Path]:
    """Return the folders of a package, or the file of a module."""
    if loaded := sys.modules.get(top):
        folders, origin = getattr(loaded, "__path__", None), getattr(loaded, "__file__", None)
    else:
        spec = None
        with suppress(ImportError, ValueError):
            spec = importlib.util.find_spec(top)
        folders, origin = (spec.submodule_search_locations, spec.origin) if spec else (None, None)
    return [Path(place) for place in folders or [origin or ""] if folders or place.endswith(CODE)]


def _code_in(folder: Path) -> Iterator[Path]:
    """Yield the code in a folder, also behind links to folders, each folder once."""
    seen = set[str]()
    for at, folders, names in os.walk(folder, followlinks=True):
        folders.sort()
        if (real := os.path.realpath(at)) in seen:
            folders.clear()
            continue
        seen.add(real)
        yield from (
            path for name in sorted(names) if name.endswith(CODE) and (path := Path(at, name)).is_file()
        )


def is_installed(place: Path) -> bool:
    """Return whether a file or folder lies where Python's packages are."""
    names = ("purelib", "platlib", "stdlib", "platstdlib")
    return any(place.resolve().is_relative_to(Path(sysconfig.get_path(name)).resolve()) for name in names)
