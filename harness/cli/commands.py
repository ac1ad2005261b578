"""The commands `run`, `reproduce` and `report`. Each returns the exit code (`harness.cli`)."""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from harness.cell.given import store
from harness.cli import outcome
from harness.engines import scratch
from harness.engines.jobs import Engine
from harness.process.environment import cache_folder, can_fix_instructions, numeric
from harness.process.signals import stop_cleanly
from harness.records import Cell, CellResult, Conditions, Shown, failed_rows
from harness.registry import ASKING, ENVS, SPECS, BadInput, Unfinished, choose, keys, packages, plugins
from harness.registry.gymnasium_tasks import task_or_name
from harness.registry.known import GYMNASIUM_NAME, KNOWN
from harness.schedule.progress import progress_for, say, tell
from harness.store import baseline
from harness.store.files import can_write
from harness.store.opening import (
    holds_run,
    merged,
    open_for_report,
    open_for_run,
    open_to_plan,
    open_to_verify,
)
from harness.store.request import Request
from harness.store.store import LOG, Store

if TYPE_CHECKING:
    from harness.demonstrations.reading import Demonstrations

LEFT_OUT = "left out, computed again if asked for"


def run(args: argparse.Namespace) -> int:
    """Computes what is asked for and not there yet, and reports all that is there; or plans that."""
    if args.plan and args.json_progress:
        raise BadInput("a plan is text; leave out --json-progress", page="commands")
    methods, envs = _named(args)
    if not args.plan:
        _prepare()
    seeds = args.seeds or tuple(range(5 if args.budget == "full" else 1))
    fixed = _is_deterministic(args)
    conditions = Conditions(
        *(args.budget, args.protocol, args.rl, fixed, args.experts, args.record, not args.no_retrain),
        learner=args.learner,
        solves=args.solves,
    )
    if args.solves and args.no_retrain:
        raise BadInput("--solves is how often RL solves R*; leave out --no-retrain")
    if args.learner == "ddpg" and (choices := [env for env in envs if plugins.task(env).discrete]):
        raise BadInput(
            f"actions of {', '.join(choices)} are choices, and DDPG has none; leave them out of --envs"
        )
    if args.experts == "none":
        _check_without_expert(args, methods)
    shown = tuple(Shown(demos, args.subsample, args.demonstrator) for demos in args.demos)
    given = _given(args, envs) if args.demos_from else None
    if given:
        conditions = replace(conditions, demonstrations=str(given))
    elif args.action_bounds:
        raise BadInput("--action-bounds are of demonstrations of a file: --demos-from")
    if args.demonstrator == "medium":
        if args.experts == "trained":
            raise BadInput("medium demonstrators are shipped ones; leave out --experts trained")
        if none := [env for env in envs if not keys.expert_files(env)]:
            raise BadInput(f"there are no medium demonstrators of {', '.join(none)}; leave it out of --envs")
    if args.transfer is not None and args.no_retrain:
        raise BadInput("--transfer scores by what RL reaches in a variant; leave out --no-retrain")
    variants = () if args.transfer is None else _variants(envs, args.transfer)
    request = Request(methods, envs, seeds, conditions, shown, variants)
    handle_signals()
    engine = _engine(args, envs)
    if args.engine == "inline":
        _check_all_inline(args.out, engine)
    beside, left_out = list[CellResult](), list[str]()
    if args.baseline:
        beside, left_out = baseline.comparable(args.baseline, request, engine.variables)
    for line in left_out:
        tell(f"left out of the baseline: {line}")
    if args.engine == "inline":
        _check_plugins_inline(args, request, engine, beside)
    if args.plan:
        return _plan(args, request, engine, beside)
    if given:
        store(str(given), given.episodes, given.rewards)
    with (
        outcome.for_programs(args.json_progress) as programs,
        open_for_run(args.out, request, engine.variables) as run,
    ):
        if beside:
            run.keep_beside(beside)
        finished = True
        try:
            results = _compute(run, request, args, engine, programs)
        except Unfinished as error:
            tell(str(error))
            results, finished = run.load()[0], False
            if not results:
                return 1
        whole = outcome.report(run, list(results.values()), anew=False, programs=programs)
        asked = [results[cell] for cell in request.cells if cell in results]
        failed = outcome.tell_troubles(asked, request.conditions.budget, run.beside()[0])
    return int(failed or not whole or not finished)


def reproduce(args: argparse.Namespace) -> int:
    """The study of the thesis, once under each protocol."""
    from harness.benchmarks import reproduce as study
    from harness.report.terminal import wrapped

    _prepare()
    handle_signals()
    engine, found = _engine(args, study.ENVS), {}
    with study.open_study(args.out):
        requests, fixed = {}, _is_deterministic(args)
        for protocol in study.PROTOCOLS:
            conditions = Conditions(
                *(args.budget, protocol, "sbx", fixed, "trained", args.record),
                learner=study.LEARNER,
                solves=study.SOLVES,
            )
            shown = tuple(map(Shown, study.TRAJECTORIES))
            requests[protocol] = Request(study.STUDIED, study.ENVS, args.seeds, conditions, shown)
            merged(args.out / protocol, requests[protocol])  # refused now, and not hours later
        for protocol, request in requests.items():
            with (
                outcome.for_programs(args.json_progress) as programs,
                open_for_run(args.out / protocol, request, engine.variables) as run,
            ):
                results = _compute(run, request, args, engine, programs)
            found[protocol] = [results[cell] for cell in request.cells]
        study.write_study(args.out, found)
        for line in ["", *study.closing_lines(found, args.out)]:
            say(wrapped(line))
    return int(
        outcome.tell_troubles([result for results in found.values() for result in results], args.budget)
    )


def report(directory: Path, tables: bool) -> int:
    """Rebuilds tables and figures from the cells that are stored there. tables: whether they are printed."""
    _prepare()
    with open_for_report(directory) as run:
        results, unusable = run.load()
        outcome.tell_unusable(unusable, "left out")
        if not results and not run.beside()[0]:
            raise BadInput(f"{directory} holds no finished cell")
        whole = outcome.report(run, list(results.values()), anew=True, tables=tables)
        beside, _ = run.beside()
    failed = outcome.tell_troubles(list(results.values()), run.request.conditions.budget, beside)
    return int(failed or not whole or bool(unusable))


def _check_without_expert(args: argparse.Namespace, methods: Sequence[str]) -> None:
    """Raises BadInput for what needs one."""
    if not args.demos_from:
        raise BadInput("--experts none is for demonstrations of a file: --demos-from")
    if args.transfer is not None:
        raise BadInput("--transfer carries the expert over; leave out --experts none")
    if asking := [method for method in methods if method in ASKING]:
        raise BadInput(f"{asking[0]} asks the expert while it learns; leave out --experts none")


def _given(args: argparse.Namespace, envs: Sequence[str]) -> Demonstrations:
    """The demonstrations of a file. Raises BadInput for those that cannot be shown."""
    from harness.cli import exchange
    from harness.demonstrations.reading import read

    if len(envs) != 1 or args.demonstrator != "expert":
        raise BadInput("--demos-from is for one environment, and leaves out --demonstrator")
    found = read(args.demos_from, SPECS[envs[0]], exchange.bounds(args.action_bounds))
    if args.experts == "none" and found.returns is None:
        raise BadInput(
            f"{args.demos_from} tells no rewards, so nothing would score 1; leave out --experts none"
        )
    if args.experts == "none" and found.cut:
        raise BadInput(
            f"{found.cut} of the {len(found.episodes)} episodes of {args.demos_from} neither terminated nor "
            "last until the horizon, so what they return is no score; leave out --experts none"
        )
    if max(args.demos) > len(found.episodes):
        raise BadInput(f"{args.demos_from} has {len(found.episodes)} demonstrations, not {max(args.demos)}")
    return found


def _prepare() -> None:
    """Raises BadInput where nothing could be computed or drawn, before anything is written."""
    scratch.remove_abandoned(scratch.base())
    packages.versions(packages.PACKAGES)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # such as where it would keep fonts
    try:
        importlib.import_module("harness.engines.processes")
        importlib.import_module("harness.schedule.grid")
        importlib.import_module("harness.report.files")
    except (ImportError, ValueError, SyntaxError) as error:  # such as from a binary matplotlibrc
        raise BadInput(f"nothing can draw the report: {error}") from error


def _named(args: argparse.Namespace) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Methods and environments, those of plug-ins included, which are imported. Raises BadInput for what
    there is not, and where one is broken."""
    plugins.add(args.plugin, [args.methods, args.envs])
    envs = ",".join(task_or_name(name.strip()) for name in args.envs.split(","))
    methods, chosen = KNOWN.chosen_methods(args.methods), KNOWN.chosen_envs(envs)
    plugins.load([], [env for env in chosen if env.startswith(GYMNASIUM_NAME)])
    return methods, chosen


def _variants(envs: Sequence[str], names: str) -> tuple[str, ...]:
    """Tasks of other dynamics, those of these names or all. Raises BadInput where there are none, or they
    cannot be told."""
    entries, theirs = KNOWN.entries["env"], KNOWN.of_plugins("env")
    try:
        known = {env: entries[env].variants if env in theirs else SPECS[env].variants for env in envs}
        found = [f"{env}.{name}" for env in envs for name in known[env]]
    except Exception as error:  # whatever is wrong with an environment's file
        raise BadInput(f"an environment cannot be loaded: {type(error).__name__}: {error}") from error
    if not found:
        raise BadInput(f"there are no other dynamics of {', '.join(envs)} to carry anything over to")
    named = dict.fromkeys(variant.partition(".")[2] for variant in found)
    chosen = choose("variant", names, named)
    if "all" not in map(str.strip, names.split(",")):
        for env in envs:
            if lacking := [name for name in chosen if f"{env}.{name}" not in found]:
                tell(f"{env} has no variant {', '.join(lacking)}")
    return tuple(variant for variant in found if variant.partition(".")[2] in chosen)


def _engine(args: argparse.Namespace, envs: Sequence[str]) -> Engine:
    """Return the engine for the cells of these environments. Raises BadInput for options that it lacks."""
    from harness.engines import inline, processes

    # Those of plug-ins are imported in their own cells alone, which all others would share.
    modules = [ENVS[env].target.partition(":")[0] for env in envs if env in ENVS]
    fixed = _is_deterministic(args)
    if args.engine == "ray":
        from harness.engines import ray

        workers = args.workers or (None if args.address else cores())
        return ray.Ray(args.address or "", workers, args.cell_timeout, fixed, modules)
    if args.address:
        raise BadInput("--address is of a Ray cluster; add --engine ray")
    if args.engine == "isolated":
        return processes.Processes(args.workers or cores(), args.cell_timeout, fixed, modules)
    if args.workers or args.cell_timeout:
        raise BadInput("--engine inline computes one cell after the other and cannot stop any")
    return inline.Inline()


def _is_deterministic(args: argparse.Namespace) -> bool:
    """Return whether the instructions of cells' processes are fixed. Those of this process cannot be."""
    return args.engine != "inline" and not args.fast and can_fix_instructions()


def _check_all_inline(directory: Path, engine: Engine) -> None:
    """Raises BadInput where the directory holds cells of the other engine that still count, which inline ones
    would replace."""
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


def _check_plugins_inline(
    args: argparse.Namespace, request: Request, engine: Engine, baseline: Sequence[CellResult]
) -> None:
    """Raise BadInput where plug-ins may change what cells compute that are not theirs, in this process."""
    with open_to_plan(args.out, request, engine.variables) as run:
        known, _ = run.load()
    cells = _missing(request, known, [result.cell for result in baseline], args.retry_failed)
    shared: list[tuple[Sequence[str], str]] = [((), env) for env in {cell.env for cell in cells}]
    plugins.check_inline([*shared, *(((cell.method,), cell.env) for cell in cells)])


def _plan(args: argparse.Namespace, request: Request, engine: Engine, baseline: Sequence[CellResult]) -> int:
    """Says what the run would take, and neither computes nor writes anything."""
    from harness.schedule import plan

    with open_to_plan(args.out, request, engine.variables) as run:
        known, unusable = run.load()
        outcome.tell_unusable(unusable, LEFT_OUT)
        beside = run.without_its_own(baseline) if baseline else _beside(run, request, engine)
    cells = _missing(request, known, beside, args.retry_failed)
    kept = [cell in known for cell in {*request.cells}.difference(cells)]
    say(
        f"{len(request.cells):,} cells: {sum(kept):,} kept from before, in {args.out}; "
        f"{len(kept) - sum(kept):,} of a baseline; {len(cells):,} to run"
    )
    for line in plan.as_lines(plan.plan(cells, request.conditions, engine.variables)):
        say(line)
    return 0


def _missing(
    request: Request, known: Mapping[Cell, CellResult], beside: Collection[Cell], retry: bool
) -> list[Cell]:
    """The cells of the request that have to be computed. retry: those that failed, too."""
    again = {cell for cell, result in known.items() if retry and outcome.has_failed(result)}
    return [cell for cell in request.cells if (cell not in known and cell not in beside) or cell in again]


def _compute(
    run: Store, request: Request, args: argparse.Namespace, engine: Engine, programs: TextIO | None
) -> dict[Cell, CellResult]:
    """Computes what the request asks for and the directory lacks; returns all that is there then. programs:
    of `outcome.for_programs`."""
    from harness.schedule.events import Events
    from harness.schedule.grid import Grid

    known, unusable = run.load()
    outcome.tell_unusable(unusable, LEFT_OUT)
    beside = _beside(run, request, engine)
    cells = _missing(request, known, beside, args.retry_failed)
    kept = len(request.cells) - len(cells)
    conditions = request.conditions
    say(f"{len(cells)} cells to run, {kept} kept from before, {conditions.budget} budget, in {run.path}")
    if cells and not can_write(cache_folder()):
        tell(f"the cache {cache_folder()} cannot be written to: experts are trained for this run alone")
    told = progress_for if programs is None else partial(Events, stream=programs)
    grid = Grid(conditions, run, engine, told)
    grid.run(cells)
    results, _ = run.load()
    if lost := [cell for cell in request.cells if cell not in results and cell not in beside]:
        tell(f"lost or damaged while the run went on, computed again: {lost[0].name}, {len(lost)} in all")
        grid.run(lost)
        results, unusable = run.load()
        for cell in [cell for cell in lost if cell not in results]:
            reason = unusable.get(run.place(cell.name), "it is gone")
            results[cell] = failed_rows(
                cell, conditions.protocol, f"its stored result cannot be used: {reason}"
            )
            run.save(results[cell])
    if (
        any(outcome.has_failed(results[cell]) for cell in request.cells if cell in results)
        and (run.path / LOG).exists()
    ):
        tell(f"tracebacks are in {run.path / LOG}; --retry-failed tries again")
    return results


def _beside(run: Store, request: Request, engine: Engine) -> dict[Cell, CellResult]:
    """Return the baseline's cells, which the run need not compute."""
    found, unusable = run.beside()
    outcome.tell_unusable(unusable, "left out of the baseline")
    tasks = baseline.tasks_now(run.request, engine.variables)
    if not all(baseline.is_comparable(result, tasks, run.request) for result in found):
        raise BadInput(
            f"the baseline in {run.path} is {baseline.OTHER_VERSION}; give it again, or another --out"
        )
    return {result.cell: result for result in found}


def cores() -> int:
    """As many processes as can work at a time."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def handle_signals() -> None:
    """Whatever stops a run stops it cleanly."""
    if threading.current_thread() is threading.main_thread():
        stop_cleanly()
