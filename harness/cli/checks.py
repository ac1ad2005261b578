"""The commands `list`, `verify`, `check`, `bench` and `experts`. Each returns the exit code."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from harness.process.signals import importing
from harness.registry import (
    ASKING,
    ENVS,
    GROUPS,
    KNOWN,
    METHOD_GROUPS,
    METHODS,
    OTHER_ENVS,
    SPECS,
    VARIANTS,
    BadInput,
    base,
    choose,
    plugins,
)
from harness.registry.gymnasium_tasks import check_kwargs, task_or_name
from harness.registry.loading import in_words
from harness.registry.names import plain


def list_names(named: Sequence[str]) -> int:
    """Print the methods and tasks that there are."""
    check_kwargs([])
    troubles = plugins.add(named)
    tables = {
        "methods": METHODS,
        "variants of methods, not part of 'all'": VARIANTS,
        "envs": ENVS,
        "envs, not part of 'all'": OTHER_ENVS,
    }
    sections = {
        title: {name: entry.summary for name, entry in table.items()} for title, table in tables.items()
    }
    for kind, groups in (("methods", METHOD_GROUPS), ("envs", GROUPS)):
        sections[f"groups of {kind}"] = {name: ", ".join(members) for name, members in groups.items()}
    for kind in KNOWN.entries:
        if table := KNOWN.of_plugins(kind):
            sections[f"{kind}s of plug-ins"] = {name: entry.summary for name, entry in table.items()}
    registered = {f"gym:{env_id}": f"registered by {module}" for env_id, module in KNOWN.registered.items()}
    sections |= {"tasks that plug-ins register with Gymnasium": registered} if registered else {}
    dynamics = {
        name: ", ".join(entry.variants) for name, entry in KNOWN.entries["env"].items() if entry.variants
    }
    sections["dynamics of envs, for --transfer"] = dynamics
    width = max(len(name) for section in sections.values() for name in section)
    for title, section in sections.items():
        print(f"{title}:")
        for name, summary in section.items():
            print(f"  {name:{width}} {summary}")
    for trouble in troubles:
        print(f"not usable: {plain(trouble)}")
    return 0


def list_settings(args: argparse.Namespace) -> int:
    """Print the settings of a method, and of the learner and the budget, in an environment."""
    if args.method is None or args.env is None:
        raise BadInput("settings are of a method in an environment: irl-bench list METHOD --env ENV")
    plugins.add(args.plugin, [args.method, args.env])
    env = task_or_name(args.env)
    check_kwargs([env])
    for kind, name in (("method", args.method), ("env", env)):
        if choose(kind, name, KNOWN.entries[kind]) != (name,):
            raise BadInput(f"one {kind} is needed, not {name!r:.80}")
    plugins.load([args.method], [env])
    with importing():
        from harness.cell.settings import settings_of
        from harness.records import Conditions

    conditions = Conditions(args.budget, "absorbing", "sbx")
    for part, settings in settings_of(args.method, env, conditions).items():
        print(f"{part}:")
        for name, value in settings.items():
            print(f"  {name:{max(map(len, settings))}} {json.dumps(value)}")
    return 0


def verify(directory: Path) -> int:
    """Print what is damaged in a run's directory, or in those of all runs below, and what no checksum
    covers."""
    from harness.store.database import FILE

    runs = [] if (directory / FILE).exists() else sorted(file.parent for file in directory.rglob(FILE))
    return max(map(_verify, runs or [directory]))


def _verify(directory: Path) -> int:
    from harness.schedule.progress import say
    from harness.store.opening import open_to_verify

    with open_to_verify(directory) as run:
        damaged, uncovered = run.damaged(), run.uncovered()
    for path, reason in sorted(damaged.items()):
        say(f"{path}: {reason}")
    uncovered = [path for path in uncovered if path not in damaged]
    for path in uncovered:
        say(f"{path}: covered by no checksum")
    if not damaged:
        which = "every file that has a checksum" if uncovered else "every file"
        say(f"{directory}: {which} is as it was written")
    return int(bool(damaged))


def check(names: Sequence[str], named: Sequence[str]) -> int:
    """Print whether methods and tasks keep the contract. `named`: plug-ins."""
    from harness.engines.cell_environment import as_in_cells

    plugins.add(named, names)
    names = [task_or_name(name) for name in names]
    methods, envs = KNOWN.entries["method"], KNOWN.entries["env"]
    for name in names:
        if choose("method or env", name, (*methods, *envs)) != (name,):
            raise BadInput(f"give methods and envs one by one, with spaces between, not {name!r:.80}")
    check_kwargs([name for name in names if name in envs])
    with as_in_cells():
        plugins.load([name for name in names if name in methods], [name for name in names if name in envs])
        with importing():
            from harness.registry import contract
        return _checked(names, contract)


def _checked(names: Sequence[str], contract: Any) -> int:
    """Print the outcome of each check. contract: the module `harness.registry.contract`."""
    from harness.schedule.progress import say

    failed = False
    for name in names:
        if name in KNOWN.entries["method"]:
            try:
                method = plugins.method_for(name, "", "smoke")
            except Exception as error:
                say(f"FAILED  {name}: it can be made without arguments: {in_words(error)}")
                failed = True
                continue
            found = contract.methods.checks(method, base(name) in ASKING)
        else:
            found = contract.tasks.checks(SPECS[name])
        for check in found:
            outcome, why = check.outcome()
            failed |= outcome == "FAILED"
            say(f"{outcome:7} {name}: {check.title}{f': {why}' if why else ''}")
    return int(failed)


def bench(part: str | None, as_json: bool) -> int:
    """Print what things cost."""
    from harness.engines.cell_environment import as_in_cells
    from harness.schedule.progress import say, tell

    measures, missed = [], False
    with as_in_cells():
        with importing():
            from harness.benchmarks import growth, scale, speed, spread  # in that environment
            from harness.registry.machine import origin

            parts = {"speed": speed, "growth": growth, "scale": scale, "spread": spread}

        try:
            for measure in chain.from_iterable(
                parts[name].measures() for name in ([part] if part else ("speed", "growth", "scale"))
            ):
                measures.append(measure.to_json())
                missed |= measure.missed
                if as_json:
                    tell(str(measure))
                else:
                    say(str(measure))
        except (RuntimeError, subprocess.SubprocessError) as error:
            tell(f"FAILED: {error}")
            missed = True
        if as_json:
            say(json.dumps({"cores": os.cpu_count(), **origin(), "measures": measures}, indent=1))
    return int(missed)


def _train_for_runs(envs: Sequence[str], seeds: Sequence[int], budget: str) -> int:
    from harness.engines.cell_environment import as_in_cells

    with as_in_cells():
        with importing():
            from harness.benchmarks.expert_files import train_for_runs  # in that environment

        train_for_runs(envs, seeds, budget)
    return 0


def _refuse(args: argparse.Namespace, options: Sequence[str], why: str) -> None:
    """Raise BadInput where one of the options is given."""
    if given := [name for name in options if getattr(args, name) is not None]:
        raise BadInput(f"leave out --{given[0]}: {why}")


def experts(args: argparse.Namespace) -> int:
    """Train or measure experts."""
    plugins.add(args.plugin, args.envs)
    asked = [task_or_name(name.strip()) for name in ",".join(args.envs).split(",")]
    envs = KNOWN.chosen_envs(",".join(asked))
    check_kwargs(envs)
    if theirs := [env for env in envs if env in KNOWN.of_plugins("env")]:
        if args.what == "check" or len(theirs) < len(envs):
            raise BadInput(
                f"{theirs[0]} has no shipped experts: `experts train {theirs[0]}`, by itself, makes its own"
            )
        _refuse(args, ("dir", "workers"), f"{theirs[0]} is trained one seed after the other, into the cache")
        if len(plugins.modules([], theirs)) > 1:
            raise BadInput(f"{theirs[0]} and others are of several plug-ins; train those of one at a time")
        plugins.load([], theirs)
        return _train_for_runs(theirs, args.seeds or range(5), args.budget or "full")
    if args.what == "train":
        _refuse(args, ("budget", "seeds"), f"experts of {envs[0]} are trained as those that are shipped were")
    with importing():
        from harness.api.preparing import cores
        from harness.benchmarks import expert_files
        from harness.cli.runs import handle_signals
        from harness.engines.scratch import base

    base()
    handle_signals()
    if none := [env for env in envs if not SPECS[env].shipped and "all" not in asked]:
        raise BadInput(f"there are no experts of {none[0]} to train or check: its model is known")
    envs = tuple(env for env in envs if SPECS[env].shipped)
    if args.what == "check":
        return int(not expert_files.check(envs, args.dir or expert_files.folder()))
    expert_files.train_all(envs, args.dir or Path("results/experts"), args.workers or cores())
    return 0
