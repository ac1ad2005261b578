"""The first import of plug-ins, in a process of its own. All that they do meanwhile is done there."""

from __future__ import annotations

import dataclasses
import inspect
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any, NoReturn

from harness.process import environment
from harness.registry import gymnasium_tasks, ours
from harness.registry.known import KNOWN, Offer, Plugin
from harness.registry.names import METHODS, VARIANTS, BadInput, Entry, plain
from harness.registry.sources import Sources, sources_of
from methods import settings

NO_NUMBERS = "It reports on plug-ins before a run; cells import them anew."

TABLES = {"method": "METHODS", "env": "ENVS"}
"""Names of the tables of methods and of tasks in a plug-in's module."""
READ = "plugins"
"""The page about plug-ins."""
LONGEST = 300
"""Seconds that all plug-ins of one request may take to load."""
HYPER = "a dataclass, whose fields are its hyper-parameters"
Wanted = tuple[str, str, Entry]
"""Kind, name and entry of an installed package's method or task."""


def in_a_process(named: Sequence[Plugin], wanted: Sequence[Wanted]) -> list[Offer]:
    """Return `look`, called in a process of its own in the environment of cells.

    Raises BadInput for a plug-in that is broken, and for one that ends its process or hangs.
    """
    import msgspec

    from harness.engines.containment import kill_descendants

    request = json.dumps([sys.path, [dataclasses.astuple(one) for one in named], wanted])
    begin = f"import sys; sys.path.insert(0, {str(ours.ROOT)!r}); from harness.registry import loading"
    command = [sys.executable, "-P", "-c", f"{begin}; loading.answer(sys.argv[1])", request]
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
            kill_descendants(process.pid)
            process.kill()
            process.wait()
        output.seek(0)
        lines = output.read().decode(errors="replace").splitlines()
    kind, _, text = lines[-1].partition(" ") if lines else ("", "", "")
    if kind == "offers":
        return msgspec.json.decode(text, type=list[Offer])
    if kind == "error":
        raise BadInput(json.loads(text))
    what = json.loads(text) if kind == "at" else "a plug-in"
    raise BadInput(f"{what} {_ended(code)}", READ)


def _ended(code: int | None) -> str:
    """Return how a process ended. code: None where it did not end in time."""
    if code is None:
        return f"was not loaded within {LONGEST:g} s"
    how = f"killed by {signal.Signals(-code).name}" if -code in {*signal.Signals} else f"exit code {code}"
    how += " (out of memory?)" if how.endswith("SIGKILL") else ""
    return f"ended its process while it was loaded: {how}"


def answer(request: str) -> NoReturn:
    """Write to standard output what plug-ins offer, or why they cannot be used, and end this process.

    request: JSON of the path of modules, plug-ins, and entries of installed packages. The last line counts:
    'offers' or 'error' with JSON, or 'at' with the plug-in that is being loaded.
    """
    path, named, wanted = json.loads(request)
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with suppress(OSError):
        os.dup2(2, 1)  # for what plug-ins print
    sys.path[:] = path
    ours.first()
    from harness.engines.containment import bound_memory

    _go_on_in_a_child()
    import msgspec

    if hasattr(signal, "alarm"):
        signal.alarm(LONGEST + 5)  # in case that nobody waits any more
    at = "a plug-in"

    def say(kind: str, text: str) -> None:
        output.write(f"{kind} {text}\n")
        output.flush()

    def loading(what: str) -> None:
        nonlocal at
        at = what
        say("at", json.dumps(what))

    try:
        bound_memory()
        entries = [(kind, name, Entry(*entry)) for kind, name, entry in wanted]
        offers = look([Plugin(*one) for one in named], entries, loading)
        say("offers", msgspec.json.encode(offers).decode())
    except BadInput as error:
        say("error", json.dumps(str(error)))
    except BaseException as error:
        say("error", json.dumps(f"{at} cannot be loaded: {in_words(error)}"))
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(0)  # whatever else was started here


def _go_on_in_a_child() -> None:
    """Go on in a child, where the system can fork. This process ends as the child does, and before that it
    ends all that was started there, in other sessions, too."""
    from harness.engines.containment import adopt_orphans, kill_descendants

    if not hasattr(os, "fork"):
        return
    adopt_orphans()
    if not (child := os.fork()):
        return
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    kill_descendants()
    if code < 0:
        with suppress(OSError):  # SIGKILL has no handler.
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(abs(code))


def look(
    named: Sequence[Plugin],
    wanted: Sequence[Wanted],
    tell: Callable[[str], None] = lambda what: None,
) -> list[Offer]:
    """Import plug-ins, and return what they offer. tell: called with what is imported next.

    Raises BadInput for what is broken.
    """
    offers = []
    for one in named:
        tell(f"the plug-in {one.name}")
        KNOWN.add(one)
        offers += offered(one)
    for kind, name, entry in wanted:
        tell(f"the {kind} {name} {entry.summary}")
        with troubles(f"the {kind} {name} cannot be loaded"):
            KNOWN.register(kind, name, entry)
            thing = KNOWN.thing(kind, name)
            check(kind, name, thing)
            offers.append(offer(kind, name, entry, thing))
    for one_offer in offers:
        if one_offer.kind == "env":
            with troubles(f"the env {one_offer.name} cannot be loaded"):
                gymnasium_tasks.try_out(one_offer.name)
    return offers


def offered(plugin: Plugin) -> list[Offer]:
    """Import a plug-in, register what it names, and return that. Raises BadInput where it is broken."""
    offers = []
    with troubles(f"the plug-in {plugin.name} cannot be loaded"):
        module = KNOWN.module(plugin.module)
        sources = sources_of(plugin.module)
        if not any(hasattr(module, table) for table in TABLES.values()):
            raise BadInput(f"the plug-in {plugin.name} says neither METHODS nor ENVS", READ)
        for kind, table in TABLES.items():
            things = getattr(module, table, {})
            if not isinstance(things, Mapping):
                raise BadInput(f"the plug-in {plugin.name}: {table} must be a dict of things by name", READ)
            for name, thing in things.items():
                entry = Entry(f"{module.__name__}:{table}/{name}", f"of {plain(plugin.name)}")
                KNOWN.register(kind, name, entry)
                check(kind, name, thing)
                offers.append(offer(kind, name, entry, thing, sources))
    return offers


def offer(kind: str, name: str, entry: Entry, thing: Any, sources: Sources | None = None) -> Offer:
    """Return the facts about a method or task. sources: of its module, where they are known."""
    module = entry.target.partition(":")[0]
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
            packages=gymnasium_tasks.packages_of(thing.env_id),
            sources=sources_of(module, *gymnasium_tasks.modules_of(thing.env_id)),
        )
    like, takes = _like(thing)
    own = sources or sources_of(module)
    return Offer(kind, name, entry.target, entry.summary, like, takes, sources=own)


def _like(method: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the built-in methods that a method derives from, and the fields that it shares with them.

    Fields that the classes between declare anew, or give another default, are its own.
    """
    for i, base in enumerate(method.__mro__):
        place = f"{base.__module__}:{base.__qualname__}"
        like = tuple(name for name, entry in (METHODS | VARIANTS).items() if entry.target == place)
        if like := like or settings.BASES.get(place, ()):
            own = {name for one in method.__mro__[:i] for name in vars(one).get("__annotations__", {})}
            before = _parameters(base)
            takes = tuple(
                name
                for name, parameter in _parameters(method).items()
                if name in before and name not in own and parameter.default == before[name].default
            )
            return like, takes
    return (), ()


def check(kind: str, name: object, thing: object) -> None:
    """Raise BadInput unless the object can be a method, or a task of that name."""
    from envs import EnvSpec

    if kind == "env":
        if not (isinstance(thing, EnvSpec) and thing.name == name):
            raise BadInput(f"the env {name} must be an EnvSpec of that name, not {thing!r:.60}", READ)
        return
    if not (isinstance(thing, type) and callable(getattr(thing, "fit", None))):
        raise BadInput(f"the method {name} must be a class with a method fit, not {thing!r:.60}", READ)
    if needed := _without_default(thing):
        raise BadInput(f"the method {name} has no default for {', '.join(needed)}", READ)
    if not dataclasses.is_dataclass(thing):
        raise BadInput(f"the method {name}: {thing.__name__} must be {HYPER}", READ)


def _without_default(method: Any) -> list[str]:
    """Return the names of arguments that the class cannot do without."""
    return [
        one.name
        for one in _parameters(method).values()
        if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD) and one.default is one.empty
    ]


def _parameters(method: Any) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(method).parameters
    except ValueError:  # Some classes have no signature.
        return {}


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
    try:
        message = str(error)
    except BaseException:
        message = "(no words)"
    return " ".join(f"{type(error).__name__}: {message}".split())[:300]


def _hint(error: BaseException) -> str:
    """Return a likely cause of a plug-in's error, '' where none is known."""
    name = str(getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ImportError) and name in ours.PACKAGES:
        return f"; {name!r} is this program's package: give yours another name"
    if isinstance(error, ModuleNotFoundError):
        return "; a plug-in of several files is named as a module that Python can import"
    return environment.hint(error)
