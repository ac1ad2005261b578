"""Tasks of Gymnasium by their id alone ('gym:ID' or 'gym:MODULE:ID'), and this program's in Gymnasium."""

from __future__ import annotations

import importlib
import json
import warnings
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from harness.registry import ours, packages
from harness.registry.built_in import BUILT_IN, Entry
from harness.registry.known import GYMNASIUM_MODULE, GYMNASIUM_NAME, KNOWN, NAME, SPECS, id_of
from harness.registry.names import BadInput
from harness.registry.sources import Sources, sources_of

if TYPE_CHECKING:
    import gymnasium

    from envs import EnvSpec

GYMNASIUM = "gym:"
"""Beginning of an id where tasks are named."""


def register_tasks() -> None:
    """Register this program's tasks with Gymnasium, such as irl_bench/CartpoleSwingup-v0."""
    import gymnasium

    for env in BUILT_IN["env"]:
        env_id = f"irl_bench/{''.join(map(str.capitalize, env.split('_')))}-v0"
        if env_id not in gymnasium.registry:
            entry_point = f"{__name__}:make"
            gymnasium.register(env_id, entry_point, disable_env_checker=True, kwargs={"env": env})


@ours.meanwhile()
def make(env: str) -> gymnasium.Env[Any, Any]:
    """Return the environment of a task of this program."""
    return SPECS[env].make()


def task_or_name(name: str, env_kwargs: str | None = None) -> str:
    """Return the name of a task that may be given as 'gym:ID', 'gym:MODULE:ID', or as a run names those.

    It is known then. env_kwargs: its arguments, of `as_json`; None for `KNOWN.env_kwargs`.
    Raises BadInput for an id that cannot be used.
    """
    if not name.startswith((GYMNASIUM, GYMNASIUM_NAME)):
        return name
    module, _, env_id = name[len(GYMNASIUM_NAME) :].rpartition(":")
    if name.startswith(GYMNASIUM_NAME):
        env_id = env_id.replace("+", "/")
    name = f"{GYMNASIUM_NAME}{env_id.replace('/', '+')}"
    if not env_id or not NAME.fullmatch(name) or "__" in name:
        raise BadInput(f"{env_id[:80]!r} is no id of Gymnasium that can be used: letters, digits, - and _")
    if module:
        KNOWN.registered.setdefault(env_id, module)
    kwargs = KNOWN.env_kwargs if env_kwargs is None else env_kwargs
    entry = Entry(f"{GYMNASIUM_MODULE}:{env_id} {kwargs}".strip(), f"Gymnasium's {env_id}")
    if KNOWN.entries["env"].get(name) != entry:
        KNOWN.specs.pop(name, None)
    KNOWN.entries["env"][name] = entry
    return name


def module_in(name: str) -> str:
    """Return the module that 'gym:MODULE:ID' names, '' for other names."""
    return name[len(GYMNASIUM) :].rpartition(":")[0] if name.startswith(GYMNASIUM) else ""


def as_json(kwargs: Mapping[str, Any]) -> str:
    """Return arguments of a task as JSON, '' for none. Raises BadInput where JSON cannot hold them."""
    try:
        return json.dumps(kwargs, sort_keys=True) if kwargs else ""
    except (TypeError, ValueError) as error:
        raise BadInput(f"arguments of tasks must be what JSON can hold: {error}", "plugins") from error


def kwargs_of(entry: Entry) -> str:
    """Return the arguments of a task that is known by its id, of `as_json`."""
    return entry.target.partition(" ")[2]


def check_kwargs(envs: Sequence[str]) -> None:
    """Raise BadInput where arguments are given, and not all tasks are known by their id."""
    others = [env for env in envs if not env.startswith(GYMNASIUM_NAME)]
    if KNOWN.env_kwargs and (others or not envs):
        raise BadInput(
            f"--env-kwargs are arguments of tasks gym:ID, not of {', '.join(others) or 'methods'}; another "
            "task has them in the kwargs of its EnvSpec",
            "plugins",
        )


def find(env_id: str) -> None:
    """Import the module that registers a task, where one was named, or highway-env for its tasks."""
    from gymnasium import registry

    if module := KNOWN.registered.get(env_id):
        KNOWN.module(module)
    elif env_id not in registry:
        with suppress(ImportError):
            importlib.import_module("highway_env")


def derived(entry: Entry, name: str) -> EnvSpec:
    """Return the spec of a task of Gymnasium. Raises BadInput where the id names no version."""
    from gymnasium import registry

    from envs import from_gymnasium

    find(env_id := id_of(entry))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium warns of newer versions of the task.
        spec = from_gymnasium(env_id, name, kwargs=json.loads(kwargs_of(entry) or "{}"))
    if env_id not in registry:  # It made the latest version.
        raise BadInput(f"{env_id} names no version of the task; give its whole id, such as {env_id}-v1")
    return spec


def modules_of(env_id: str) -> list[str]:
    """Return the modules of a task's class and of its wrappers, as they are registered."""
    import gymnasium

    find(env_id)
    spec = gymnasium.spec(env_id)
    entries = [spec.entry_point, *(wrapper.entry_point for wrapper in spec.additional_wrappers)]
    modules = [one.partition(":")[0] if isinstance(one, str) else one.__module__ for one in entries if one]
    return [*filter(None, modules)]


def sources_of_task(env_id: str, *modules: str) -> Sources:
    """Return the sources of a task of Gymnasium, and of these modules.

    The packages that the task may need count, its package's extras included: simulators are among them.
    """
    theirs = modules_of(env_id)
    sources = sources_of(*modules, *theirs)
    needed = packages.versions_of_module(theirs[0].partition(".")[0], extras=True)
    versions = [f"{name} {version}" for name, version in needed.items()]
    return Sources([*sources.digests, *versions], sources.program)


def sources_of_id(env_id: str) -> Sources:
    """Return the sources of a task that is known by its id, and what it is registered with."""
    sources = sources_of_task(env_id)
    return Sources([*sources.digests, _registered(env_id)], sources.program)


def registered_by(module: str, before: Collection[str]) -> list[str]:
    """Return the ids of others' tasks that a module has registered: those that are not among `before`, and
    those of its own classes."""
    import gymnasium

    own = module.partition(".")[0]
    tops = {env_id: _top(env_id) for env_id in gymnasium.registry}
    return [one for one, top in tops.items() if top == own or (one not in before and top not in ours.PROGRAM)]


def _top(env_id: str) -> str:
    import gymnasium

    entry = gymnasium.registry[env_id].entry_point
    module = entry.partition(":")[0] if isinstance(entry, str) else getattr(entry, "__module__", None)
    return (module or "").partition(".")[0]


def _registered(env_id: str) -> str:
    """Return what a task is registered with, as JSON. Raises BadInput where that holds objects."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    entry: Any = spec.entry_point
    place = f"{entry.__module__}:{entry.__qualname__}" if hasattr(entry, "__qualname__") else entry
    facts = {
        "entry": place,
        "kwargs": spec.kwargs,
        "wrappers": [str(wrapper) for wrapper in spec.additional_wrappers],
        "max_episode_steps": spec.max_episode_steps,
    }
    try:
        return json.dumps(facts, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"{env_id} is registered with arguments that are neither numbers nor texts ({error}); name it by "
            "an EnvSpec of a plug-in",
            "plugins",
        ) from error
