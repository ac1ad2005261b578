"""Keys: digests of all that can change a result, so that a stored result is used for no other request."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path

from harness.process import environment
from harness.records import CONTROL_METHODS, Cell, Conditions, Shown
from harness.registry import ours, packages, plugins
from harness.registry.known import KNOWN
from harness.registry.plugins import settings_for
from harness.registry.sources import OfProgram, Sources, reach, sources_of

NO_NUMBERS = "Its results are the keys themselves."

RUNNING = (
    *("harness.schedule.grid", "harness.store.store", "harness.cell.run", "harness.engines.ray"),
    *("harness.engines.processes", "harness.engines.preload"),
)
"""Modules that feed, start, compute and store cells."""
EXPERTS_MODULE = "harness.cell.shared"
"""The module that makes what cells share."""
CLONE = "bc"
"""The method that replaces an absent expert (`harness.cell.experts.NoExpert`)."""
SCORING = ("harness.judge.evaluation", "harness.rl.seeds")
"""Modules that score policies, and choose the episodes."""
REPORT_PACKAGES = ("matplotlib", "pandas", "jinja2")
"""Packages that decide, besides the program, how cells are reported."""
PUBLIC = f"{ours.PUBLIC}.py"
"""The file that gives plug-ins all of the program under one name."""
EXPERTS = ("results/reference/experts", "harness/shipped")
"""Folders of the shipped experts: in the repository, and where the package is installed."""
KINDS = ("py", "html.j2", "css", "js", "json", "csv", "npz", "safetensors")
"""Endings of the program's files, data files included."""
ROOT = ours.ROOT


@functools.cache
def program() -> dict[str, bytes]:
    """Return the program's files and the shipped experts, by path below `ROOT`, as they were first read.

    Keys are of this reading, and the processes of cells execute it whatever the files hold by then.
    """
    files = [file for folder in ours.PROGRAM for file in sorted((ROOT / folder).rglob("*")) if _is_ours(file)]
    files += [file for folder in EXPERTS for file in sorted((ROOT / folder).glob("*.safetensors"))]
    files.append(ROOT / PUBLIC)
    return {file.relative_to(ROOT).as_posix(): file.read_bytes() for file in files if file.is_file()}


def _is_ours(file: Path) -> bool:
    """Return whether the program owns a file. It does not own backups, hidden files and bytecode."""
    *folders, name = file.relative_to(ROOT).parts
    stem, _, kind = name.partition(".")
    return kind in KINDS and all(part.isidentifier() for part in (*folders, stem))


def expert_files(env: str) -> dict[str, bytes]:
    """Return the file of a task's shipped experts by its path below `ROOT`; empty where it has none."""
    entry = KNOWN.entries["env"].get(env)
    env = (entry and entry.experts) or env
    names = [f"{folder}/{env}.safetensors" for folder in EXPERTS]
    return {name: program()[name] for name in names if name in program()}


def experts_version(env: str) -> str:
    """Return eight hexadecimal digits of a task's shipped experts; '' where it has none."""
    digests = [
        f"{Path(name).name} {hashlib.sha256(data).hexdigest()}" for name, data in expert_files(env).items()
    ]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()[:8] if digests else ""


def cell_keys(cells: Iterable[Cell], conditions: Conditions, variables: Mapping[str, str]) -> dict[Cell, str]:
    """Return the key that each cell must have been computed under to count, 'TASK:METHOD'.

    TASK is a digest of all that the cells of a task share, METHOD one of the source and the settings of the
    cell's own method. Cells can be compared where TASK is the same.
    variables: `environment.numeric` variables of the processes that compute the cells.
    """
    more: list[object] = [_installed(), dict(variables)]

    @functools.cache
    def task(env: str) -> str:
        asked: list[object] = [_asked(conditions), experts_version(env)]
        running = [*RUNNING]
        asked += encoder_version(conditions.encoder)
        if conditions.experts == "none":
            asked += [_target("method", CLONE), settings_for(CLONE, env, conditions.budget)]
            running.append(KNOWN.entries["method"][CLONE].module)
        return _digest_of("env", env, running, [asked, more])

    @functools.cache
    def method(env: str, name: str, shown: Shown, dynamics: str) -> str:
        name = CONTROL_METHODS.get(name, name)
        asked = [name, settings_for(name, env, conditions.budget), _asked(shown), dynamics]
        return _digest_of("method", name, [], asked)

    return {c: f"{task(c.env)}:{method(c.env, c.method, c.shown, c.dynamics)}" for c in cells}


def encoder_version(encoder: str) -> list[str]:
    """Return what decides an encoder's features: its name and its source; nothing for a task's own."""
    module, _, attribute = encoder.partition(":")
    return [encoder, *(sources_of(module).digests if attribute else [])] if encoder else []


def task_version(env: str) -> str:
    """Return a digest of a task, its shipped experts, and the scoring of policies in it.

    Where it is the same, scores can be compared, whatever machine and packages they were computed with.
    """
    return _digest_of("env", env, SCORING, experts_version(env))


def expert_key(env: str, asked: object) -> str:
    """Return the key of a task's expert and what is made with it. asked: a value that JSON can hold."""
    return _digest_of("env", env, [EXPERTS_MODULE], [asked, _installed(), environment.of_this_process()])


def report_key(cells: object) -> str:
    """Return the key of a report: of the program, and of cells that JSON can hold."""
    files = {name: hashlib.sha256(data).hexdigest() for name, data in program().items()}
    shown_by = {name: digest for name, digest in files.items() if name.startswith("harness/")}
    return _digest([cells, shown_by, _installed(), packages.versions(REPORT_PACKAGES)])


def task_of(key: str) -> str:
    """Return the part of a cell's key that comparable cells share."""
    return key.partition(":")[0]


def method_of(key: str) -> str:
    """Return the part of a cell's key that is of its method alone."""
    return key.partition(":")[2]


def sources(*modules: str) -> dict[str, str]:
    """Return the digests of the program's files that numbers of these modules can come from, by path."""
    return reach(OfProgram(program()), modules)


def _asked(value: Conditions | Shown) -> dict[str, object]:
    """Return the fields without `record` and without defaults: a new field changes no key."""
    return {
        field.name: asked
        for field in dataclasses.fields(value)
        if (asked := getattr(value, field.name)) != field.default and field.name != "record"
    }


def _target(kind: str, name: str) -> str:
    """Return the place that the registry has for a name, '' where it is not known."""
    entry = KNOWN.entries[kind].get(name)
    return entry.target if entry else ""


def _installed() -> list[object]:
    return [platform.python_version(), packages.required()]


def _digest_of(kind: str, name: str, modules: Iterable[str], values: object) -> str:
    """Return a digest of a method or task, program modules, and values that JSON can hold."""
    target = _target(kind, name)
    others = plugins.sources(kind, name) if name in KNOWN.of_plugins(kind) else Sources()
    files = sources(*modules, *others.program, *filter(None, [target.partition(":")[0]]))
    if (entry := KNOWN.entries[kind].get(name)) and entry.needs:
        files |= packages.versions_of_module(entry.needs)
    return _digest([values, target, others.digests, files])


def _digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]
