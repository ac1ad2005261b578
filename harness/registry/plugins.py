"""Plug-ins: methods and tasks of files and modules that a user names, and of installed packages.

A plug-in's module says `METHODS = {"mine": Mine}`, dataclasses as of `methods.base.Method`, or
`ENVS = {"task": SPEC}`, of `envs.EnvSpec`, or both. A package's metadata names single ones, as entry points
of the groups `irl_bench.methods` and `irl_bench.envs`. Those are imported when they are asked for.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness.process import environment
from harness.registry import configured, gymnasium_tasks, loading
from harness.registry.built_in import BUILT_IN, Entry
from harness.registry.configured import Search
from harness.registry.gymnasium_tasks import as_json, module_in, task_or_name
from harness.registry.known import (
    FILE_MODULE,
    GYMNASIUM_NAME,
    KNOWN,
    SPECS,
    Offer,
    Plugin,
    id_of,
    load_method,
)
from harness.registry.loading import READ
from harness.registry.names import BadInput, base
from harness.registry.sources import Sources
from methods import settings

if TYPE_CHECKING:
    from envs import EnvSpec
    from methods.base import Method

ENTRY_POINTS = {"method": "irl_bench.methods", "env": "irl_bench.envs"}


def add(named: Sequence[str], asked: Sequence[str] = ()) -> list[str]:
    """Make known what plug-ins name, each a file or a module, and what installed packages name.

    Return why some of the latter cannot be used. Plug-ins are imported in a process of their own.
    asked: names with commas between. Methods and tasks of packages that have these names are imported there,
    too. Raises BadInput for what is broken.
    """
    new = dict[str, Plugin]()
    names = {name for text in asked for name in configured.names_in(text)}
    words = names | {*map(base, names)}
    theirs = sorted(name for name in names if base(name) not in (name, *BUILT_IN["method"]))
    for one in map(plugin, [*named, *filter(None, map(module_in, sorted(words)))]):
        other = new.get(one.module) or KNOWN.plugins.get(one.module)
        if other and other.place != one.place:
            raise BadInput(f"two plug-ins are called {Path(one.name).name}; rename one")
        new[one.module] = one
    points, problems = _installed()
    wanted = [
        (kind, name, entry)
        for kind, name, entry in points
        if words & {name, "plugins"} and name not in BUILT_IN[kind] and entry.target not in KNOWN.offers
    ]
    wanted += _by_id(words)
    offers = loading.in_a_process([*new.values()], wanted, theirs) if new or wanted else []
    for one in new.values():
        KNOWN.add(one)
    for offer in offers:
        if (offer.kind, offer.name) not in [point[:2] for point in wanted]:
            KNOWN.register(offer.kind, offer.name, Entry(offer.target, offer.summary, offer.variants))
    KNOWN.offers.update({offer.target: offer for offer in offers})
    for kind, name, entry in points:
        variants = KNOWN.offers[entry.target].variants if entry.target in KNOWN.offers else ()
        try:
            KNOWN.register(kind, name, entry._replace(variants=variants))
        except BadInput as error:
            problems.append(f"{entry.summary.removeprefix('of the package ')}: {error}")
    return problems


def _by_id(words: Iterable[str]) -> list[loading.Wanted]:
    """Return the tasks that are named by their id in Gymnasium."""
    names = [name for name in map(task_or_name, sorted(words)) if name.startswith(GYMNASIUM_NAME)]
    for name in names:
        KNOWN.specs.pop(name, None)
    return [("env", name, KNOWN.entries["env"][name]) for name in names]


def give(kwargs: Mapping[str, Any], variables: Sequence[str]) -> None:
    """Set the arguments of tasks that are known by their id, and variables that plug-ins get, by name.

    Raises BadInput as `as_json`, and for variables that are not set, or that cells have already.
    """
    KNOWN.env_kwargs = as_json(kwargs)
    for name in variables:
        if environment.is_set_for_cells(name):
            raise BadInput(f"cells have {name} already, or set it themselves: leave out --env-var {name}")
        if name not in os.environ:
            raise BadInput(
                f"--env-var {name}: the environment has no such variable; set it before the command, and "
                "give its name alone"
            )
    KNOWN.variables |= {name: os.environ[name] for name in variables}


def plugin(name: str) -> Plugin:
    """Return a plug-in with its place, without executing it. Raises BadInput if it does not exist."""
    if name.endswith(".py"):
        path = os.path.join(os.path.realpath(Path(name).parent), Path(name).name)  # the link, not its target
        if not os.path.isfile(path):
            raise BadInput(f"there is no plug-in {path}", READ)
        return Plugin(name, path)
    if Path(name).is_file():
        raise BadInput(f"the plug-in {name} is a file whose name does not end in .py")
    spec = None
    with suppress(ImportError, ValueError):
        spec = importlib.util.find_spec(name.partition(".")[0])
    places = [*(spec.submodule_search_locations or [spec.origin or ""])] if spec else []
    return Plugin(name, str(Path(places[0]).absolute().parent) if places else "")


def _installed() -> tuple[list[loading.Wanted], list[str]]:
    """Return what installed packages name, by kind and name, and why that cannot be read."""
    entries: list[loading.Wanted] = []
    try:
        points = importlib.metadata.entry_points()
    except Exception as error:  # A package's metadata may be damaged.
        return entries, [f"what installed packages name cannot be read: {loading.in_words(error)}"]
    for kind, group in ENTRY_POINTS.items():
        for point in sorted(points.select(group=group)):
            package = f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown package"
            entries.append((kind, point.name, Entry(point.value, f"of the package {package}")))
    return entries, []


def load(methods: Sequence[str], envs: Sequence[str]) -> None:
    """Import those of these that are plug-ins', and step tasks. Raises BadInput where one is broken."""
    for kind, names in (("method", methods), ("env", envs)):
        for name in names:
            if name in KNOWN.of_plugins(kind):
                with loading.troubles(f"the {kind} {name} cannot be loaded"):
                    loading.check(kind, name, KNOWN.thing(kind, name))
                if kind == "env":
                    loading.try_out(name)
                    for module in gymnasium_tasks.modules_of(SPECS[name].env_id):
                        KNOWN.module(module, is_plugin=False)


def in_cells(
    known: Sequence[Plugin], methods: Sequence[str], envs: Sequence[str], env_kwargs: str, variables: str
) -> None:
    """Make known, in a process of cells, what a job needs, and import that.

    known: the plug-ins that define its method and task. env_kwargs, variables: as `Conditions` has them.
    Raises BadInput as `add` does.
    """
    KNOWN.env_kwargs = env_kwargs
    KNOWN.variables.clear()
    KNOWN.variables.update(json.loads(variables or "{}"))
    os.environ.update(KNOWN.variables)
    for one in known:
        KNOWN.add(one)
        if not one.is_file and one.place and one.place not in sys.path:
            sys.path.append(one.place)
        loading.offered(one)
    for kind, name, entry in _installed()[0]:
        with suppress(BadInput):
            KNOWN.register(kind, name, entry)
    for env in envs:
        task_or_name(env)
    for method in methods:
        KNOWN.configure(method)
    load(methods, envs)


def modules(methods: Sequence[str], envs: Sequence[str]) -> set[str]:
    """Return the modules that define those of these that are plug-ins'."""
    asked = {"method": methods, "env": envs}
    entries = [KNOWN.of_plugins(kind).get(name) for kind, names in asked.items() for name in names]
    found = (KNOWN.registered.get(id_of(e), "") if id_of(e) else e.module for e in entries if e)
    return {*filter(None, found)}


def needed(methods: Sequence[str], envs: Sequence[str]) -> tuple[Plugin, ...]:
    """Return the plug-ins, of those that were named, that define these methods and tasks."""
    theirs = modules(methods, envs)
    return tuple(one for module, one in KNOWN.plugins.items() if module in theirs)


def check_alone(methods: Sequence[str], envs: Sequence[str]) -> None:
    """Raise BadInput where these cannot be computed in this process, because of plug-ins.

    Another plug-in was imported here and may have changed it, or a source of theirs was edited since.
    """
    own = modules(methods, envs)
    for one in KNOWN.loaded:
        name = one.module.__name__
        if not one.is_current or (one.is_plugin and name not in own):
            raise BadInput(
                f"the plug-in {name.removeprefix(FILE_MODULE)} was imported in this process and may have "
                "changed what is computed in it: leave out --engine inline, or begin a new process",
                READ,
            )


def check_inline(jobs: Sequence[tuple[Sequence[str], str]]) -> None:
    """Raise BadInput where these jobs cannot all be done in this process.

    There must be an order in which each meets no plug-in but its own. jobs: no method or one, and a task.
    """
    needs = sorted((modules(methods, [env]) for methods, env in jobs), key=len)
    if any(fewer - more for fewer, more in pairwise(needs)):
        raise BadInput(
            "--engine inline computes in one process, where plug-ins may change each other's cells: name one "
            "plug-in at a time, or leave it out",
            READ,
        )
    for methods, env in jobs:
        check_alone(methods, [env])


def sources(kind: str, name: str) -> Sources:
    """Return the sources of a plug-in's method or task, and the variables that the user gives to plug-ins.

    They are as another process reported them, or as they are now.
    """
    entry = KNOWN.entries[kind][name]
    env_id = "" if entry.target in KNOWN.offers else id_of(entry)
    own = gymnasium_tasks.sources_of_id(env_id) if env_id else _offer_of(kind, name).sources
    variables = environment.of_user() | KNOWN.variables
    more = [f"{variable}={value}" for variable, value in variables.items()]
    return Sources([*own.digests, *more], own.program)


def settings_for(method: str, env: str, budget: str) -> dict[str, Any]:
    """Return the hyper-parameters that a method gets in a task at a budget: those in its name, and others.

    A plug-in's method gets those of the built-in methods whose class it has or derives from, except for the
    fields that it sets itself.
    """
    if method not in KNOWN.of_plugins("method"):
        usual = settings.settings_for(base(method), env, budget)
    else:
        offer = _offer_of("method", method)
        agreed = settings.agreed(offer.like, env, budget)
        usual = {name: value for name, value in agreed.items() if name in offer.takes}
    return usual | configured.settings_in(method)


def method_for(method: str, env: str, budget: str) -> Method:
    """Return a method as it is in a task at a budget. Raises BadInput as `load_method` and `typed` do."""
    make, thing = load_method(method), KNOWN.thing("method", method)
    own = configured.typed(base(method), thing, configured.settings_in(method))
    return make(**(settings_for(method, env, budget) | own))


def searched(method: str) -> dict[str, Search]:
    """Return the settings of a method that `tune` searches."""
    if method in KNOWN.of_plugins("method"):
        return _offer_of("method", method).searched
    return configured.searched(KNOWN.thing("method", method))


def like(method: str) -> tuple[str, ...]:
    """Return the built-in methods whose class a plug-in's method has or derives from, the method without its
    settings where it has some, and none for others."""
    if method in KNOWN.of_plugins("method"):
        return _offer_of("method", method).like
    return () if base(method) == method else (base(method),)


def task(env: str) -> Offer | EnvSpec:
    """Return what is known of a task. A plug-in's task is not imported: the facts are an `Offer`."""
    return _offer_of("env", env) if env in KNOWN.of_plugins("env") else SPECS[env]


def _offer_of(kind: str, name: str) -> Offer:
    """Return the facts about a plug-in's method or task.

    Where its module is not imported here, they are another process's. It is asked where it was not.
    """
    entry = KNOWN.entries[kind][name]
    if entry.target not in KNOWN.offers:
        if entry.module in sys.modules:
            return loading.offer(kind, name, entry)
        KNOWN.offers[entry.target], *_ = loading.in_a_process([], [(kind, name, entry)])
    return KNOWN.offers[entry.target]
