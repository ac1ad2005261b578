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
from typing import NamedTuple, Protocol

from harness.registry import packages
from harness.registry.names import plain

NO_NUMBERS = "Its results are the keys themselves."

PROGRAM = ("envs", "methods", "harness")
PUBLIC = "irl_bench"
"""The module that gives names of the program's modules."""
DECLARATION = "NO_NUMBERS"
CODE = (".py", *EXTENSION_SUFFIXES)
"""Endings of files that Python imports."""
LONGEST = 200
"""Characters of a text that may name a data file."""
_DECLARED = ast.dump(ast.Name(DECLARATION, ast.Store()))
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


class Finder(Protocol):
    """A way to find files. Each has a name and a content."""

    def files(self, module: str) -> Iterable[tuple[str, bytes]]:
        """Return the files that an import of the module, or of a name in one, executes."""

    def data(self, file: str, text: str) -> tuple[str, bytes] | None:
        """Return the data file that a text in a source file names."""


def reach(finder: Finder, modules: Iterable[str]) -> dict[str, str]:
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
            waiting += [_absolute(one, name) for one in code.imports]
            for found in filter(None, (finder.data(name, text) for text in code.texts)):
                digests[found[0]] = hashlib.sha256(found[1]).hexdigest()
    return digests


def _absolute(module: str, file: str) -> str:
    """Return the module that a file imports, also where its name begins with dots. '' if it cannot exist."""
    if not module.startswith("."):
        return module
    try:
        return importlib.util.resolve_name(module, posixpath.dirname(file).replace("/", "."))
    except ImportError:
        return ""


@functools.cache
def read_code(source: bytes) -> Code:
    """Return the facts about a source file. A file that cannot be parsed imports nothing."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return Code(hashlib.sha256(source).hexdigest())
    declared = no_numbers(tree)
    lines, imports, texts = list[str](), list[str](), list[str]()
    for part in counted(tree, {DECLARATION, *([] if isinstance(declared, str) else declared)}):
        if not isinstance(part, ast.AST):
            lines.append(str(len(part)) if isinstance(part, list) else repr(part))
            continue
        lines.append(type(part).__name__)  # The class says how many parts follow.
        if isinstance(part, ast.Import):
            imports += [alias.name for alias in part.names]
        elif isinstance(part, ast.ImportFrom):
            module = "." * part.level + (f"{part.module}." if part.module else "")
            imports += [f"{module}{alias.name}" for alias in part.names]
        elif isinstance(part, ast.Constant) and isinstance(part.value, str) and "." in part.value[:LONGEST]:
            texts.append(part.value)
    digest = hashlib.sha256("\n".join(lines).encode(errors="surrogatepass")).hexdigest()
    names = tuple(text for text in texts if len(text) <= LONGEST and text.isprintable())
    return Code(digest, tuple(imports), names, not isinstance(declared, str))


def no_numbers(tree: ast.Module) -> str | dict[str, str]:
    """Return a module's declaration: reasons by place, or one reason for the whole module."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.dump(node.targets[0]) == _DECLARED:
            with suppress(ValueError):
                value = ast.literal_eval(node.value)
                return value if isinstance(value, str | dict) else {}
    return {}


def counted(tree: ast.Module, left_out: Collection[str]) -> Iterator[object]:
    """Yield the nodes, lists and values of a syntax tree, each before its parts.

    Docstrings, also those of fields, and the places that are left out are not among them.
    """
    part: object
    waiting: list[tuple[object, str]] = [(tree, "")]
    while waiting:
        part, place = waiting.pop()
        if isinstance(part, list):
            part = [one for one in part if not _is_left_out(one, left_out, place)]
            waiting += [(one, place) for one in reversed(part)]
        elif isinstance(part, ast.AST):
            inside = f"{place}{part.name}." if isinstance(part, _DEFINITIONS) else place
            waiting += [(getattr(part, name, None), inside) for name in reversed(part._fields)]
        yield part


def _is_left_out(part: object, left_out: Collection[str], place: str) -> bool:
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
    return any(f"{place}{name}" in left_out for name in names)


@dataclass(frozen=True)
class OfProgram:
    """A finder of this program's files. `contents`: one reading of them, by path."""

    contents: Mapping[str, bytes]

    def files(self, module: str) -> Iterable[tuple[str, bytes]]:
        parts = module.split(".")
        starts = ["/".join(parts[: i + 1]) for i in range(len(parts))]
        names = [name for start in starts for name in (f"{start}.py", f"{start}/__init__.py")]
        return [(name, self.contents[name]) for name in names if name in self.contents]

    def data(self, file: str, text: str) -> tuple[str, bytes] | None:
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
    digests = reach(finder, modules)
    files = [f"{plain(name)} {digest}" for name, digest in digests.items()]
    return Sources(sorted([*files, *finder.versions]), sorted(finder.program))


class OfOthers:
    """A finder of files outside this program. A package counts whole.

    The version of an installed package counts, with the versions of its requirements. Its files are not read.
    `versions`: of installed distributions. `program`: the modules of this program that were asked for.
    """

    def __init__(self) -> None:
        self.versions, self.program = set[str](), set[str]()
        self._seen = set[str]()
        self._folders = dict[str, Path]()

    def files(self, module: str) -> Iterable[tuple[str, bytes]]:
        top = module.partition(".")[0]
        if top in PROGRAM:
            self.program.add(module)
        elif top == PUBLIC:
            self.program |= _behind(module)
        elif top and top not in self._seen and top not in sys.stdlib_module_names:
            self._seen.add(top)
            for name, path in self._of_top(top):
                self._folders[name] = path.parent
                yield name, path.read_bytes()

    def data(self, file: str, text: str) -> tuple[str, bytes] | None:
        path = self._folders[file] / text
        if path.suffix in CODE or not path.is_file():
            return None
        return posixpath.join(posixpath.dirname(file), text), path.read_bytes()

    def _of_top(self, top: str) -> Iterator[tuple[str, Path]]:
        """Yield the files, with their names, of a module or package that no distribution has."""
        folders, origin = _place(top)
        alone = [Path(origin)] if origin and origin.endswith(CODE) and not folders else []
        installed = [place for place in (*folders, *alone) if _is_installed(place)]
        versions = packages.versions_of_module(top) if installed else {}
        self.versions |= {f"{name} {version}" for name, version in versions.items()}
        for place in folders:
            if not (versions and place in installed):
                yield from ((f"{top}/{path.relative_to(place).as_posix()}", path) for path in _code_in(place))
        yield from ((path.name, path) for path in alone if not (versions and path in installed))


def _behind(name: str) -> set[str]:
    """Return the modules of tasks and methods that a name of the public module comes from."""
    where = importlib.import_module(PUBLIC).WHERE
    asked = name.split(".")[1:2]
    modules = {where[one] for one in asked if one in where} or {*where.values()}
    return {module for module in modules if not module.startswith("harness")}


def _place(top: str) -> tuple[list[Path], str | None]:
    """Return the folders of a package, and the file of a module."""
    if (loaded := sys.modules.get(top)) is not None:
        folders, origin = getattr(loaded, "__path__", []), getattr(loaded, "__file__", None)
        return [Path(folder) for folder in folders], origin
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        spec = None
    return ([Path(one) for one in spec.submodule_search_locations or ()], spec.origin) if spec else ([], None)


def _code_in(folder: Path) -> Iterator[Path]:
    """Yield the code in a folder. Links to folders are followed, unless one leads back."""
    for at, folders, names in os.walk(folder, followlinks=True):
        here = f"{os.path.realpath(at)}/"
        folders[:] = sorted(
            name
            for name in folders
            if name != "__pycache__" and not here.startswith(f"{os.path.realpath(Path(at, name))}/")
        )
        yield from (
            Path(at, name) for name in sorted(names) if name.endswith(CODE) and Path(at, name).is_file()
        )


@functools.cache
def _places() -> tuple[Path, ...]:
    names = ("purelib", "platlib", "stdlib", "platstdlib")
    return tuple({Path(sysconfig.get_path(name)).resolve() for name in names})


def _is_installed(place: Path) -> bool:
    return any(place.resolve().is_relative_to(installed) for installed in _places())
