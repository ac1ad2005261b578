"""Preparation of a run: its cells, their engine, and all that could refuse it, before anything is written."""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from harness.api.request import RunRequest, resolve
from harness.engines import scratch
from harness.engines.jobs import Engine as Running
from harness.process.environment import numeric
from harness.records import Cell, CellResult
from harness.registry import BUILT_IN, KNOWN, BadInput, EngineName, keys, packages, plugins
from harness.registry.names import LOGS
from harness.schedule.progress import tell
from harness.store import baseline
from harness.store.opening import holds_run, open_to_plan, open_to_verify
from harness.store.request import Request

if TYPE_CHECKING:
    from harness.demonstrations.reading import Demonstrations

DEFAULT = Path("results/latest")
"""The directory of a run that names no other."""


@dataclass(frozen=True)
class Engine:
    """The processes that compute the cells of a run."""

    name: EngineName = "isolated"
    """'isolated': worker processes of this machine. 'ray': those of a Ray cluster. 'inline': this process."""
    workers: int | None = None
    """Processes at a time; None for the cores, or those of the cluster."""
    cell_timeout: float | None = None
    """Seconds after which a cell is stopped."""
    address: str | None = None
    """The address of a Ray cluster, or 'auto'; without one Ray starts here."""
    logs: Sequence[str] = ()
    """'tensorboard', 'wandb' or both: where curves are written while cells run (`harness.schedule.logs`)."""

    def __post_init__(self) -> None:
        if self.address and self.name != "ray":
            raise BadInput("--address is of a Ray cluster; add --engine ray")
        if self.logs and self.name == "ray":
            raise BadInput("--log is of processes of this machine; leave out --engine ray")
        if unknown := [log for log in self.logs if log not in LOGS]:
            raise BadInput(f"logs are {' and '.join(LOGS)}, not {unknown[0]!r:.40}")
        if self.name == "inline" and (self.workers or self.cell_timeout):
            raise BadInput("--engine inline computes one cell after the other and cannot stop any")

    def for_request(self, request: Request) -> Running:
        """Return the engine for these cells. Raises BadInput where no Ray cluster can be reached."""
        from harness.engines import inline, processes

        # Plug-ins' modules are imported in their own cells alone.
        modules = [KNOWN.entries["env"][env].module for env in request.envs if env in BUILT_IN["env"]]
        fixed = request.conditions.deterministic
        if self.name == "ray":
            from harness.engines import ray

            workers = self.workers or (None if self.address else cores())
            return ray.Ray(self.address or "", workers, self.cell_timeout, fixed, modules)
        if self.name == "inline":
            return inline.Inline()
        return processes.Processes(self.workers or cores(), self.cell_timeout, fixed, modules)


ISOLATED = Engine()
"""The engine of a run that names no other."""


@dataclass(frozen=True)
class Prepared:
    """A request that can be computed, with its engine, and results of other runs that it is shown beside."""

    request: Request
    engine: Running
    directory: Path
    demonstrations: Demonstrations | None = None
    beside: Sequence[CellResult] = ()
    retry_failed: bool = False
    logs: Sequence[str] = ()

    def missing(self, results: Mapping[Cell, CellResult], beside: Collection[Cell]) -> list[Cell]:
        """Return the cells that have to be computed."""
        again = {cell for cell, result in results.items() if self.retry_failed and result.has_failed}
        there = {*results, *beside}
        return [cell for cell in self.request.cells if cell not in there or cell in again]


def prepare(
    asked: RunRequest,
    engine: Engine = ISOLATED,
    directory: Path = DEFAULT,
    retry_failed: bool = False,
    only_plan: bool = False,
) -> Prepared:
    """Return a request with all that its computation needs. Nothing is written.

    `only_plan`: True where nothing will be computed, so that no library for it is needed.
    Raises BadInput for a request that cannot be computed.
    """
    if not only_plan:
        check_libraries()
    request, demonstrations = resolve(asked, engine.name != "inline")
    running = engine.for_request(request)
    if engine.name == "inline":
        _check_cells_of_other_engines(directory, running)
    beside, left_out = list[CellResult](), list[str]()
    if len(asked.baseline):
        paths = [Path(path) for path in asked.baseline]
        beside, left_out = baseline.comparable(paths, request, running.variables)
    for line in left_out:
        tell(f"left out of the baseline: {line}")
    prepared = Prepared(request, running, directory, demonstrations, beside, retry_failed, engine.logs)
    if engine.name == "inline":
        _check_plugins_inline(prepared)
    return prepared


def check_libraries() -> None:
    """Raise BadInput where nothing could be computed or drawn. Delete what killed runs left."""
    scratch.remove_abandoned(scratch.base())
    packages.versions(packages.PACKAGES)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # such as where it would keep fonts
    try:
        for module in ("harness.engines.processes", "harness.schedule.grid", "harness.report.files"):
            importlib.import_module(module)
    except (ImportError, ValueError, SyntaxError) as error:  # such as from a binary matplotlibrc
        raise BadInput(f"nothing can draw the report: {error}") from error


def _check_cells_of_other_engines(directory: Path, engine: Running) -> None:
    """Raise BadInput where the directory holds valid cells of another engine, which would be replaced."""
    if not holds_run(directory):
        return
    with open_to_verify(directory) as run:
        results, _ = run.load()
        conditions = run.request.conditions
    others = keys.cell_keys(results, conditions, numeric(conditions.deterministic))
    now = keys.cell_keys(results, conditions, engine.variables)
    if any(others[cell] == result.key != now[cell] for cell, result in results.items()):
        raise BadInput(
            f"{directory} holds cells that were computed otherwise; give another --out", "commands"
        )


def _check_plugins_inline(prepared: Prepared) -> None:
    """Raise BadInput where plug-ins may change what other cells compute in this process."""
    with open_to_plan(prepared.directory, prepared.request, prepared.engine.variables) as run:
        cells = prepared.missing(run.load()[0], [result.cell for result in prepared.beside])
    shared: list[tuple[Sequence[str], str]] = [((), env) for env in {cell.env for cell in cells}]
    plugins.check_inline([*shared, *(((cell.method,), cell.env) for cell in cells)])


def cores() -> int:
    """Return the number of processes that can work at a time."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
