"""The first import of plug-ins, in a process of its own. All that they do meanwhile is done there."""

from __future__ import annotations

import dataclasses
import inspect
import os
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NoReturn

from harness.process import environment
from harness.registry import configured, gymnasium_tasks, ours
from harness.registry.built_in import METHODS, VARIANTS, Entry
from harness.registry.known import KNOWN, Offer, Plugin, id_of
from harness.registry.names import BadInput, plain
from harness.registry.packages import to_install
from harness.registry.sources import Sources, sources_of
from methods import settings

NO_NUMBERS = "It reports on plug-ins before a run; cells import them anew."

TABLES = {"method": "METHODS", "env": "ENVS"}
"""Names of the tables of methods and of tasks in a plug-in's module."""
READ = "plugins"
"""The page about plug-ins."""
HINTS = {
    "ModuleNotFoundError": "a plug-in can import what lies in its own folder, and what is installed",
    "NotFound: ": "name the module that registers the task: gym:MODULE:ID, or --plugin",
    "gymnasium[box2d]": f"or {to_install('box2d')}",
    "argument 'seed'": "reset must take seed= and options=, as of Gymnasium 0.26",
    "to unpack (expected ": "as of Gymnasium 0.26 reset returns an observation and a dict, and step an "
    "observation, a reward, whether it terminated, whether it was truncated, and a dict",
    "unexpected keyword argument": "--env-kwargs are arguments of the task's class, and of gymnasium.make",
}
"""Ways out, by a part of an error's text."""
LONGEST = 300
"""Seconds that all plug-ins of one request may take to load."""
Wanted = tuple[str, str, Entry]
"""Kind, name and entry of an installed package's method or task."""


def in_a_process(
    named: Sequence[Plugin], wanted: Sequence[Wanted], with_settings: Sequence[str] = ()
) -> list[Offer]:
    """Return `look`, called in a process of its own in the environment of cells. What plug-ins register with
    Gymnasium is known then.

    Raises BadInput for a plug-in that is broken, and for one that ends its process or hangs.
    """
    import msgspec

    from harness.engines.containment import kill_descendants

    begin = f"import sys; sys.path.insert(0, {str(ours.ROOT)!r}); from harness.registry import loading"
    command = [sys.executable, "-P", "-c", f"{begin}; loading.answer(*sys.argv[1:])"]
    with tempfile.TemporaryDirectory() as folder:
        file, code = Path(folder) / "answer", None
        try:
            request = msgspec.json.encode((sys.path, named, wanted, with_settings)).decode()
            process = subprocess.Popen(
                [*command, request, str(file)],
                env=environment.of_cells(False) | KNOWN.variables,
                stdin=subprocess.DEVNULL,
                stdout=2,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise BadInput(f"plug-ins cannot be loaded: {in_words(error)}", READ) from error
        try:
            with suppress(subprocess.TimeoutExpired):
                code = process.wait(LONGEST)
        finally:
            kill_descendants(process.pid)
            process.kill()
            process.wait()
        content = file.read_bytes() if file.exists() else b""
    if not content:
        names = ", ".join([*(one.name for one in named), *(name for _, name, _ in wanted)])
        ended = f"ended its process while it was loaded ({code})"
        raise BadInput(f"{names} {f'was not loaded within {LONGEST:g} s' if code is None else ended}", READ)
    offers, registered, message = msgspec.json.decode(content, type=tuple[list[Offer], dict[str, str], str])
    if message:
        raise BadInput(message)
    KNOWN.registered |= registered
    return offers


def answer(request: str, file: str) -> NoReturn:
    """Write what plug-ins offer into a new file, or why they cannot be used, and end this process.

    `request`: JSON of the path of modules, and of what `look` takes.
    """
    import msgspec

    asked = tuple[list[str], list[Plugin], list[Wanted], list[str]]
    path, *what = msgspec.json.decode(request, type=asked)
    sys.path[:] = path
    ours.first()
    from harness.engines.containment import adopt_orphans, bound_memory, kill_descendants

    adopt_orphans()
    signal.alarm(LONGEST + 5)  # in case that nobody waits any more
    offers, message = list[Offer](), ""
    try:
        bound_memory()
        offers = look(*what)
    except BadInput as error:
        message = str(error)
    except BaseException as error:
        message = f"a plug-in cannot be loaded: {in_words(error)}"
    Path(f"{file}.new").write_bytes(msgspec.json.encode((offers, KNOWN.registered, message)))
    Path(f"{file}.new").rename(file)
    with suppress(Exception):
        sys.stdout.flush()
    kill_descendants()
    os._exit(0)  # whatever else was started here


def look(named: Sequence[Plugin], wanted: Sequence[Wanted], with_settings: Sequence[str]) -> list[Offer]:
    """Import plug-ins, and return what they offer. Raises BadInput for what is broken.

    `wanted`: of installed packages. `with_settings`: names of methods with settings, which are checked.
    """
    offers = []
    for one in named:
        KNOWN.add(one)
        offers += offered(one)
    for kind, name, entry in wanted:
        given = gymnasium_tasks.kwargs_of(entry)
        with troubles(f"the {kind} {name}{f' with {given}' if given else ''} cannot be loaded"):
            KNOWN.register(kind, name, entry)
            check(kind, name, KNOWN.thing(kind, name))
            offers.append(offer(kind, name, entry))
    for name in with_settings:
        KNOWN.configure(name)
    for one_offer in offers:
        if one_offer.kind == "env":
            try_out(one_offer.name)
    return offers


def offered(plugin: Plugin) -> list[Offer]:
    """Import a plug-in, register what it names, and return that. Raises BadInput where it is broken."""
    offers = []
    with troubles(f"the plug-in {plugin.name} cannot be loaded"):
        from gymnasium import registry

        before = {*registry}
        module, sources = KNOWN.module(plugin.module), sources_of(plugin.module)
        ids = gymnasium_tasks.registered_by(plugin.module, before)
        KNOWN.registered |= dict.fromkeys(ids, plugin.module)
        if not ids and not any(hasattr(module, table) for table in TABLES.values()):
            nothing = "says neither METHODS nor ENVS, and registers no task with Gymnasium"
            raise BadInput(f"the plug-in {plugin.name} {nothing}", READ)
        for kind, table in TABLES.items():
            things = getattr(module, table, {})
            if not isinstance(things, Mapping):
                raise BadInput(f"the plug-in {plugin.name}: {table} must be a dict of things by name", READ)
            for name, thing in things.items():
                entry = Entry(f"{module.__name__}:{table}/{name}", f"of {plain(plugin.name)}")
                KNOWN.register(kind, name, entry)
                check(kind, name, thing)
                offers.append(offer(kind, name, entry, sources))
    return offers


def offer(kind: str, name: str, entry: Entry, sources: Sources | None = None) -> Offer:
    """Return the facts about a method or task, which is imported. sources: of its module, where known."""
    thing, facts = KNOWN.thing(kind, name), (kind, name, entry.target, entry.summary)
    if kind == "method":
        theirs, searched = sources or sources_of(entry.module), configured.searched(thing)
        return Offer(*facts, theirs, *_like(thing), searched=searched)
    steps, ddpg, solves = (
        {budget: int(count) for budget, count in table.items()}
        for table in (thing.rl_steps, thing.ddpg_steps, thing.solves)
    )
    own = gymnasium_tasks.sources_of_id(env_id) if (env_id := id_of(entry)) else None
    return Offer(
        *facts,
        own or gymnasium_tasks.sources_of_task(thing.env_id, entry.module),
        variants=tuple(thing.variants),
        discrete=bool(thing.discrete),
        rl_steps=steps,
        ddpg_steps=ddpg,
        solves=solves,
        encoder=str(thing.encoder),
    )


def _like(thing: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the built-in methods that a method derives from, and the fields that it shares with them.

    Fields that the classes between declare anew are its own, and those in which an instance has no default.
    """
    own, method = set[str](), thing
    if not isinstance(thing, type):
        method, usual = type(thing), type(thing)()
        own = {one.name for one in dataclasses.fields(thing) if _differ(thing, usual, one.name)}
    for base in method.__mro__:
        place = f"{base.__module__}:{base.__qualname__}"
        like = tuple(name for name, entry in (METHODS | VARIANTS).items() if entry.target == place)
        if like := like or settings.BASES.get(place, ()):
            taken = inspect.signature(method).parameters.keys() - own
            return like, tuple(one.name for one in dataclasses.fields(base) if one.name in taken)
        own |= {*vars(base).get("__annotations__", {})}
    return (), ()


def _differ(one: object, other: object, field: str) -> bool:
    return repr(getattr(one, field)) != repr(getattr(other, field))


def check(kind: str, name: object, thing: object) -> None:
    """Raise BadInput, or what the class raises, unless the object can be a method, or a task of that name."""
    from envs import EnvSpec

    if kind == "env":
        if not (isinstance(thing, EnvSpec) and thing.name == name):
            raise BadInput(f"the env {name} must be an EnvSpec of that name, not {thing!r:.60}", READ)
        return
    if not callable(getattr(thing, "fit", None)):
        raise BadInput(f"the method {name} must be a class with a method fit, not {thing!r:.60}", READ)
    made = thing if isinstance(thing, type) else type(thing)
    made()  # Each hyper-parameter has a default.
    if not dataclasses.is_dataclass(made):
        message = "must be a dataclass, whose fields are its hyper-parameters"
        raise BadInput(f"the method {name}: {made.__name__} {message}", READ)


def try_out(env: str) -> None:
    """Step a plug-in's task. Raises BadInput for whatever it raises, and for what no task may give."""
    from envs.copies import try_out

    with troubles(f"the env {env} cannot be loaded"):
        try_out(KNOWN.specs[env])


@contextmanager
def troubles(what: str) -> Iterator[None]:
    """Turn whatever a plug-in raises into BadInput, and send what it prints to standard error."""
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (BadInput, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise BadInput(f"{what}: {in_words(error)}{_hint(error)}", READ) from error


def in_words(error: BaseException) -> str:
    """Return an error's type and message in a line."""
    return " ".join(traceback.format_exception_only(error)[-1].split())[:300]


def _hint(error: BaseException) -> str:
    """Return a likely cause of a plug-in's error, '' where none is known."""
    name = str(getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ImportError) and name in ours.PROGRAM:
        return f"; {name!r} is this program's package: give yours another name"
    for sign, hint in HINTS.items():
        if sign in in_words(error):
            return f"; {hint}"
    return environment.hint(error)
