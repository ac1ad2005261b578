"""Tasks of Gymnasium by their id alone ('gym:ID'), and the modules that tasks are registered with."""

from __future__ import annotations

import dataclasses
import json
import warnings
from typing import TYPE_CHECKING, Any

from harness.registry import packages
from harness.registry.known import GYMNASIUM_NAME, KNOWN, NAME, SPECS
from harness.registry.names import ENVS, BadInput, Entry
from harness.registry.sources import Sources, sources_of

if TYPE_CHECKING:
    import gymnasium

    from envs import EnvSpec

GYMNASIUM = "gym:"
"""Beginning of an id where tasks are named."""


class _Tasks(dict[str, "EnvSpec"]):
    """Specs by id, each derived when it is asked for."""

    def __missing__(self, env_id: str) -> EnvSpec:
        from gymnasium import registry

        from envs import from_gymnasium

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Gymnasium warns of newer versions of the task.
            spec = from_gymnasium(env_id, name_of(env_id))
        if env_id not in registry:  # It made the latest version.
            raise BadInput(f"{env_id} names no version of the task; give its whole id, such as {env_id}-v1")
        self[env_id] = spec
        return spec


TASKS = _Tasks()


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


def name_of(env_id: str) -> str:
    """Return the name of a task of Gymnasium here."""
    return f"{GYMNASIUM_NAME}{env_id.replace('/', '+')}"


def add_task(env_id: str) -> str:
    """Make a task of Gymnasium known, and return its name. Raises BadInput for an id that cannot be used."""
    name = name_of(env_id)
    if not env_id or not NAME.fullmatch(name) or "__" in name:
        raise BadInput(f"{env_id[:80]!r} is no id of Gymnasium that can be used: letters, digits, - and _")
    KNOWN.entries["env"][name] = Entry(f"{__name__}:TASKS/{env_id}", f"Gymnasium's {env_id}")
    return name


def task_or_name(name: str) -> str:
    """Return the name of a task that may be given as 'gym:ID', or as a run names that; it is known then.

    Raises BadInput as `add_task` does.
    """
    if name.startswith(GYMNASIUM_NAME):
        return add_task(name.removeprefix(GYMNASIUM_NAME).replace("+", "/"))
    return add_task(name.removeprefix(GYMNASIUM)) if name.startswith(GYMNASIUM) else name


def id_of(entry: Entry) -> str:
    """Return the id of a task that is known by it, '' for all others."""
    module, _, place = entry.target.partition(":")
    return place.partition("/")[2] if module == __name__ else ""


def try_out(env: str) -> None:
    """Step a task. Raises ValueError for what no task may give."""
    from envs.copies import try_out

    try_out(SPECS[env])


def modules_of(env_id: str) -> list[str]:
    """Return the modules of a task's class and of its wrappers, as they are registered."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    entries = [spec.entry_point, *(wrapper.entry_point for wrapper in spec.additional_wrappers)]
    return [module for module in map(_module_of, entries) if module]


def sources_of_id(env_id: str) -> Sources:
    """Return the sources of a task, and its registered arguments. Raises BadInput where these are objects."""
    import gymnasium

    spec = gymnasium.spec(env_id)
    registered = {
        "entry": str(spec.entry_point),
        "kwargs": spec.kwargs,
        "wrappers": [str(wrapper) for wrapper in spec.additional_wrappers],
        "max_episode_steps": spec.max_episode_steps,
    }
    try:
        arguments = json.dumps(registered, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"{env_id} is registered with arguments that are neither numbers nor texts ({error}); name it by "
            "an EnvSpec of a plug-in",
            "plugins",
        ) from error
    sources = sources_of(*modules_of(env_id))
    return dataclasses.replace(sources, digests=[*sources.digests, arguments])


def packages_of(env_id: str) -> dict[str, str]:
    """Return the versions of the packages that a task may need, its package's extras included.

    So a simulator counts that Gymnasium itself does not require.
    """
    import gymnasium

    module = _module_of(gymnasium.spec(env_id).entry_point)
    return packages.versions_of_module(module.partition(".")[0], extras=True)


def _module_of(entry: object) -> str:
    """Return the module of a registered class or function."""
    return entry.partition(":")[0] if isinstance(entry, str) else str(getattr(entry, "__module__", ""))
