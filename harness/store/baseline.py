"""Baselines: cells of other runs beside a run's own, which need not be computed again.

Scores can be compared where experts, demonstrations and evaluation episodes are the same
(`harness.registry.keys.task_version`) and the methods are those of this version (the second half of a key).
Another machine and other packages are allowed, and reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from harness.records import CONTROL_METHODS, NOMINAL, PROGRAM_NAME, REFERENCE, UNSHOWN, Cell, CellResult
from harness.registry import KNOWN, BadInput
from harness.registry.bounds import LONGEST_TEXT
from harness.registry.keys import cell_keys, experts_version, method_of, task_of, task_version
from harness.registry.machine import origin
from harness.store.codec import printable
from harness.store.database import FILE
from harness.store.opening import open_to_verify
from harness.store.request import Request

MACHINE = ("processor", "family, model, stepping", "instructions", "system")
"""Names of the machine's properties, among packages, in the origin of a result."""
DECIDING = (
    *("budget", "protocol", "rl", "experts", "retrain", "demonstrations", "learner", "solves"),
    *("env_kwargs", "env_vars", "encoder"),
)
"""Conditions under which scores differ."""
OTHER_VERSION = "of another version of the task, its experts, or how policies are scored"


def comparable(
    paths: Sequence[Path], request: Request, variables: Mapping[str, str]
) -> tuple[list[CellResult], list[str]]:
    """Return the cells of the runs in these folders or below that can be compared, and a line for each reason
    to leave others out. Failed cells are left out, too.

    `variables`: those of the engine that computes the request.
    Raises BadInput where a folder holds no run, or an environment has no cell that can be compared.
    """
    chosen: dict[Cell, CellResult] = {}
    versions: dict[Cell, tuple[str, str]] = {}
    """The key of a method, by its cells but for their seed, and the run that has it."""
    tasks = tasks_now(request, variables)
    left_out: dict[str, set[str]] = {env: set() for env in ("", *request.envs)}
    for folder in [run for path in paths for run in _runs(path)]:
        with open_to_verify(folder) as run:
            (results, unusable), conditions = run.load(), run.request.conditions
            beside, damaged = run.beside()
        results = {result.cell: result for result in beside} | results
        left_out[""] |= {f"{file}: {why}" for file, why in (unusable | damaged).items()}
        words = {name: (conditions.in_words(name), request.conditions.in_words(name)) for name in DECIDING}
        differ = [f"{name} {theirs}, not {ours}" for name, (theirs, ours) in words.items() if theirs != ours]
        for env, line in _shown_otherwise(results, request).items():
            left_out[env].add(f"methods in {folder.name} were shown {line}")
        asked = {cell: result for cell, result in results.items() if _is_asked(cell, request)}
        now = _methods_now(asked, request, variables)
        for cell, result in asked.items():
            unseeded, its = dataclasses.replace(cell, seed=0), method_of(result.key)
            first, where = versions.get(unseeded, (its, folder.name))
            why = ""
            if any(row.status == "failed" for row in result.rows):
                continue
            if differ:
                why = f"{folder.name} has {', '.join(differ)}"
            elif not is_comparable(result, tasks, request):
                why = f"{folder.name} is {OTHER_VERSION}"
            elif now.get(cell, its) != its:
                why = f"{cell.method} in {folder.name} is of another version of the method"
            elif first != its:
                why = f"{cell.method} in {folder.name} is of another version than in {where}"
            elif cell not in chosen or not _other(result, True):
                versions[unseeded] = its, where
                alike = conditions.deterministic == request.conditions.deterministic
                chosen[cell] = _marked(result, folder.name, alike)
            if why:
                left_out[cell.env].add(why)
    for env in {*request.envs} - {cell.env for cell in chosen}:
        its_files = [line for line in left_out[""] if f"/{env}__" in line]
        why = "; ".join(sorted(left_out[env]) or sorted(its_files)[:3]) or "none"
        raise BadInput(f"the baseline has no {env} that can be compared: {why}", page="plugins")
    return [chosen[cell] for cell in sorted(chosen)], sorted(set[str]().union(*left_out.values()))


def _runs(path: Path) -> list[Path]:
    """Return the run in a folder, or the runs below. Raises BadInput if the folder holds no run."""
    runs = [path] if (path / FILE).exists() else sorted(file.parent for file in path.rglob(FILE))
    if not runs:
        raise BadInput(f"the baseline {path} holds no run", page="plugins")
    return runs


def is_comparable(result: CellResult, tasks: Mapping[str, str], request: Request) -> bool:
    """Return whether a result's scores mean what those of this version do.

    Its key must be that of its task's cells now. With shipped experts the same version of the task suffices.
    `tasks`: of `tasks_now`.
    """
    env = result.cell.env
    shipped = request.conditions.experts == "shipped" and experts_version(env)
    same = bool(shipped) and task_version(env) == result.task_version
    return same or task_of(result.key) == tasks[env]


def tasks_now(request: Request, variables: Mapping[str, str]) -> dict[str, str]:
    """Return the part of keys that an environment's cells share, by environment."""
    keys = cell_keys([Cell(env, REFERENCE, 0) for env in request.envs], request.conditions, variables)
    return {cell.env: task_of(key) for cell, key in keys.items()}


def _methods_now(cells: Iterable[Cell], request: Request, variables: Mapping[str, str]) -> dict[Cell, str]:
    """Return the keys of the known methods, by cell."""
    known = {*KNOWN.entries["method"], *CONTROL_METHODS, REFERENCE}
    keys = cell_keys([cell for cell in cells if cell.method in known], request.conditions, variables)
    return {cell: method_of(key) for cell, key in keys.items()}


def _is_asked(cell: Cell, request: Request) -> bool:
    """Return whether the request compares cells like this one, of any method and seed."""
    return (
        cell.env in request.envs
        and (cell.dynamics == NOMINAL or cell.task in request.variants)
        and (cell.method in UNSHOWN or cell.shown in request.shown)
    )


def _shown_otherwise(cells: Iterable[Cell], request: Request) -> dict[str, str]:
    """Return in words what methods were shown, by environment, where none was shown what the request asks."""
    words = "as many demonstrations as the budget says"
    asked = " or ".join(str(one) or words for one in sorted(request.shown))
    lines = {}
    for env in request.envs:
        shown = {cell.shown for cell in cells if cell.env == env and cell.method not in UNSHOWN}
        if shown and not shown & {*request.shown}:
            theirs = " or ".join(str(one) or words for one in sorted(shown))
            lines[env] = f"{theirs}, and here {asked} (--demos, --subsample, --demonstrator)"
    return lines


def _other(result: CellResult, alike: bool) -> list[str]:
    """Return how the machine of a result differs from this one. `alike`: instructions were fixed alike."""
    theirs, ours = result.origin, origin()
    differ = {name for name in {*theirs, *ours} - {PROGRAM_NAME} if theirs.get(name) != ours.get(name)}
    packages = sorted(differ - {*MACHINE})
    words = ["another machine"] if differ & {*MACHINE} else []
    words += [f"other packages ({', '.join(packages)})"] if packages else []
    return words if alike else [*words, "other instructions"]


def _marked(result: CellResult, run: str, alike: bool) -> CellResult:
    """Return a result with its source in each row, and without files, which stay where they are."""
    others = _other(result, alike)
    source = f"baseline {printable(run)}" + (f", of {' and '.join(others)}" if others else "")
    rows = [dataclasses.replace(row, source=source[:LONGEST_TEXT]) for row in result.rows]
    return dataclasses.replace(result, rows=rows, recordings={}, learned="")
