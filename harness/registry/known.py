"""The registry: every method and task that is known by a name, built-in ones and those of plug-ins."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

from harness.registry import configured
from harness.registry.built_in import (
    BUILT_IN,
    ENVS,
    GROUPS,
    METHOD_GROUPS,
    METHODS,
    OTHER_ENVS,
    VARIANTS,
    Entry,
)
from harness.registry.configured import Search
from harness.registry.names import BadInput, base, choose
from harness.registry.ours import PROGRAM
from harness.registry.sources import Sources, sources_of

if TYPE_CHECKING:
    from envs import EnvSpec
    from methods.base import Method

FILE_MODULE = "irl_bench_plugin_"
"""Beginning of the names of modules that are made of files."""
GYMNASIUM_NAME = "gym_"
"""Beginning of the names of tasks that are known by their id in Gymnasium."""
GYMNASIUM_MODULE = "harness.registry.gymnasium_tasks"
"""The module of those tasks' entries, whose attribute is the id."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]{0,59}")


@dataclass(frozen=True)
class Plugin:
    """A plug-in as it was named. `place`: the file, or the folder where Python finds the module."""

    name: str
    place: str

    @property
    def is_file(self) -> bool:
        return self.name.endswith(".py")

    @property
    def module(self) -> str:
        return FILE_MODULE + re.sub(r"\W", "_", Path(self.place).stem) if self.is_file else self.name


@dataclass(frozen=True)
class Offer:
    """Facts about a plug-in's method or task, without the object.

    `like`: the built-in methods whose class a method has, or derives from.
    `takes`: the hyper-parameters that it takes from their settings. `searched`: those that `tune` searches.
    `variants`, `discrete`, `rl_steps`, `ddpg_steps`, `solves`, `encoder`: fields of a task's `EnvSpec`.
    `sources`: those of its module, and of the modules and packages in which Gymnasium finds a task.
    """

    kind: str
    name: str
    target: str
    summary: str
    sources: Sources
    like: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    discrete: bool = False
    rl_steps: dict[str, int] = field(default_factory=dict)
    ddpg_steps: dict[str, int] = field(default_factory=dict)
    solves: dict[str, int] = field(default_factory=dict)
    encoder: str = ""
    searched: dict[str, Search] = field(default_factory=dict)


@dataclass(frozen=True)
class Loaded:
    """A module that was imported in this process. `sources`: its sources then.

    `is_plugin`: whether it defines methods or tasks; else a task is registered with it.
    """

    module: ModuleType
    sources: Sources
    is_plugin: bool

    @property
    def is_current(self) -> bool:
        """True unless the module or a source of it was replaced since."""
        name = self.module.__name__
        with suppress(OSError):
            return sys.modules.get(name) is self.module and sources_of(name) == self.sources
        return False


def id_of(entry: Entry) -> str:
    """Return the id in Gymnasium of a task that is known by it, '' for all others."""
    return entry.target.partition(":")[2].partition(" ")[0] if entry.module == GYMNASIUM_MODULE else ""


class Specs(dict[str, "EnvSpec"]):
    """Tasks by name, each imported when it is asked for."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry

    def __missing__(self, name: str) -> EnvSpec:
        entry = self._registry.entries["env"][name]
        if id_of(entry):
            self[name] = importlib.import_module(GYMNASIUM_MODULE).derived(entry, name)
        else:
            self[name] = cast("EnvSpec", self._registry.imported(entry))
        return self[name]


class Registry:
    """Methods and tasks by name, with all that is known of plug-ins.

    `entries`: by kind ('method' or 'env') and name. `specs`: tasks by name.
    `plugins`: those that were named, by module. `offers`: facts that another process reported, by target.
    `loaded`: plug-ins' modules that this process imported.
    `registered`: plug-ins' modules, by the ids in Gymnasium that they register.
    `env_kwargs`: arguments, as JSON, of tasks that are known by their id; '' for none.
    `variables`: variables of the environment that the user passes to plug-ins.
    """

    def __init__(self) -> None:
        self.entries: dict[str, dict[str, Entry]] = {"method": METHODS | VARIANTS, "env": ENVS | OTHER_ENVS}
        self.specs = Specs(self)
        self.plugins: dict[str, Plugin] = {}
        self.offers: dict[str, Offer] = {}
        self.loaded: list[Loaded] = []
        self.registered: dict[str, str] = {}
        self.env_kwargs = ""
        self.variables: dict[str, str] = {}

    @contextmanager
    def for_now(self) -> Iterator[None]:
        """Forget, as the context ends, the plug-ins that were added in it; imported modules stay so."""
        tables: list[dict[str, Any]] = [*self.entries.values(), self.plugins, self.offers]
        tables += [self.registered, self.variables]
        before, kwargs = [dict(table) for table in tables], self.env_kwargs
        try:
            yield
        finally:
            for table, entries in zip(tables, before, strict=True):
                table.clear()
                table.update(entries)
            self.env_kwargs = kwargs
            for name in self.specs.keys() - self.entries["env"].keys():
                del self.specs[name]

    def of_plugins(self, kind: str) -> dict[str, Entry]:
        """Return the entries that are not this program's own."""
        own = BUILT_IN[kind]
        return {name: entry for name, entry in self.entries[kind].items() if _plain(kind, name) not in own}

    def chosen_methods(self, text: str) -> tuple[str, ...]:
        """Return the methods in a text with commas between, and make known those with settings.

        Raises BadInput as `choose` and `configure` do.
        """
        known = self.entries["method"]
        names = [name if base(name) in known else base(name) for name in configured.names_in(text)]
        mine = tuple(dict.fromkeys(name for name in names if self.configure(name)))
        theirs = tuple(name for name in self.of_plugins("method") if base(name) == name)
        groups = {**METHOD_GROUPS, "plugins": theirs}
        return choose("method", ",".join(names), METHODS, (*VARIANTS, *theirs, *mine), groups)

    def chosen_envs(self, text: str) -> tuple[str, ...]:
        """Return the tasks in a text with commas between. Raises BadInput as `choose` does."""
        theirs = tuple(self.of_plugins("env"))
        return choose("env", text, ENVS, (*OTHER_ENVS, *theirs), {**GROUPS, "plugins": theirs})

    def configure(self, name: str) -> bool:
        """Make known a method with settings of the user's, and return whether the name is of one.

        Raises BadInput for settings that a built-in method cannot have. Those of a plug-in's are checked
        where that is imported.
        """
        method, known = base(name), self.entries["method"]
        if method == name or method not in known:
            return False
        if name not in known:
            entry, settings = known[method], configured.settings_in(name)
            if method in BUILT_IN["method"] or entry.module in sys.modules:
                configured.typed(method, self.imported(entry), settings)
            said = ", ".join(f"{field}={value}" for field, value in settings.items())
            known[name] = entry._replace(summary=f"{method} with {said}")
        return True

    def register(self, kind: str, name: object, entry: Entry) -> None:
        """Add a plug-in's method or task. Raises BadInput for a name that is taken or cannot be used."""
        usable = isinstance(name, str) and NAME.fullmatch(name) and "__" not in name
        if not isinstance(name, str) or not usable or _plain(kind, name) != name:
            raise BadInput(f"{name!r:.80} is no name of {kind}s: up to 60 letters, digits, - and single _")
        taken = name in BUILT_IN[kind] or name in {
            "all",
            "plugins",
            "reference",
            "expert",
            *GROUPS,
            *METHOD_GROUPS,
        }
        if taken or name.startswith("control_") or (name.startswith(GYMNASIUM_NAME) and not id_of(entry)):
            raise BadInput(f"no plug-in may name its {kind} {name!r}: the name is this program's")
        known = self.entries[kind].setdefault(name, entry)
        if known.target != entry.target:
            raise BadInput(f"two plug-ins name a {kind} {name!r}: {known.summary}, and {entry.summary}")
        self.entries[kind][name] = entry

    def add(self, plugin: Plugin) -> None:
        """Add a plug-in, and forget what it named before. A file that was edited is executed anew."""
        for table in self.entries.values():
            for name in [name for name, entry in table.items() if entry.module == plugin.module]:
                self.offers.pop(table.pop(name).target, None)
                self.specs.pop(name, None)
        there = sys.modules.get(plugin.module)
        if plugin.is_file and not any(one.module is there and one.is_current for one in self.loaded):
            sys.modules.pop(plugin.module, None)
        self.plugins[plugin.module] = plugin

    def module(self, name: str, is_plugin: bool = True) -> ModuleType:
        """Return a module, imported now. Plug-ins' modules are noted with their sources."""
        plugin = self.plugins.get(name)
        if name not in sys.modules and plugin and plugin.is_file:
            module = _executed(name, plugin.place)
        else:
            module = importlib.import_module(name)
        if name.partition(".")[0] not in PROGRAM and all(one.module is not module for one in self.loaded):
            self.loaded.append(Loaded(module, sources_of(name), is_plugin))
        return module

    def imported(self, entry: Entry) -> object:
        """Return the object of an entry, 'module:attribute' or its item 'module:attribute/key'."""
        attribute, _, key = entry.target.partition(":")[2].partition("/")
        thing = getattr(self.module(entry.module), attribute)
        return thing[key] if key else thing

    def thing(self, kind: str, name: str) -> Any:
        """Return a method's class, or instance, or a task's `EnvSpec`."""
        return self.imported(self.entries["method"][name]) if kind == "method" else self.specs[name]


def _plain(kind: str, name: str) -> str:
    return base(name) if kind == "method" else name


def _executed(name: str, file: str) -> ModuleType:
    """Return a new module made of a file, whose folder can be imported from, after all others.

    Python's own import could take stale bytecode for its content.
    """
    if (folder := str(Path(file).parent)) not in sys.path:
        sys.path.append(folder)
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = file
    try:
        exec(compile(Path(file).read_bytes(), file, "exec"), module.__dict__)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    return module


KNOWN = Registry()
"""The registry of this process."""
SPECS = KNOWN.specs


def all_specs() -> list[EnvSpec]:
    """Return every task of this program, in the order of `BUILT_IN`."""
    return [SPECS[name] for name in BUILT_IN["env"]]


def load_method(name: str) -> Callable[..., Method]:
    """Return a method's dataclass, imported now, or a function that returns a plug-in's instance with other
    settings. Raises BadInput for an unknown name."""
    if name not in KNOWN.entries["method"]:
        KNOWN.chosen_methods(name)
        raise BadInput(f"{name!r} is not one method")
    thing = KNOWN.thing("method", name)
    return thing if isinstance(thing, type) else partial(replace, thing)
