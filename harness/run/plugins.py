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
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec, SourceFileLoader
from itertools import pairwise
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any

from harness.registry import (
    BUILT_IN,
    ENVS,
    GROUPS,
    GYMNASIUM_NAME,
    METHODS,
    PLUGINS,
    SPECS,
    VARIANTS,
    BadInput,
    Entry,
    load_method,
)
from harness.run import environment, ours, packages
from harness.run.plugin_sources import Sources, sources_of
from methods import settings

if TYPE_CHECKING:
    from envs import EnvSpec

ENTRY_POINTS = {"method": "irl_bench.methods", "env": "irl_bench.envs"}
TABLES = {"method": "METHODS", "env": "ENVS"}
"""What a plug-in's module calls its methods and its environments."""
GYMNASIUM = "gym:"
"""Before the id of a task of Gymnasium, where environments are named."""
FILE_MODULE = "irl_bench_plugin_"
"""How the names of modules begin that are made of files."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]{0,59}")
READ = "plugins"
"""The page about them."""
LONGEST = 300
"""Seconds that plug-ins may take to load, all that are named together."""


@dataclass(frozen=True)
class Plugin:
    """A plug-in as it was named. place: the file, or the folder where Python finds the module."""

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
    """A method or task of a plug-in, without the object itself.

    like: the built-in methods whose class a method has, or derives from.
    takes: the hyper-parameters that it takes from their settings.
    variants, discrete, rl_steps, ddpg_steps, solves: fields of a task's `EnvSpec`.
    packages: the versions of those that a task needs.
    registered: the sources of what Gymnasium's registry names for a task.
    """

    kind: str
    name: str
    target: str
    summary: str
    like: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    discrete: bool = False
    rl_steps: dict[str, int] = field(default_factory=dict)
    ddpg_steps: dict[str, int] = field(default_factory=dict)
    solves: dict[str, int] = field(default_factory=dict)
    packages: dict[str, str] = field(default_factory=dict)
    registered: Sources = field(default_factory=lambda: Sources([], []))


@dataclass(frozen=True)
class Told:
    """Methods and tasks of plug-ins; and the sources of their modules, by name."""

    offers: tuple[Offer, ...] = ()
    sources: dict[str, Sources] = field(default_factory=dict)


_named: list[Plugin] = []
"""Plug-ins that were named and are known now."""
_files: dict[str, str] = {}
"""Files by the name of their module."""
_read: dict[str, bytes] = {}
"""The content of files when they were executed here, by the name of their module."""
_offers: dict[str, Offer] = {}
"""Methods and tasks that another process reported, by target. Here their modules need not be imported."""
_sources: dict[str, Sources] = {}
"""Sources of modules that it reported, by name."""
_ever: set[str] = set()
"""Modules of all plug-ins that were known here at some time."""
_replaced: set[str] = set()
"""Modules that were edited, or one that they import, after they had been executed here."""
_executed: dict[str, tuple[object, Sources]] = {}
"""Modules that were loaded here, and their sources then, by name."""


@contextmanager
def for_now() -> Iterator[None]:
    """Forget, as the context ends, the plug-ins that were made known in it."""
    tables: list[dict[str, Any]] = [VARIANTS, ENVS, *PLUGINS.values(), _files, _offers, _sources]
    before, named = [dict(table) for table in tables], [*_named]
    try:
        yield
    finally:
        for table, its in zip(tables, before, strict=True):
            table.clear()
            table.update(its)
        _named[:] = named
        for name in SPECS.keys() - ENVS.keys():
            del SPECS[name]


def add(named: Sequence[str], asked: Sequence[str] = ()) -> list[str]:
    """Make known what plug-ins name, each a file or a module, and what installed packages do. Return why some
    of the latter cannot be used.

    They are imported in a process of their own, and here only where something is asked of their tasks.
    asked: names with commas between. What installed packages have of those names is imported there, too.
    Raises BadInput for what is broken.
    """
    new = list(dict.fromkeys(map(_plugin, named)))
    for i, one in enumerate(new):
        before = (*_named, *new[:i])
        if any(one.module == other.module and one.place != other.place for other in before):
            raise BadInput(f"two plug-ins are called {Path(one.name).name}; rename one")
    points, troubles = _installed()
    words = {word.strip() for text in asked for word in text.split(",")}
    wanted = [
        (kind, name, entry)
        for kind, name, entry in points
        if words & {name, "plugins"} and name not in BUILT_IN[kind] and entry.target not in _offers
    ]
    told = _in_a_process(new, wanted) if new or wanted else Told()
    for one in new:
        _forget(one)
        if one.is_file:
            _files[one.module] = one.place
    for offer in told.offers:
        if (offer.kind, offer.name) not in [point[:2] for point in wanted]:
            _register(offer.kind, offer.name, Entry(offer.target, offer.summary, offer.variants))
    _keep(told)
    for kind, name, entry in points:
        try:
            variants = _offers[entry.target].variants if entry.target in _offers else ()
            _register(kind, name, entry._replace(variants=variants))
        except BadInput as error:
            troubles.append(f"{entry.summary.removeprefix('of the package ')}: {error}")
    _named[:] = dict.fromkeys([*_named, *new])
    return troubles


def _installed() -> tuple[list[tuple[str, str, Entry]], list[str]]:
    """Return what installed packages name, by kind and name, and why that cannot be read."""
    found: list[tuple[str, str, Entry]] = []
    try:
        points = importlib.metadata.entry_points()
    except Exception as error:  # of a package whose metadata is damaged
        return found, [f"what installed packages name cannot be read: {in_words(error)}"]
    for kind, group in ENTRY_POINTS.items():
        for point in sorted(points.select(group=group)):
            package = f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown package"
            found.append((kind, point.name, Entry(point.value, f"of the package {package}")))
    return found, []


def _plugin(name: str) -> Plugin:
    """Return where a plug-in is; nothing of it is executed. Raises BadInput where there is none."""
    if name.endswith(".py"):
        file = Path(name)
        path = os.path.join(os.path.realpath(file.parent), file.name)  # Links count before ".." does.
        if not os.path.isfile(path):
            raise BadInput(f"there is no plug-in {path}", READ)
        return Plugin(name, path)
    if Path(name).is_file():
        raise BadInput(f"the plug-in {name} is a file whose name does not end in .py")
    top, spec = name.partition(".")[0], None
    with suppress(ImportError, ValueError):
        spec = importlib.util.find_spec(top)
    places = list(spec.submodule_search_locations or []) if spec else []
    if spec and not places and spec.has_location:
        places = [str(spec.origin)]
    return Plugin(name, str(Path(places[0]).absolute().parent) if places else "")


def _forget(plugin: Plugin) -> None:
    """Forget what a plug-in named before; a file that was edited since is executed anew."""
    begins = f"{plugin.module}:"
    for kind, known in PLUGINS.items():
        for name in [name for name, entry in known.items() if entry.target.startswith(begins)]:
            del known[name], (VARIANTS if kind == "method" else ENVS)[name]
            if kind == "env":
                SPECS.pop(name, None)
    for target in [target for target in _offers if target.startswith(begins)]:
        del _offers[target]
    there = sys.modules.get(plugin.module)
    if there and plugin.is_file:
        with suppress(OSError):
            if there.__file__ == plugin.place and _read.get(plugin.module) == Path(plugin.place).read_bytes():
                return
        del sys.modules[plugin.module]
        _replaced.add(plugin.module)


def _keep(told: Told) -> None:
    _offers.update({offer.target: offer for offer in told.offers})
    _sources.update(told.sources)


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


def needed(methods: Sequence[str], envs: Sequence[str]) -> tuple[Plugin, ...]:
    """Return the plug-ins, of those that were named, that define these methods and environments."""
    theirs = modules(methods, envs)
    return tuple(one for one in _named if one.module in theirs)


def modules(methods: Sequence[str], envs: Sequence[str]) -> set[str]:
    """Return the modules that define those of these that are plug-ins'."""
    asked = {"method": methods, "env": envs}
    entries = [PLUGINS[kind][name] for kind in PLUGINS for name in asked[kind] if name in PLUGINS[kind]]
    return {entry.target.partition(":")[0] for entry in entries} - {__name__}


def others_here(methods: Sequence[str], envs: Sequence[str]) -> list[str]:
    """Return the modules of plug-ins that were imported in this process and do not define any of these: they
    may have changed whatever is computed here. So may those of which a source was edited since."""
    for module, (loaded, was) in _executed.items():
        with suppress(OSError):
            if sys.modules.get(module) is not loaded or sources_of(module) == was:
                continue
        _replaced.add(module)
    here = _replaced | {module for module in _ever if module in sys.modules}
    return sorted((here - modules(methods, envs)) | _replaced)


def check_alone(methods: Sequence[str], envs: Sequence[str]) -> None:
    """Raise BadInput where these are not to be computed in this process, because of other plug-ins."""
    if others := others_here(methods, envs):
        raise BadInput(
            f"the plug-in {others[0].removeprefix(FILE_MODULE)} was imported in this process and may have "
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


def in_cells(known: Sequence[Plugin], methods: Sequence[str], envs: Sequence[str]) -> None:
    """Make known, in a process of cells, what a job needs, and import that.

    known: the plug-ins that define its method and task. Raises BadInput as `add` does.
    """
    for one in known:
        if one.is_file:
            _forget(one)
            _files[one.module] = one.place
        elif one.place and one.place not in sys.path:
            sys.path.append(one.place)
        for offer in _offered(one):
            _offers.pop(offer.target, None)  # The object itself counts here, and no earlier report of it.
        _sources.pop(one.module, None)
    points, _ = _installed()
    for kind, name, entry in points:
        with suppress(BadInput):
            _register(kind, name, entry)
    for env in envs:
        task_or_name(env)
    load(methods, envs)


def packed(folder: Path) -> dict[Plugin, Plugin]:
    """Copy the plug-ins that were named into the folder, for another machine. Return them as they are there,
    with places below the folder."""
    found = {}
    for i, one in enumerate(_named):
        at = Path("plugins") / str(i)
        (folder / at).mkdir(parents=True)
        source = Path(one.place)
        if not one.is_file:
            source /= one.name.partition(".")[0]
            source = source if source.is_dir() else source.with_suffix(".py")
        if source.is_dir():
            shutil.copytree(
                source, folder / at / source.name, ignore=_not_copied, ignore_dangling_symlinks=True
            )
        else:
            shutil.copy(source, folder / at)
        found[one] = Plugin(one.name, str(at / source.name if one.is_file else at))
    return found


def _not_copied(folder: str, names: list[str]) -> set[str]:
    """Return names that are left out of a copy: those of Python's bytecode, and links that lead back to where
    they are."""
    here = f"{os.path.realpath(folder)}/"
    back = {name for name in names if here.startswith(f"{os.path.realpath(Path(folder, name))}/")}
    return back | {name for name in names if name == "__pycache__"}


def unpacked(plugins: Sequence[Plugin]) -> tuple[Plugin, ...]:
    """Return plug-ins that were `packed` into this process's folder, with their places here."""
    return tuple(Plugin(one.name, str(Path(one.place).absolute())) for one in plugins)


def settings_for(method: str, env: str, budget: str) -> dict[str, Any]:
    """Return the hyper-parameters that a method gets in an environment at a budget.

    A plug-in's method gets those of the built-in methods whose class it has or derives from, but for the
    fields that it sets itself.
    """
    if method not in PLUGINS["method"]:
        return settings.settings_for(method, env, budget)
    offer = _offer_of("method", method)
    agreed = settings.agreed(offer.like, env, budget)
    return {name: value for name, value in agreed.items() if name in offer.takes}


def like(method: str) -> tuple[str, ...]:
    """Return the built-in methods whose class a plug-in's method has, or derives from; of others none."""
    return _offer_of("method", method).like if method in PLUGINS["method"] else ()


def times_as_many(method: str, env: str, budget: str) -> float:
    """Return about how many times the environment steps of the built-in method of its class a plug-in's
    method takes by its settings; 1 for all others. The method is imported."""
    from harness.judge import effort

    if not (names := like(method)):
        return 1.0
    own, original = load_method(method)(**settings_for(method, env, budget)), load_method(names[0])
    usual = original(**settings.settings_for(names[0], env, budget))
    steps = task(env).rl_steps[budget]
    most = effort.asked(usual, steps)
    return effort.asked(own, steps) / most if most else 1.0


def task(env: str) -> Offer | EnvSpec:
    """Return what is known of a task without importing one of a plug-in, of which that is an `Offer`."""
    entry = PLUGINS["env"].get(env)
    is_told = entry and not entry.target.startswith(f"{__name__}:")
    return _offer_of("env", env) if is_told else SPECS[env]


def _offer_of(kind: str, name: str) -> Offer:
    """Return the facts about a plug-in's method or task. Another process is asked where none are known, and
    its module is not imported here."""
    entry = PLUGINS[kind][name]
    if entry.target not in _offers:
        if entry.target.partition(":")[0] in sys.modules:
            return _offer(kind, name, entry, load_method(name) if kind == "method" else SPECS[name])
        _keep(_in_a_process([], [(kind, name, entry)]))
    return _offers[entry.target]


def load(methods: Sequence[str], envs: Sequence[str]) -> None:
    """Imports those of these that are plug-ins', and tries tasks out. Raises BadInput where one is broken."""
    theirs = modules(methods, envs)
    for kind, names in (("method", methods), ("env", envs)):
        for name in names:
            if name in PLUGINS[kind]:
                with _its_troubles(f"the {kind} {name} cannot be loaded"):
                    _check(kind, name, load_method(name) if kind == "method" else SPECS[name])
                    if kind == "env":
                        _try_out(name)
                        theirs.update(_modules_of_task(SPECS[name].env_id))
    for module in theirs:
        loaded = sys.modules.get(module)
        if _executed.get(module, (None,))[0] is not loaded:
            _executed[module] = loaded, sources_of(module)


def _try_out(env: str) -> None:
    from envs.copies import try_out

    try_out(SPECS[env])


def sources(kind: str, name: str) -> Sources:
    """Return the sources of a plug-in's method or task: as another process reported them, or as they are
    now. The variables that the user gives to plug-ins are part of them."""
    module, _, rest = PLUGINS[kind][name].target.partition(":")
    if module == __name__:
        return _sources_of_task(rest.partition("/")[2])
    if module not in _sources and module not in sys.modules:
        _offer_of(kind, name)
    found = _sources[module] if module in _sources else sources_of(module)
    more = _offer_of(kind, name).registered if kind == "env" else Sources([], [])
    given = [f"{name}={value}" for name, value in environment.of_user().items()]
    return Sources(
        [*sorted({*found.digests, *more.digests}), *given], sorted({*found.program, *more.program})
    )


def _sources_of_task(env_id: str) -> Sources:
    """Of a task of Gymnasium, and what it is registered with. Raises BadInput where that cannot be told."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    entry = spec.entry_point
    found = sources_of(*_modules_of_task(env_id))
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


def packages_of_task(env: str) -> dict[str, str]:
    """Return the versions of the packages that a plug-in's task, or one of Gymnasium, needs. The module that
    it is registered with names them (`packages.imported`)."""
    entry = PLUGINS["env"][env]
    if entry.target.startswith(f"{__name__}:"):
        return _packages(entry.target.partition("/")[2])
    return _offer_of("env", env).packages


def _modules_of_task(env_id: str) -> list[str]:
    """Return the modules of what a task is registered with, its wrappers included."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    entries = [spec.entry_point, *(wrapper.entry_point for wrapper in spec.additional_wrappers)]
    return [module for module in map(_module_of, entries) if module]


def _packages(env_id: str) -> dict[str, str]:
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


class _File(SourceFileLoader):
    """A loader of a plug-in's file, which neither reads nor writes bytecode: what the file holds counts."""

    def get_code(self, fullname: str) -> CodeType:
        content = _read[fullname] = self.get_data(self.path)
        return self.source_to_code(content, self.path)


class _Files:
    """A finder of files that were named as plug-ins."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name not in _files:
            return None
        loader = _File(name, _files[name])
        return importlib.util.spec_from_file_location(name, _files[name], loader=loader)


sys.meta_path.append(_Files)


def look(
    named: Sequence[Plugin],
    wanted: Sequence[tuple[str, str, Entry]],
    tell: Callable[[str], None] = lambda what: None,
) -> Told:
    """Import plug-ins, and return what they have.

    wanted: kinds, names and entries of installed packages. tell: called with what is imported next. Raises
    BadInput for what is broken.
    """
    offers = []
    for one in named:
        tell(f"the plug-in {one.name}")
        offers += _offered(one)
    for kind, name, entry in wanted:
        tell(f"the {kind} {name} {entry.summary}")
        with _its_troubles(f"the {kind} {name} cannot be loaded"):
            importlib.import_module(entry.target.partition(":")[0])
            _register(kind, name, entry)
            thing = load_method(name) if kind == "method" else SPECS[name]
            _check(kind, name, thing)
            offers.append(_offer(kind, name, entry, thing))
    for offer in offers:
        if offer.kind == "env":
            with _its_troubles(f"the env {offer.name} cannot be loaded"):
                _try_out(offer.name)
    modules = {offer.target.partition(":")[0] for offer in offers}
    return Told(tuple(offers), {module: sources_of(module) for module in modules})


def _offered(plugin: Plugin) -> list[Offer]:
    """Import a plug-in, register what it has, and return that. Raises BadInput where it is broken."""
    if plugin.is_file:
        _files[plugin.module] = plugin.place
    from harness.store.codec import printable  # here, for `--help` does without its packages

    found = []
    with _its_troubles(f"the plug-in {plugin.name} cannot be loaded"):
        module = importlib.import_module(plugin.module)
        if not any(hasattr(module, table) for table in TABLES.values()):
            raise BadInput(f"the plug-in {plugin.name} says neither METHODS nor ENVS", READ)
        for kind, table in TABLES.items():
            things = getattr(module, table, {})
            if not isinstance(things, Mapping):
                raise BadInput(
                    f"the plug-in {plugin.name}: {table} must be a dict of what it has, by name", READ
                )
            for name, thing in things.items():
                _check(kind, name, thing)
                entry = Entry(f"{module.__name__}:{table}/{name}", f"of {printable(plugin.name)}")
                _register(kind, name, entry)
                found.append(_offer(kind, name, entry, thing))
    return found


def _offer(kind: str, name: str, entry: Entry, thing: Any) -> Offer:
    if kind == "env":
        steps, ddpg, solves = (
            {budget: int(count) for budget, count in table.items()}
            for table in (thing.rl_steps, thing.ddpg_steps, thing.solves)
        )
        return Offer(
            *(kind, name, entry.target, entry.summary),
            variants=tuple(thing.variants),
            discrete=bool(thing.discrete),
            rl_steps=steps,
            ddpg_steps=ddpg,
            solves=solves,
            packages=_packages(thing.env_id),
            registered=sources_of(*_modules_of_task(thing.env_id)),
        )
    known: Mapping[str, Entry] = METHODS | {n: VARIANTS[n] for n in BUILT_IN["method"] if n in VARIANTS}
    for i, base in enumerate(thing.__mro__):
        place = f"{base.__module__}:{base.__qualname__}"
        names = tuple(name for name, entry in known.items() if entry.target == place)
        if names := names or settings.BASES.get(place, ()):
            takes = _takes(thing, thing.__mro__[:i], base)
            return Offer(kind, name, entry.target, entry.summary, names, takes)
    return Offer(kind, name, entry.target, entry.summary)


def _takes(method: Any, derived: Sequence[type], base: Any) -> tuple[str, ...]:
    """Return the fields of a method whose values are its base's: those that the classes between neither
    declare anew nor give another default."""
    own = {name for one in derived for name in vars(one).get("__annotations__", {})}
    before = _parameters(base)
    return tuple(
        name
        for name, parameter in _parameters(method).items()
        if name in before and name not in own and parameter.default == before[name].default
    )


def _in_a_process(named: Sequence[Plugin], wanted: Sequence[tuple[str, str, Entry]]) -> Told:
    """Return what `look` does, in a process of its own, in the environment of cells: whatever plug-ins do
    while they are loaded, they do it there. Raises BadInput for what is broken, or ends or hangs there."""
    import msgspec

    from harness.engines import containment

    request = json.dumps([sys.path, [dataclasses.astuple(one) for one in named], wanted])
    begin = f"import sys; sys.path.insert(0, {str(ours.ROOT)!r}); from harness.run import plugin_process"
    command = [sys.executable, "-P", "-c", f"{begin}; plugin_process.tell(sys.argv[1])", request]
    variables, code = environment.of_cells(False), None
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                command, env=variables, stdin=subprocess.DEVNULL, stdout=output, start_new_session=True
            )
        except OSError as error:
            raise BadInput(f"no process can be started: {error.strerror}") from error
        try:
            with suppress(subprocess.TimeoutExpired):
                code = process.wait(LONGEST)
        finally:
            if process.poll() is None:
                containment.kill_descendants(process.pid)
            process.kill()
            with suppress(OSError, AttributeError):  # where there are no groups
                os.killpg(process.pid, signal.SIGKILL)  # with all that they started
            process.wait()
        output.seek(0)
        lines = output.read().decode(errors="replace").splitlines()
    kind, _, said = lines[-1].partition(" ") if lines else ("", "", "")
    if kind == "told":
        return msgspec.json.decode(said, type=Told)
    if kind == "error":
        raise BadInput(json.loads(said))
    what = json.loads(said) if kind == "at" else "a plug-in"
    if code is None:
        raise BadInput(f"{what} was not loaded within {LONGEST:g} s", READ)
    how = f"killed by {signal.Signals(-code).name}" if -code in {*signal.Signals} else f"exit code {code}"
    how += " (out of memory?)" if how.endswith("SIGKILL") else ""
    raise BadInput(f"{what} ended its process while it was loaded: {how}", READ)


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
    named = [
        one for one in _parameters(method).values() if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
    ]
    return [one.name for one in named if one.default is one.empty]


def _parameters(method: Any) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(method).parameters
    except ValueError:  # of what tells none
        return {}


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
    known[name] = (VARIANTS if kind == "method" else ENVS)[name] = entry
    _ever.add(entry.target.partition(":")[0])


@contextmanager
def _its_troubles(what: str) -> Iterator[None]:
    """Whatever a plug-in raises is BadInput, and what it prints goes to standard error."""
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (BadInput, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise BadInput(f"{what}: {in_words(error)}{_hint(error)}", READ) from error


def in_words(error: BaseException) -> str:
    """Return what was raised, in a line."""
    try:
        said = str(error)
    except BaseException:
        said = "(no words)"
    return " ".join(f"{type(error).__name__}: {said}".split())[:300]


def _hint(error: BaseException) -> str:
    """Return what an error of a plug-in may come from, '' where nothing is known."""
    name = str(getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ImportError) and name in ours.PACKAGES:
        return f"; {name!r} is this program's package: give yours another name"
    if isinstance(error, ModuleNotFoundError):
        return "; a plug-in of several files is named as a module that Python can import"
    return environment.hint(error)
