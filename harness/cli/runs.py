"""The commands `run`, `reproduce` and `report`. Each returns the exit code (`harness.cli.arguments`)."""

from __future__ import annotations

import argparse
import math
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

from harness.api.preparing import Engine, Prepared, check_libraries, prepare
from harness.api.request import RunRequest
from harness.api.running import Reported, compute, plan, tell_unusable
from harness.api.running import report as write_report
from harness.cli import messages
from harness.process.signals import stop_cleanly
from harness.records import CellResult
from harness.registry import BadInput, Unfinished
from harness.schedule.progress import progress_for, say, tell
from harness.store.opening import merged, open_for_report, open_to_verify
from harness.store.store import LOG


def run(args: argparse.Namespace) -> int:
    """Compute what is asked for and missing, and report all that is there; or plan it."""
    if args.plan and args.json_progress:
        raise BadInput("a plan is text; leave out --json-progress", page="commands")
    handle_signals()
    prepared = prepare(request_of(args), engine_of(args), args.out, args.retry_failed, args.plan)
    if args.plan:
        for line in plan(prepared):
            say(line)
        return 0
    try:
        reported = _computed(prepared, args.json_progress)
    except Unfinished as error:
        tell(str(error))
        return 1
    results = [reported.results[cell] for cell in prepared.request.cells if cell in reported.results]
    failed = messages.tell_troubles(results, args.budget, reported.beside)
    return int(failed or not reported.is_sound)


def request_of(args: argparse.Namespace) -> RunRequest:
    """Return the request of a command line."""
    return RunRequest(
        methods=[args.methods],
        settings=args.set,
        envs=args.envs.split(","),
        seeds=args.seeds,
        budget=args.budget,
        protocol=args.protocol,
        rl=args.rl,
        learner=args.learner,
        solves=args.solves,
        encoder=args.encoder,
        experts=args.experts,
        demos=args.demos,
        subsample=args.subsample,
        demonstrator=args.demonstrator,
        demos_from=args.demos_from,
        action_bounds=args.action_bounds,
        last_observation=args.last_observation,
        obs_keys=args.obs_keys,
        preferences=args.preferences,
        transfer=args.transfer.split(",") if args.transfer is not None else (),
        retrain=not args.no_retrain,
        record=args.record,
        plugins=args.plugin,
        env_kwargs=args.env_kwargs,
        env_vars=args.env_var,
        baseline=args.baseline,
        fast=args.fast,
    )


def engine_of(args: argparse.Namespace) -> Engine:
    """Return the engine of a command line."""
    return Engine(args.engine, args.workers, args.cell_timeout, args.address, tuple(getattr(args, "log", ())))


def _computed(prepared: Prepared, for_programs: bool) -> Reported:
    """Compute the missing cells, show how far they are, and print the closing lines."""
    from harness.schedule.events import Events

    with messages.for_programs(for_programs) as programs:
        watch = progress_for if programs is None else partial(Events, stream=programs)
        reported = compute(prepared, watch)
        if reported.ended:
            tell(str(reported.ended))
        asked = [reported.results[cell] for cell in prepared.request.cells if cell in reported.results]
        if any(result.has_failed for result in asked) and (prepared.directory / LOG).exists():
            tell(f"tracebacks are in {prepared.directory / LOG}; --retry-failed tries again")
        messages.show(reported, programs=programs)
    return reported


def tune(args: argparse.Namespace) -> int:
    """Search the hyper-parameters of methods, and print the best of each."""
    from harness.api import tuning

    handle_signals()
    asked = RunRequest(
        methods=[args.methods],
        envs=args.envs.split(","),
        plugins=args.plugin,
        seeds=args.seeds,
        budget=args.budget,
        demos=args.demos,
        retrain=not args.no_retrain,
        fast=args.fast,
    )
    found = tuning.tune(asked, args.trials, args.storage, args.sampler, engine_of(args))
    say("")
    for line in tuning.best_of(found):
        say(line)
    return int(any(math.isnan(one.score) for trials in found.values() for one in trials))


def reproduce(args: argparse.Namespace) -> int:
    """Compute and report the study of the thesis, once under each protocol."""
    from harness.benchmarks import reproduce as study
    from harness.report.terminal import wrapped

    handle_signals()
    asked = RunRequest(
        methods=study.STUDIED,
        envs=study.ENVS,
        seeds=args.seeds,
        budget=args.budget,
        learner=study.LEARNER,
        solves=study.SOLVES,
        experts="trained",
        demos=study.TRAJECTORIES,
        record=args.record,
        fast=args.fast,
    )
    runs: dict[str, list[CellResult]] = {}
    with study.open_study(args.out):
        prepared = []
        for protocol in study.PROTOCOLS:
            directory = args.out / protocol
            one = prepare(replace(asked, protocol=protocol), engine_of(args), directory, args.retry_failed)
            merged(directory, one.request)  # refused now, and not hours later
            prepared.append(one)
        for one in prepared:
            reported = _computed(one, args.json_progress)
            if reported.ended:
                return 1
            results = reported.results
            runs[one.request.conditions.protocol] = [results[cell] for cell in one.request.cells]
        study.write_study(args.out, runs)
        for line in ["", *study.closing_lines(runs, args.out)]:
            say(wrapped(line))
    every = [result for results in runs.values() for result in results]
    return int(messages.tell_troubles(every, args.budget))


def report(directory: Path, tables: bool) -> int:
    """Rebuild tables and figures from the stored cells. `tables`: print the tables instead."""
    check_libraries()
    with (open_to_verify if tables else open_for_report)(directory) as run:
        results, unusable = run.load()
        tell_unusable(unusable, "left out")
        if not results and not run.beside()[0]:
            raise BadInput(f"{directory} holds no finished cell")
        reported = write_report(run, results, "nothing" if tables else "anew")
        messages.show(reported, tables)
        budget = run.request.conditions.budget
    failed = messages.tell_troubles([*results.values()], budget, reported.beside)
    return int(failed or not reported.is_sound or bool(unusable))


def handle_signals() -> None:
    """Make whatever stops a run stop it cleanly."""
    if threading.current_thread() is threading.main_thread():
        stop_cleanly()
