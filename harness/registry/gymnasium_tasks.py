"""Tasks of Gymnasium by their id alone ('gym:ID'), and this program's tasks in Gymnasium."""

from __future__ import annotations

import json
import warnings
from typing import TYPE_CHECKING, Any

from harness.registry import packages
from harness.registry.known import GYMNASIUM_MODULE, GYMNASIUM_NAME, KNOWN, NAME, SPECS
from harness.registry.names import ENVS, BadInput, Entry
from harness.registry.sources import Sources, sources_of

if TYPE_CHECKING:
    import gymnasium

    from envs import EnvSpec

GYMNASIUM = "gym:"
"""Beginning of an id where tasks are named."""


def register_tasks() -> None:
    """Register this program's tasks with Gymnasium, such as irl_bench/CartpoleSwingup-v0."""
    import gymnasium

    for env in ENVS:
        env_id = f"irl_bench/{''.join(map(str.capitalize, env.split('_')))}-v0"
        if env_id not in gymnasium.registry:
            entry_point = f"{__name__}:make"
            gymnasium.register(env_id, entry_point, disable_env_checker=True, kwargs={"env": env})


def make(env: str) -> gymnasium.Env[Any, Any]:
    """Return the environment of a task of this program."""
    return SPECS[env].make()


def task_or_name(name: str) -> str:
    """Return the name of a task that may be given as 'gym:ID', or as a run names that; it is known then.

    Raises BadInput for an id that cannot be used.
    """
    if not name.startswith((GYMNASIUM, GYMNASIUM_NAME)):
        return name
    env_id = name[len(GYMNASIUM_NAME) :]
    if name.startswith(GYMNASIUM_NAME):
        env_id = env_id.replace("+", "/")
    name = f"{GYMNASIUM_NAME}{env_id.replace('/', '+')}"
    if not env_id or not NAME.fullmatch(name) or "__" in name:
        raise BadInput(f"{env_id[:80]!r} is no id of Gymnasium that can be used: letters, digits, - and _")
    KNOWN.entries["env"][name] = Entry(f"{GYMNASIUM_MODULE}:{env_id}", f"Gymnasium's {env_id}")
    return name


def derived(env_id: str, name: str) -> EnvSpec:
    """Return the spec of a task of Gymnasium. Raises BadInput where the id names no version."""
    from gymnasium import registry

    from envs import from_gymnasium

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium warns of newer versions of the task.
        spec = from_gymnasium(env_id, name)
    if env_id not in registry:  # It made the latest version.
        raise BadInput(f"{env_id} names no version of the task; give its whole id, such as {env_id}-v1")
    return spec


def modules_of(env_id: str) -> list[str]:
    """Return the modules of a task's class and of its wrappers, as they are registered."""
    import gymnasium

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


def registered(env_id: str) -> str:
    """Return what a task is registered with, as JSON. Raises BadInput where that holds objects."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    facts = {
        "entry": str(spec.entry_point),
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
