"""Methods and environments of others: of files and modules that `--plugin` names, of installed packages that
say so in their metadata, and tasks of Gymnasium by their id alone.

A plug-in's module says `METHODS = {"mine": Mine}`, dataclasses as of `methods.base.Method`, or
`ENVS = {"task": SPEC}`, of `envs.EnvSpec`, or both. A package's metadata names single ones, as entry points
of the groups `irl_bench.methods` and `irl_bench.envs`; those are imported when they are asked for.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.metadata
import importlib.util
import inspect
import json
import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from harness.registry import (
    BUILT_IN,
    ENVS,
    GROUPS,
    GYMNASIUM_NAME,
    PLUGINS,
    SPECS,
    VARIANTS,
    BadInput,
    Entry,
    load_method,
)
from harness.run import packages
from harness.run.plugin_sources import Sources, sources_of

if TYPE_CHECKING:
    from envs import EnvSpec

VARIABLE = "IRL_BENCH_PLUGINS"
"""Tells the processes of cells which plug-ins were named, and where they are."""
ENTRY_POINTS = {"method": "irl_bench.methods", "env": "irl_bench.envs"}
TABLES = {"method": "METHODS", "env": "ENVS"}
"""What a plug-in's module calls its methods and its environments."""
GYMNASIUM = "gym:"
"""Before the id of a task of Gymnasium, where environments are named."""
FILE_MODULE = "irl_bench_plugin_"
"""How the names of modules begin that are made of files."""
_read: dict[str, bytes] = {}
"""What files were when they were read, by the name of their module."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]{0,59}")
READ = "plugins"
"""The page about them."""


def add(named: Sequence[str]) -> None:
    """Makes known what plug-ins, each a file or a module, name, here and in the processes of cells. Raises
    BadInput for a broken one."""
    told = _told()
    for name in named:
        with _its_troubles(f"the plug-in {name} cannot be loaded"):
            if not name.endswith(".py") and Path(name).is_file():
                raise BadInput(f"the plug-in {name} is a file whose name does not end in .py")
            module = (
                _of_file(Path(name).absolute()) if name.endswith(".py") else importlib.import_module(name)
            )
            _add(module, name)
        file = str(module.__file__ or "")
        told.append([name, file] if name.endswith(".py") else [name, _folder_of(module)])
    if named:
        os.environ[VARIABLE] = json.dumps(told)


def add_installed() -> list[str]:
    """Makes known what installed packages name. Why some of that cannot be used."""
    troubles = []
    for kind, group in ENTRY_POINTS.items():
        try:
            points = sorted(importlib.metadata.entry_points(group=group))
        except Exception as error:  # of a package whose metadata is damaged
            return [f"what installed packages name cannot be read: {_in_words(error)}"]
        for point in points:
            package = f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown package"
            try:
                _register(kind, point.name, Entry(point.value, f"of the package {package}"))
            except BadInput as error:
                troubles.append(f"{package}: {error}")
    return troubles


def add_task(env_id: str) -> str:
    """Makes a task of Gymnasium known; its name here. Raises BadInput where that cannot be one."""
    name = f"{GYMNASIUM_NAME}{env_id.replace('/', '+')}"
    if not env_id or not NAME.fullmatch(name) or "__" in name:
        raise BadInput(f"{env_id[:80]!r} is no id of Gymnasium that can be used: letters, digits, - and _")
    entry = Entry(f"{__name__}:gymnasium/{env_id}", f"Gymnasium's {env_id}")
    ENVS[name] = PLUGINS["env"][name] = entry
    return name


def task_or_name(name: str) -> str:
    """The name of an environment that may be given as 'gym:ID', or as such a task is called in a run, and is
    then known. Raises BadInput as `add_task` does."""
    if name.startswith(GYMNASIUM_NAME):
        return add_task(name.removeprefix(GYMNASIUM_NAME).replace("+", "/"))
    return add_task(name.removeprefix(GYMNASIUM)) if name.startswith(GYMNASIUM) else name


def in_cells(envs: Sequence[str]) -> None:
    """Makes known, in a process of cells, what the run that it is of knows. Raises BadInput as `add` does."""
    for name, place in _told():
        if name.endswith(".py"):
            _add(_of_file(Path(place)), name)
        else:
            sys.path += [place] if place not in sys.path else []
            _add(importlib.import_module(name), name)
    add_installed()
    for env in envs:
        task_or_name(env)


def packed(folder: Path) -> dict[str, str]:
    """Copies the plug-ins that were named into the folder, for another machine; the environment variables
    that tell `unpack` there."""
    told = []
    for i, (name, place) in enumerate(_told()):
        at = Path("plugins") / str(i)
        (folder / at).mkdir(parents=True)
        source = Path(place)
        if not name.endswith(".py"):
            source /= name.partition(".")[0]
            source = source if source.is_dir() else source.with_suffix(".py")
        if source.is_dir():
            shutil.copytree(source, folder / at / source.name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / at)
        told.append([name, str(at / source.name if name.endswith(".py") else at)])
    return {VARIABLE: json.dumps(told)} if told else {}


def unpack() -> None:
    """Takes the plug-ins from this process's folder, into which they were `packed`."""
    if told := _told():
        os.environ[VARIABLE] = json.dumps([[name, str(Path(place).absolute())] for name, place in told])


def load(methods: Sequence[str], envs: Sequence[str]) -> None:
    """Imports those of these that are plug-ins', and tries tasks out. Raises BadInput where one is broken."""
    for kind, names in (("method", methods), ("env", envs)):
        for name in names:
            if name in PLUGINS[kind]:
                with _its_troubles(f"the {kind} {name} cannot be loaded"):
                    _check(kind, name, load_method(name) if kind == "method" else SPECS[name])
                    if kind == "env":
                        from envs.copies import try_out

                        try_out(SPECS[name])


def sources(target: str) -> Sources:
    """What the numbers of a plug-in's object, by its target, come from, as it is now."""
    module, _, rest = target.partition(":")
    if module == __name__:
        return _sources_of_task(rest.partition("/")[2])
    if module not in sys.modules:
        importlib.import_module(module)
    return sources_of(module)


def _sources_of_task(env_id: str) -> Sources:
    """Of a task of Gymnasium, and what it is registered with. Raises BadInput where that cannot be told."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    entry = spec.entry_point
    found = sources_of(_module_of(entry))
    registered = {
        "entry": str(entry),
        "kwargs": spec.kwargs,
        "wrappers": [str(wrapper) for wrapper in spec.additional_wrappers],
        "max_episode_steps": spec.max_episode_steps,
    }
    try:
        told = json.dumps(registered, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"{env_id} is registered with arguments that are neither numbers nor texts ({error}); name it by "
            "an EnvSpec of a plug-in",
            READ,
        ) from error
    return dataclasses.replace(found, digests=[*found.digests, told])


def packages_of_task(env_id: str) -> dict[str, str]:
    """Return the versions of the packages that a registered task of Gymnasium needs (`packages.imported`)."""
    import gymnasium

    return packages.imported(_module_of(gymnasium.spec(env_id).entry_point))


def _module_of(entry: object) -> str:
    """The module of what a task is registered with."""
    return entry.partition(":")[0] if isinstance(entry, str) else str(getattr(entry, "__module__", ""))


class _Gymnasium(dict[str, "EnvSpec"]):
    """Specs by the ids of Gymnasium."""

    def __missing__(self, env_id: str) -> EnvSpec:
        from gymnasium import registry

        from envs import from_gymnasium

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that there is a newer version of the task
            found = from_gymnasium(env_id, f"{GYMNASIUM_NAME}{env_id.replace('/', '+')}")
        if env_id not in registry:  # of which the latest version was made
            raise BadInput(f"{env_id} names no version of the task; give its whole id, such as {env_id}-v1")
        self[env_id] = found
        return found


gymnasium = _Gymnasium()
"""Tasks of Gymnasium by their id, derived when one is asked for."""


def _told() -> list[list[str]]:
    found: list[list[str]] = json.loads(os.environ.get(VARIABLE, "[]"))
    return found


def _add(module: ModuleType, name: str) -> None:
    if not any(hasattr(module, table) for table in TABLES.values()):
        raise BadInput(f"the plug-in {name} says neither METHODS nor ENVS", READ)
    for kind, table in TABLES.items():
        things = getattr(module, table, {})
        if not isinstance(things, Mapping):
            raise BadInput(f"the plug-in {name}: {table} must be a dict of what it has, by name", READ)
        for its_name, thing in things.items():
            _check(kind, its_name, thing)
            _register(kind, its_name, Entry(f"{module.__name__}:{table}/{its_name}", f"of {name}"))


def _of_file(path: Path) -> ModuleType:
    """The module that the file is, read anew where it has changed since."""
    name = FILE_MODULE + re.sub(r"\W", "_", path.stem)
    path = Path(os.path.normpath(path))
    known = sys.modules.get(name)
    if known and known.__file__ != str(path):
        raise BadInput(f"two plug-ins are called {path.name}; rename one")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise BadInput(f"there is no plug-in {path}", READ)
    content = path.read_bytes()
    if known and _read.get(name) == content:
        return known
    for env in [env for env, entry in PLUGINS["env"].items() if entry.target.startswith(f"{name}:")]:
        SPECS.pop(env, None)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        exec(compile(content, path, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    _read[name] = content
    return module


def _folder_of(module: ModuleType) -> str:
    """Where Python must look to import it."""
    top = sys.modules[module.__name__.partition(".")[0]]
    place = next(iter(getattr(top, "__path__", [])), None) or top.__file__
    return str(Path(str(place)).absolute().parent)


def _check(kind: str, name: object, thing: object) -> None:
    """Raises BadInput unless the object can be a method, or a task of that name."""
    from envs import EnvSpec

    if kind == "method" and not (isinstance(thing, type) and callable(getattr(thing, "fit", None))):
        raise BadInput(f"the method {name} must be a class with a method fit, not {thing!r:.60}", READ)
    if kind == "method" and (needed := _without_default(thing)):
        raise BadInput(f"the method {name} has no default for {', '.join(needed)}", READ)
    if kind == "env" and not (isinstance(thing, EnvSpec) and thing.name == name):
        raise BadInput(f"the env {name} must be an EnvSpec of that name, not {thing!r:.60}", READ)


def _without_default(method: Any) -> list[str]:
    """Names of what a method cannot be made without."""
    try:
        parameters = inspect.signature(method).parameters.values()
    except ValueError:  # of what tells none
        return []
    named = [one for one in parameters if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)]
    return [one.name for one in named if one.default is one.empty]


def _register(kind: str, name: object, entry: Entry) -> None:
    """Raises BadInput for a name that cannot be used, or is another's."""
    if not isinstance(name, str) or not NAME.fullmatch(name) or "__" in name:
        raise BadInput(f"{name!r:.80} is no name of {kind}s: up to 60 letters, digits, - and single _")
    taken = name in BUILT_IN[kind] or name in {"all", "plugins", "reference", "expert", *GROUPS}
    if taken or name.startswith(("control_", GYMNASIUM_NAME)):
        raise BadInput(f"no plug-in may name its {kind} {name!r}: the name is this program's")
    known = PLUGINS[kind]
    if known.get(name, entry).target != entry.target:
        raise BadInput(f"two plug-ins name a {kind} {name!r}: {known[name].summary}, and {entry.summary}")
    known[name] = entry
    (VARIANTS if kind == "method" else ENVS)[name] = entry


@contextmanager
def _its_troubles(what: str) -> Iterator[None]:
    """Whatever a plug-in raises is BadInput, and what it prints goes to standard error."""
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (BadInput, KeyboardInterrupt):
        raise
    except ModuleNotFoundError as error:
        hint = "; a plug-in of several files is named as a module that Python can import"
        raise BadInput(f"{what}: {_in_words(error)}{hint}", READ) from error
    except BaseException as error:
        raise BadInput(f"{what}: {_in_words(error)}", READ) from error


def _in_words(error: BaseException) -> str:
    try:
        said = str(error)
    except BaseException:
        said = "(no words)"
    return " ".join(f"{type(error).__name__}: {said}".split())[:300]
