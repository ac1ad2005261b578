"""Cells of other runs that a run is shown beside, so that they need not be computed again.

That is sound where experts, demonstrations and evaluation episodes are the same, which a task's version says
(`harness.run.keys.task_version`); machine and packages may be others, and are told.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from harness.judge.results import NOMINAL, PROGRAM_NAME, REFERENCE, UNSHOWN, Cell, CellResult, Request
from harness.registry import BadInput
from harness.run.keys import cell_keys, origin, task_of, task_version
from harness.run.request import REQUEST
from harness.run.store import open_to_verify

SAME, OTHER = "baseline", "baseline, of another machine or packages"
"""What is said of a row's source."""
DECIDING = ("budget", "protocol", "rl", "experts", "retrain", "demonstrations")
"""Conditions under which scores differ."""
OTHER_VERSION = "of another version of the task, its experts, or how policies are scored"


def comparable(paths: Sequence[Path], request: Request, variables: Mapping[str, str]) -> list[CellResult]:
    """Cells of the runs in these folders, or in folders of theirs, of the request's environments and what it
    shows, but none that failed. variables: those of the engine that computes the request.

    Raises BadInput where there is no run, or none that can be compared for one of the environments.
    """
    found: dict[Cell, CellResult] = {}
    tasks = tasks_now(request, variables)
    whys: dict[str, set[str]] = {env: set() for env in request.envs}
    for path in paths:
        runs = [path] if (path / REQUEST).exists() else sorted(f.parent for f in path.rglob(REQUEST))
        if not runs:
            raise BadInput(f"the baseline {path} holds no run")
        for folder in runs:
            with open_to_verify(folder) as run:
                results, conditions = run.load()[0], run.request.conditions
            differ = [
                f"{name} {getattr(conditions, name)}, not {getattr(request.conditions, name)}"
                for name in DECIDING
                if getattr(conditions, name) != getattr(request.conditions, name)
            ]
            for cell, result in results.items():
                failed = any(row.status == "failed" for row in result.rows)
                if failed or not _is_asked(cell, request):
                    continue
                if differ:
                    whys[cell.env].add(f"{folder.name} has {', '.join(differ)}")
                elif not is_comparable(result, tasks):
                    whys[cell.env].add(f"{folder.name} is {OTHER_VERSION}")
                elif cell not in found or _source(result) == SAME:
                    found[cell] = _marked(result)
    there = {cell.env for cell in found}
    for env in request.envs:
        if env not in there:
            raise BadInput(
                f"the baseline has no {env} that can be compared: {'; '.join(sorted(whys[env])) or 'none'}"
            )
    return [found[cell] for cell in sorted(found)]


def is_comparable(result: CellResult, tasks: Mapping[str, str]) -> bool:
    """Whether its scores mean what those of this version do: it notes the same version of its task, or has
    the key that cells of its task have now. tasks: of `tasks_now`."""
    env = result.cell.env
    return task_version(env) == result.task_version or task_of(result.key) == tasks[env]


def tasks_now(request: Request, variables: Mapping[str, str]) -> dict[str, str]:
    """By environment, the part of keys that its cells share."""
    keys = cell_keys([Cell(env, REFERENCE, 0) for env in request.envs], request.conditions, variables)
    return {cell.env: task_of(key) for cell, key in keys.items()}


def _is_asked(cell: Cell, request: Request) -> bool:
    """Whether the cell, of whatever method and seed, is of what the request compares."""
    return (
        cell.env in request.envs
        and (cell.dynamics == NOMINAL or cell.task in request.variants)
        and (cell.method in UNSHOWN or cell.shown in request.shown)
    )


def _source(result: CellResult) -> str:
    theirs, ours = (
        {name: value for name, value in facts.items() if name != PROGRAM_NAME}
        for facts in (result.origin, origin())
    )
    return SAME if theirs == ours else OTHER


def _marked(result: CellResult) -> CellResult:
    """With its source in each row, and without files, which stay where they are."""
    rows = [dataclasses.replace(row, source=_source(result)) for row in result.rows]
    return dataclasses.replace(result, rows=rows, recordings={}, artifacts={})
