"""What `demos`, `export`, `view` and `compare` do: what goes in and out besides scores, and runs side by
side. Each returns the exit code (`harness.cli`)."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from harness import outcome
from harness.registry import KNOWN, SPECS, BadInput, choose, keys, plugins
from harness.registry.gymnasium_tasks import task_or_name
from harness.run import baseline
from harness.run.files import new_folder
from harness.run.opening import open_to_verify
from harness.run.progress import say, tell
from harness.run.signals import stop_cleanly
from harness.show.compare import Run as Comparable
from methods.base import Array


def demos(args: argparse.Namespace) -> int:
    """Writes, reads or describes demonstrations."""
    from harness import demonstrations

    env = _one_env(args)
    if args.what == "export":
        if not keys.experts_version(env) and not SPECS[env].tabular:
            tell(f"{env} has no shipped experts: unless the cache has one, one is trained now, at full")
        demonstrations.export(args.to, env, args.seed, args.demos, args.demonstrator)
        say(f"{args.to}: {demonstrations.read(args.to, SPECS[env])}")
        return 0
    found = demonstrations.read(args.path, SPECS[env], bounds(args.action_bounds))
    if args.what == "import":
        demonstrations.write(args.to, found.episodes, found.rewards)
        say(f"{args.to}: {found}")
        return 0
    for line in demonstrations.described(found, SPECS[env]):
        say(line)
    return 0


def bounds(pairs: Sequence[tuple[float, float]] | None) -> tuple[Array, Array] | None:
    """Return the lowest and the highest action, of each component or of all, as `--action-bounds` gives
    them."""
    if pairs is None:
        return None
    low, high = np.array(pairs, np.float64).T
    return low, high


def _one_env(args: argparse.Namespace) -> str:
    """The environment that is named, loaded if it is a plug-in's. Raises BadInput for several."""
    plugins.add(args.plugin, [args.env])
    env = task_or_name(args.env)
    if choose("env", env, KNOWN.entries["env"]) != (env,):
        raise BadInput(f"one env is needed, not {args.env!r:.80}")
    plugins.load([], [env])
    return env


def export(args: argparse.Namespace) -> int:
    """Writes a policy and its reward into a folder."""
    from harness import exported

    plugins.add(args.plugin, [args.env, args.method])
    folder = exported.export(args.directory, args.env, args.method, args.seed, args.policy, args.to)
    say(f"{folder}: {', '.join(sorted(file.name for file in folder.iterdir()))}")
    return 0


def view(args: argparse.Namespace) -> int:
    """Shows a run's recordings, or writes a folder that plays them."""
    from harness.show import view as viewing

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
    """Shows what differs between a run and each of the others."""
    from harness.show import compare as comparison
    from harness.show.tables import markdown

    first, *rest = [_read(path) for path in (directory, *others)]
    for other in rest:
        say(f"# {first.name}, and there: {other.name}\n")
        for line in comparison.differing(first, other):
            say(f"- {line}")
        for env in comparison.other_versions(first, other):
            say(f"- {env}: not compared; {baseline.OTHER_VERSION}")
        if comparison.is_other_scale(first, other):
            say("- scores are not compared: 1 is what demonstrations return in one, and not in the other")
        found = comparison.as_lines(comparison.differences(first, other))
        say("\n" + markdown(comparison.HEADINGS, found) if found else "\nthere is nothing that both have")
    return 0


def _read(path: Path) -> Comparable:
    """A run to be compared. Raises BadInput where there is none with a finished cell."""
    with open_to_verify(path) as run:
        results, unusable = run.load()
        beside, damaged = run.beside()
    outcome.tell_unusable(unusable | damaged, "left out")
    if not results and not beside:
        raise BadInput(f"{path} holds no finished cell")
    return Comparable(str(path), run.request.conditions, [*results.values(), *beside])
