"""The commands `demos`, `export`, `view`, `compare`, `figure` and `table`: files besides a run's own.

Each returns the exit code (`harness.cli.arguments`)."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from harness.api.running import tell_unusable
from harness.cli.values import installed_version
from harness.process.signals import stop_cleanly
from harness.records import CellResult, Conditions
from harness.registry import KNOWN, SPECS, BadInput, Demonstrator, choose, keys, plugins
from harness.registry.gymnasium_tasks import check_kwargs, task_or_name
from harness.schedule.progress import say, tell
from harness.store import baseline
from harness.store.files import new_folder, write_atomic
from harness.store.opening import open_to_verify
from harness.store.request import Request


def demos(args: argparse.Namespace) -> int:
    """Write, read or describe demonstrations."""
    from harness.demonstrations import apart
    from harness.demonstrations.description import described, described_without_task
    from harness.demonstrations.reading import read, write
    from harness.demonstrations.recording import Reading

    if args.env is None:
        try:
            recording = apart.recording_in(args.path, Reading(args.last_observation, args.obs_keys))
        except (ValueError, MemoryError) as error:
            raise BadInput(f"{args.path}: no demonstrations: {error}", "demonstrations") from error
        for line in described_without_task(recording):
            say(line)
        return 0
    spec = SPECS[_one_env(args)]
    if args.what == "export":
        export_demonstrations(args.to, spec.name, args.seed, args.demos, args.demonstrator)
        say(f"{args.to}: {read(args.to, spec)}")
        return 0
    bounds = None if args.action_bounds is None else np.array(args.action_bounds, np.float64).T
    demonstrations = read(args.path, spec, bounds, Reading(args.last_observation, args.obs_keys))
    if args.what == "import":
        write(args.to, demonstrations.episodes, demonstrations.rewards)
        say(f"{args.to}: {demonstrations}")
        return 0
    for line in described(demonstrations, spec):
        say(line)
    return 0


def export_demonstrations(path: Path, env: str, seed: int, count: int, kind: Demonstrator) -> None:
    """Write what a run of that seed shows: an `.npz`, or a folder of Minari where the name ends in something
    else. Raises BadInput where that is there already, or Minari is missing."""
    from harness.cell.experts import played_for
    from harness.demonstrations import minari
    from harness.demonstrations.reading import check_new, write
    from harness.demonstrations.recording import extra
    from harness.demonstrations.units import first_choice
    from harness.rl.world import without_rewards

    check_new(path)
    if path.suffix != ".npz":
        extra("minari")
    spec = SPECS[env]
    if spec.encoder:
        raise BadInput(f"{env} observes features of an encoder, which no file holds", "demonstrations")
    if not (keys.experts_version(env) or spec.tabular or spec.expert_sees.controller):
        tell(f"{env} has no shipped experts: unless the cache has one, one is trained now, at full")
    played = played_for(env, seed, Conditions("full", "absorbing", "sbx")).play(count, kind)
    episodes, rewards = without_rewards(played), [one.rewards for one in played]
    if path.suffix == ".npz":
        write(path, episodes, rewards)
        return
    facts = {
        "author": "irl-bench",
        "algorithm_name": kind,
        "description": f"What a run of seed {seed} shows of {env}'s {kind} in irl-bench "
        f"{installed_version()}, with actions in [-1, 1] or choices.",
    }
    name = f"irl-bench/{re.sub(r'[^-_a-zA-Z0-9]', '_', env)}/{kind}-v0"
    minari.write(
        path, name, spec, episodes, rewards, first_choice(spec.make()) if spec.discrete else 0, **facts
    )


def _one_env(args: argparse.Namespace) -> str:
    """Return the environment that is named, and load a plug-in's. Raises BadInput for several."""
    plugins.add(args.plugin, [args.env])
    env = task_or_name(args.env)
    if choose("env", env, KNOWN.entries["env"]) != (env,):
        raise BadInput(f"one env is needed, not {args.env!r:.80}")
    check_kwargs([env])
    plugins.load([], [env])
    return env


def export(args: argparse.Namespace) -> int:
    """Write a policy and its reward into a folder."""
    from harness.api import exported

    plugins.add(args.plugin, [args.env, args.method])
    folder = exported.export(args.directory, args.env, args.method, args.seed, args.policy, args.to)
    say(f"{folder}: {', '.join(sorted(file.name for file in folder.iterdir()))}")
    return 0


def view(args: argparse.Namespace) -> int:
    """Show a run's recordings, or write a folder that plays them."""
    from harness.recordings import viewer as viewing

    stop_cleanly()  # or SIGTERM would leave temporary folders
    with TemporaryDirectory() as own:
        with open_to_verify(args.directory) as run:
            found = viewing.recordings(args.directory, run.request.envs, args.env, args.method, args.compare)
            copies = [run.copy(file, Path(own)) for file in found]
        if args.export:
            with new_folder(args.export) as folder:
                viewing.export(copies, folder)
            plays = f"to play them: python -m http.server -d {args.export} -b 127.0.0.1"
            say(f"{args.export}: {len(found)} recordings; {plays}")
            return 0
        return viewing.serve(copies, say) if args.web else viewing.show(copies)


def compare(directory: Path, others: Sequence[Path]) -> int:
    """Show what differs between a run and each of the others."""
    from harness.report import compare as comparison

    runs = [(str(path), *_read(path)) for path in (directory, *others)]
    first, *rest = [comparison.Run(name, request.conditions, results) for name, request, results in runs]
    for other in rest:
        say(f"# {first.name}, and there: {other.name}\n")
        for line in comparison.differing(first, other):
            say(f"- {line}")
        for env in comparison.other_versions(first, other):
            say(f"- {env}: not compared; {baseline.OTHER_VERSION}")
        if comparison.is_other_scale(first, other):
            say("- scores are not compared: 1 is what demonstrations return in one, and not in the other")
        table = comparison.differences(first, other).as_markdown()
        say("\n" + table if table else "\nthere is nothing that both have")
    return 0


def draw(args: argparse.Namespace) -> int:
    """Write a figure or a table of a run's scores into a file; `args.command` says which."""
    from harness.report import files
    from harness.report.model import build

    kinds = files.FIGURES if args.command == "figure" else files.TABLES
    kind = args.to.suffix.removeprefix(".")
    if kind not in kinds:
        raise BadInput(f"--to must end in {', '.join(f'.{one}' for one in kinds)}, not {args.to.name!r:.40}")
    if args.to.resolve().is_relative_to(args.directory.resolve()):
        raise BadInput(f"{args.to} lies in the run, whose files are its own; give another --to")
    report = build(*_read(args.directory))
    if args.command == "figure":
        write_atomic(args.to, files.figure(report, kind, args.env, args.cost))
    else:
        write_atomic(args.to, files.table(report, kind, args.env))
    say(str(args.to))
    return 0


def _read(path: Path) -> tuple[Request, list[CellResult]]:
    """Return the request and the cells of a run. Raises BadInput where it has no finished cell."""
    with open_to_verify(path) as run:
        results, unusable = run.load()
        beside, damaged = run.beside()
    tell_unusable(unusable | damaged, "left out")
    if not results and not beside:
        raise BadInput(f"{path} holds no finished cell")
    return run.request, [*results.values(), *beside]
