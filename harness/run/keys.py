"""Keys: digests of all that can change a result, so that what is stored is never used for another one."""

from __future__ import annotations

import ast
import dataclasses
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import subprocess
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, cast

from harness.judge.results import CONTROL_METHODS, PROGRAM_NAME, Cell, Conditions, Shown
from harness.registry import ENVS, METHODS, PLUGINS, VARIANTS, BadInput, Entry
from harness.run import environment, packages, plugins
from harness.run.plugin_sources import Sources
from harness.run.plugins import settings_for

RUNNING = (
    *("harness.schedule.grid", "harness.store.store", "harness.cell.run", "harness.engines.ray"),
    *("harness.engines.processes", "harness.engines.preload"),
)
"""Modules that feed, start, compute and store cells."""
EXPERTS_MODULE = "harness.cell.shared"
"""The module that makes what cells share."""
CLONE = "bc"
"""Name of the method that replaces an absent expert (`harness.cell.experts.NoExpert`)."""
SCORING = ("harness.judge.evaluation", "harness.learn.seeds")
"""Modules that score policies, and choose the episodes."""
DECLARATION = "NO_NUMBERS"
"""Variable of a module that lists which of its places change no number. It holds one reason for the whole
module, or a reason by place, such as 'Class.method'."""
NO_NUMBERS = "It makes the keys themselves."
REPORT_PACKAGES = ("matplotlib", "pandas", "jinja2")
"""What decides, besides the program, how cells are reported."""
PACKAGES = (
    *("torch", "numpy", "scipy", "jax", "jaxlib", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
"""Packages whose versions a result names. Keys are of more of them (`harness.run.packages`)."""
MODULES = {
    **{
        "sbx-rl": "sbx",
        "tfp-nightly": "tensorflow_probability",
        "dm-tree": "tree",
        "pyyaml": "yaml",
        "absl-py": "absl",
    },
    **{"protobuf": "google.protobuf", "opt-einsum": "opt_einsum", "orbax-checkpoint": "orbax.checkpoint"},
}
"""Packages whose module has another name."""
PROGRAM = ("envs", "methods", "harness")
PUBLIC = "irl_bench.py"
"""The module that gives plug-ins all of those under one name."""
EXPERTS = ("results/reference/experts", "harness/shipped")
"""Where the shipped experts are: in the repository, and where the package is installed."""
ROOT = Path(__file__).parents[2]
_DECLARED = ast.dump(ast.Name(DECLARATION, ast.Store()))
_DEFINITIONS = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
INSTRUCTIONS = ("sse4", "avx", "fma", "amx")


@functools.cache
def program() -> dict[str, bytes]:
    """What Python can import of this program, the parts of the report's page and the shipped experts, by path
    below `ROOT`. Read once: keys are of this reading, and the cells' processes use it and not what the files
    hold by then."""
    files = [file for package in PROGRAM for file in sorted((ROOT / package).rglob("*")) if _counts(file)]
    files += [ROOT / PUBLIC] * (ROOT / PUBLIC).is_file()
    files += [file for folder in EXPERTS for file in sorted((ROOT / folder).glob("*.safetensors"))]
    names = {file.relative_to(ROOT).as_posix(): file for file in files}
    return {name: file.read_bytes() for name, file in names.items()}


def expert_files(env: str) -> dict[str, bytes]:
    """Return the file of a task's shipped experts by its path below `ROOT`; empty where it has none."""
    names = [f"{folder}/{env}.safetensors" for folder in EXPERTS]
    return {name: program()[name] for name in names if name in program()}


def experts_version(env: str) -> str:
    """Eight hexadecimal digits that whatever changes a task's shipped experts changes; '' where it has
    none."""
    digests = [
        f"{Path(name).name} {hashlib.sha256(data).hexdigest()}" for name, data in expert_files(env).items()
    ]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()[:8] if digests else ""


def _counts(file: Path) -> bool:
    *folders, name = file.relative_to(ROOT).parts
    stem, _, kind = name.partition(".")
    counts = kind in ("py", "html.j2", "css", "js")
    return counts and all(part.isidentifier() for part in (*folders, stem)) and file.is_file()


def cell_keys(cells: Iterable[Cell], conditions: Conditions, variables: Mapping[str, str]) -> dict[Cell, str]:
    """Return what each cell must have been computed under to count, 'TASK:METHOD'.

    TASK is a digest of all that the cells of an environment share, METHOD one of the source and the settings
    of the cell's own method. Cells can be compared where TASK is the same.
    variables: `environment.numeric` variables of the processes that compute the cells.
    """
    more = [_installed(), dict(variables)]
    tasks, methods = dict[str, str](), dict[tuple[str, str, Shown, str], str]()
    keys = {}
    for cell in cells:
        if cell.env not in tasks:
            asked = [_asked(conditions), experts_version(cell.env), _target(ENVS, cell.env)]
            others, clone = _of_others("env", cell.env), list[str]()
            if conditions.experts == "none":
                asked += [_target(METHODS, CLONE), settings_for(CLONE, cell.env, conditions.budget)]
                clone = _module(METHODS, CLONE)
            read = sources(*RUNNING, *clone, *_module(ENVS, cell.env), *others.program)
            tasks[cell.env] = _digest(read, asked, [*more, *others.digests])
        if (its := (cell.env, cell.method, cell.shown, cell.dynamics)) not in methods:
            method = CONTROL_METHODS.get(cell.method, cell.method)
            settings = settings_for(method, cell.env, conditions.budget)
            target = _target(METHODS | VARIANTS, method)
            asked = [method, target, settings, _asked(cell.shown), cell.dynamics]
            others = _of_others("method", method)
            read = sources(*_module(METHODS | VARIANTS, method), *others.program)
            methods[its] = _digest(read, asked, others.digests)
        keys[cell] = f"{tasks[cell.env]}:{methods[its]}"
    return keys


def task_version(env: str) -> str:
    """Of a task, its shipped experts, and how policies are scored in it. Where it is the same, scores can be
    compared, whatever machine and packages they were computed with."""
    asked, others = [experts_version(env), _target(ENVS, env)], _of_others("env", env)
    return _digest(sources(*SCORING, *_module(ENVS, env), *others.program), asked, others.digests)


def _asked(value: Conditions | Shown) -> dict[str, object]:
    """Its fields, without what is recorded and without those that have their default: one more of those
    changes no key."""
    return {
        field.name: told
        for field in dataclasses.fields(value)
        if (told := getattr(value, field.name)) != field.default and field.name != "record"
    }


def task_of(key: str) -> str:
    """The part of a cell's key that it shares with those it can be compared with."""
    return key.partition(":")[0]


def method_of(key: str) -> str:
    """The part of a cell's key that is of its method alone."""
    return key.partition(":")[2]


def expert_key(env: str, asked: object) -> str:
    """Of an environment's expert and what is made with it; asked: what JSON can hold."""
    variables = environment.of_this_process()
    others = _of_others("env", env)
    more = [_installed(), variables, *others.digests]
    return _digest(sources(EXPERTS_MODULE, *_module(ENVS, env), *others.program), asked, more)


def report_key(cells: object) -> str:
    """Of what a report is made of: the program, and cells that JSON can hold."""
    shown_by = {
        name: hashlib.sha256(data).hexdigest()
        for name, data in program().items()
        if name.startswith("harness/")
    }
    return _digest((), [cells, shown_by], [_installed(), versions(REPORT_PACKAGES)])


def sources(*modules: str) -> set[str]:
    """Return the files of the program that importing these modules reads. Files that change no number, by
    their `DECLARATION`, are left out."""
    found: set[str] = set()
    waiting = [name for module in modules for name in _files_of(module)]
    while waiting:
        name = waiting.pop()
        if name not in found and (code := _code(program()[name])).counts:
            found.add(name)
            waiting += [n for module in code.imports for n in _files_of(module)]
    return found


def _files_of(module: str) -> list[str]:
    """The files of the program that importing `module`, which may be a name in one, reads first."""
    parts = module.split(".")
    starts = ["/".join(parts[: i + 1]) for i in range(len(parts))]
    return [name for start in starts for name in (f"{start}.py", f"{start}/__init__.py") if name in program()]


class Code(NamedTuple):
    """Digest and imports of a file.

    imports: modules, and names in modules, lazy ones too. counts: whether the file can change a number.
    """

    digest: str
    imports: tuple[str, ...] = ()
    counts: bool = True


def counted(tree: ast.Module, left_out: Collection[str]) -> Iterator[object]:
    """Yield the nodes, lists and values of a syntax tree, each before its parts. Docstrings, those of fields
    included, and the places that are left out are not among them."""
    part: object
    waiting: list[tuple[object, str]] = [(tree, "")]
    while waiting:
        part, place = waiting.pop()
        if isinstance(part, list):
            part = [one for one in part if not _is_left_out(one, left_out, place)]
            waiting += [(one, place) for one in reversed(part)]
        elif isinstance(part, ast.AST):
            inside = f"{place}{part.name}." if isinstance(part, _DEFINITIONS) else place
            waiting += [(getattr(part, field, None), inside) for field in reversed(part._fields)]
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


@functools.cache
def _code(source: bytes) -> Code:
    """Return what a file does, without its comments. A file that cannot be parsed imports nothing."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return Code(hashlib.sha256(source).hexdigest())
    declared = no_numbers(tree)
    places = {} if isinstance(declared, str) else declared
    said, imports = list[str](), list[str]()
    for part in counted(tree, {DECLARATION, *places}):
        if isinstance(part, ast.AST):  # whose class tells how many parts follow
            said.append(type(part).__name__)
            if isinstance(part, ast.Import):
                imports += [alias.name for alias in part.names]
            elif isinstance(part, ast.ImportFrom):
                imports += [f"{part.module}.{alias.name}" for alias in part.names]
        else:
            said.append(str(len(part)) if isinstance(part, list) else repr(part))
    digest = hashlib.sha256("\n".join(said).encode()).hexdigest()
    return Code(digest, tuple(imports), not isinstance(declared, str))


def no_numbers(tree: ast.Module) -> str | dict[str, str]:
    """Return what a module declares under the name `DECLARATION`: reasons by place, none where it declares
    nothing; or the reason for the whole module."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.dump(node.targets[0]) == _DECLARED:
            return cast("str | dict[str, str]", ast.literal_eval(node.value))
    return {}


def _target(known: Mapping[str, Entry], name: str) -> str:
    """What the registry says it is, '' where it is not known."""
    return known[name].target if name in known else ""


def _module(known: Mapping[str, Entry], name: str) -> list[str]:
    """Where it is, if it is known."""
    return [_target(known, name).partition(":")[0]] if name in known else []


def _of_others(kind: str, name: str) -> Sources:
    """What the numbers of the plug-in come from that has the method or environment, if one has it."""
    if name not in PLUGINS[kind]:
        return Sources([], [])
    found = plugins.sources(kind, name)
    if kind == "env":
        needed = plugins.packages_of_task(name)
        found = dataclasses.replace(found, digests=[*found.digests, json.dumps(needed)])
    return found


def _installed() -> list[object]:
    return [platform.python_version(), packages.required(), _elsewhere()]


def _digest(sources: Iterable[str], ingredients: object, more: object) -> str:
    """Of what these files do, and of what JSON can hold."""
    digests = {name: _code(program()[name]).digest for name in sources}
    everything = json.dumps([ingredients, digests, more], sort_keys=True)
    return hashlib.sha256(everything.encode()).hexdigest()[:16]


@functools.cache
def origin() -> dict[str, str]:
    """What this process computes with, for people: of `machine`, and the program's version."""
    return machine() | {PROGRAM_NAME: _commit()}


def machine() -> dict[str, str]:
    """The processor, the system and the versions that this process computes with."""
    system = f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip()
    return {
        **_processor(),
        "system": system,
        PROGRAM_NAME: "",
        "python": platform.python_version(),
        **dict(zip(PACKAGES, versions(PACKAGES), strict=True)),
    }


def versions(names: Iterable[str]) -> list[str]:
    """Return the versions of installed packages. Raises BadInput where one is not, or only in part."""
    found = []
    for name in names:
        if not (version := packages.version_of(name)):
            raise BadInput(f"the package {name} is not installed, or only in part; install it again")
        found.append(version)
    return found


@functools.cache
def _elsewhere() -> dict[str, str]:
    """Return the required packages whose module is not imported from where they are installed, such as
    through PYTHONPATH, and its file: their version says nothing of it."""
    found = {}
    for package, version in packages.required().items():
        name, spec = MODULES.get(package, package.replace("-", "_")), None
        with suppress(ImportError, ValueError):
            spec = importlib.util.find_spec(name)
        if version and spec and spec.origin:  # else its module has another name, or it is a namespace
            installed = Path(str(importlib.metadata.distribution(package).locate_file("")))
            if not Path(spec.origin).resolve().is_relative_to(installed.resolve()):
                found[package] = spec.origin
    return found


def _processor() -> dict[str, str]:
    """What libraries choose their instructions by. Processors of one name differ in it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    except OSError:  # not on Linux
        return {"processor": platform.processor()}
    facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    model = [facts.get(name, "?") for name in ("cpu family", "model", "stepping")]
    flags = [flag for flag in facts.get("flags", "").split() if flag.startswith(INSTRUCTIONS)]
    return {
        "processor": facts.get("model name", platform.machine()),
        "family, model, stepping": " ".join(model),
        "instructions": " ".join(sorted(flags)),
    }


def _commit() -> str:
    """The program's version and, where it runs from its repository, the commit, with a + where files of the
    program differ from it."""
    version = importlib.metadata.version("irl-bench")
    git = ["git", "-C", str(ROOT)]
    try:
        ask = functools.partial(subprocess.run, check=True, capture_output=True, text=True, timeout=10)
        commit = ask([*git, "rev-parse", "--short=10", "HEAD"]).stdout.strip()
        changed = ask([*git, "status", "--porcelain", "--", *PROGRAM, PUBLIC, *EXPERTS[:1]]).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} ({commit}{'+' if changed else ''})"
