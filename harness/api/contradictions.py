"""Options of a run that contradict each other, or its methods and tasks."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING

from harness.registry import ASKING, ENCODERS, KNOWN, base, keys, plugins
from harness.registry.packages import to_install

if TYPE_CHECKING:
    from harness.api.request import RunRequest


def contradictions(asked: RunRequest, methods: Sequence[str], envs: Sequence[str]) -> Iterator[str]:
    """Yield a line for each pair of options that contradict each other, with the way out."""
    if asked.solves and not asked.retrain:
        yield "--solves is how often RL solves R*; leave out --no-retrain"
    if asked.learner == "ddpg" and (discrete := [env for env in envs if plugins.task(env).discrete]):
        yield f"actions of {', '.join(discrete)} are choices, and DDPG has none; leave them out of --envs"
    for env in envs:
        if (needs := KNOWN.entries["env"][env].needs) and not importlib.util.find_spec(needs):
            yield f"{env} needs {needs}: {to_install(needs.lower())}"
    if asked.encoder:
        if blind := [env for env in envs if not plugins.task(env).encoder]:
            yield f"{', '.join(blind)} has no images for --encoder"
        module, _, attribute = asked.encoder.partition(":")
        if asked.encoder not in ENCODERS and not (module and attribute):
            yield f"--encoder must be {', '.join(ENCODERS)} or module:Class, not {asked.encoder!r:.40}"
        folders = [str(Path(one.place).parent) for one in KNOWN.plugins.values() if one.is_file]
        if attribute and (file := _file_of(module, [*folders, *sys.path])) is None:
            yield f"no module {module!r:.40} for --encoder: install it, or put it beside a named plug-in"
        elif attribute and file and _lacks(file, attribute):
            yield f"{file} has no {attribute!r:.40} for --encoder"
    if asked.experts == "none":
        if not asked.files:
            yield "--experts none is for demonstrations of a file: --demos-from"
        if asked.transfer:
            yield "--transfer carries the expert over; leave out --experts none"
        if asking := [method for method in methods if base(method) in ASKING]:
            yield f"{asking[0]} asks the expert while it learns; leave out --experts none"
    if asked.files and (len(envs) != 1 or asked.demonstrator != "expert"):
        yield "--demos-from is for one environment, and leaves out --demonstrator"
    if len({path.resolve() for path in asked.files}) < len(asked.files):
        yield "--demos-from names a file twice, whose demonstrations would count twice; leave one out"
    for option in ("action_bounds", "last_observation", "obs_keys", "preferences"):
        if getattr(asked, option) and not asked.files:
            yield f"--{option.replace('_', '-')} is for demonstrations of a file: --demos-from"
    if asked.demonstrator in ("medium", "ranked"):
        if asked.experts == "trained":
            yield "medium demonstrators are shipped ones; leave out --experts trained"
        if lacking := [env for env in envs if not keys.expert_files(env)]:
            yield f"there are no medium demonstrators of {', '.join(lacking)}; leave it out of --envs"
    if asked.transfer and not asked.retrain:
        yield "--transfer scores by what RL reaches in a variant; leave out --no-retrain"


def _file_of(module: str, path: Sequence[str] | None) -> str | None:
    """Return the file of a module, '' for a folder without one, None for neither. No code of it runs."""
    found = None
    for part in module.split("."):
        if path is None or (found := PathFinder.find_spec(part, path)) is None:
            return None
        path = found.submodule_search_locations
    return (found and found.origin) or ""


def _lacks(file: str, name: str) -> bool:
    """Return whether a source file says nothing of a name, nor takes names from others."""
    text = Path(file).read_text(encoding="utf-8", errors="replace") if file.endswith(".py") else name
    return not re.search(rf"\b{re.escape(name)}\b|import \*|__getattr__", text)
