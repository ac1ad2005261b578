"""Recordings of several policies on one episode, each method's beside the expert's.

`scene/NAME`: the scene. NAME is 'expert', 'METHOD_pi_star' or 'METHOD_pi_R'.
`earned/NAME`: the undiscounted true return so far, at steps 0 to T.
`ending/NAME`: the reason, at step T.
`episode`: returns, lengths and endings, as a table.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from envs import EnvSpec
from harness.recordings import common
from harness.recordings.episode import send_ending
from harness.recordings.scenes import Scene, scene
from harness.records import ALL_SHOWN, CONTROLS, NOMINAL, REFERENCE, CellResult
from harness.registry import KNOWN, BadInput
from harness.registry.tasks import seen_through
from harness.rl.seeds import evaluation_seeds
from harness.rl.simulator import Simulator, Trajectory
from harness.store.files import write_atomic
from harness.store.names import compared_in
from harness.store.store import Store

SEED = 0
"""The run's seed whose first evaluation episode is played."""
_COLOURS = {"expert": common.GREY, "pi_star": common.BLUE, "pi_R": common.ORANGE}
_TITLES = {"expert": "expert", "pi_star": "π*", "pi_R": "π_R"}


@dataclass(frozen=True)
class Ghost:
    """A policy's episode. method: '' for the expert. policy: 'expert', 'pi_star' or 'pi_R'."""

    method: str
    policy: str
    trajectory: Trajectory
    scene: Scene | None

    @property
    def name(self) -> str:
        return f"{self.method}_{self.policy}" if self.method else self.policy


def write_compared(run: Store, results: Iterable[CellResult]) -> list[Path]:
    """Write DIR/recordings/ENV__compare.rrd of each environment with a reference and a method.

    A file of the same policies stays where it is as it was written. Return the paths of all files.
    """
    learned: dict[str, list[CellResult]] = {}
    for result in sorted(results, key=lambda one: (one.cell.method != REFERENCE, one.cell.method)):
        cell = result.cell
        is_usual = (cell.seed, cell.dynamics, cell.shown) == (SEED, NOMINAL, ALL_SHOWN)
        if is_usual and result.learned and cell.env in KNOWN.entries["env"] and cell.method not in CONTROLS:
            learned.setdefault(cell.env, []).append(result)
    files = []
    for env, group in sorted(learned.items()):
        if group[0].cell.method != REFERENCE or len(group) < 2:
            continue
        file = run.path / "recordings" / compared_in(env)
        digests = "\n".join(result.learned for result in group)
        identity = hashlib.sha256(digests.encode()).hexdigest()[:16]
        if not (run.is_as_written(file) and identity_of(file) == identity):
            if len(ghosts := _ghosts(run, env, group)) < 2:
                continue
            write_atomic(file, record(_task(run, env), identity, ghosts))
        files.append(file)
    return files


def identity_of(file: Path) -> str:
    """Return the identity that `record` gave a file, '' for a file that is not a recording."""
    try:
        with warnings.catch_warnings(action="ignore"):  # the file holds no index
            return str(RrdReader(file).recordings()[0].recording_id)
    except (OSError, ValueError, RuntimeError, IndexError):
        return ""


def record(spec: EnvSpec, identity: str, ghosts: Sequence[Ghost]) -> bytes:
    """Return the episodes, side by side, as one .rrd file. Raises OSError where rerun writes nothing."""

    def send(stream: rr.RecordingStream) -> None:
        stream.send_recording_name(f"{spec.name}, compared")
        longest = max(ghosts, key=lambda ghost: len(ghost.trajectory.act))
        if longest.scene:
            longest.scene.send_fixed(stream)
        table = ["| | | return | steps | ending |", "|---|---|---|---|---|"]
        for ghost in ghosts:
            if ghost.scene:
                ghost.scene.send_moving(stream, ghost.name, _COLOURS[ghost.policy])
            _send_earned(stream, ghost)
            played = ghost.trajectory
            numbers = f"{played.rewards.sum():.6g} | {len(played.act)} | {played.ending}"
            table.append(f"| {ghost.method} | {_TITLES[ghost.policy]} | {numbers} |")
        common.send_table(stream, *table)

    return common.rrd_file(spec.name, identity, _layout(spec, ghosts), send)


def _ghosts(run: Store, env: str, results: Sequence[CellResult]) -> list[Ghost]:
    """Return an episode of each policy that can be read; `verify` reports the others."""
    spec, seed = _task(run, env), evaluation_seeds(SEED, 1)[0]
    policies = []
    for result in results:
        try:
            learned = run.read_learned(result)
        except BadInput:
            continue
        for name in _TITLES:
            if (policy := learned.get(name)) is not None:
                policies.append(("" if name == "expert" else result.cell.method, name, policy))
    ghosts = []
    for is_expert, group in groupby(policies, lambda one: one[1] == "expert"):
        some, place = [*group], spec.expert_sees if is_expert else spec
        episodes = Simulator(place, len(some)).run_each([policy for *_, policy in some], [seed])
        for (method, name, _), (trajectory,) in zip(some, episodes, strict=True):
            ghosts.append(Ghost(method, name, trajectory, scene(place, seed, trajectory.act)))
    return ghosts


def _task(run: Store, env: str) -> EnvSpec:
    return seen_through(env, run.request.conditions.encoder)


def _send_earned(stream: rr.RecordingStream, ghost: Ghost) -> None:
    entity, earned = f"earned/{ghost.name}", common.so_far(ghost.trajectory.rewards)
    name = f"{ghost.method} {_TITLES[ghost.policy]}".strip()
    lines = rr.SeriesLines(names=name, colors=_COLOURS[ghost.policy], aggregation_policy="off")
    stream.log(entity, lines, static=True)
    common.send_columns(stream, entity, np.arange(len(earned)), rr.Scalars.columns(scalars=earned))
    send_ending(stream, f"ending/{ghost.name}", ghost.trajectory, f"{ghost.method} {ghost.policy}, ".lstrip())


def _layout(spec: EnvSpec, ghosts: Sequence[Ghost]) -> rrb.Blueprint:
    """Return a scene for each method, with the expert's ghost, above their returns and endings."""
    experts = [ghost for ghost in ghosts if not ghost.method]
    scenes = []
    for method, group in groupby([ghost for ghost in ghosts if ghost.method], lambda ghost: ghost.method):
        own = [*group]
        visible = [ghost for ghost in [*experts, *own] if ghost.scene]
        if visible and (first := visible[0].scene):
            returns = [f"{_TITLES[ghost.policy]} {ghost.trajectory.rewards.sum():.4g}" for ghost in own]
            scenes.append(first.view(f"{method}: {', '.join(returns)}", [ghost.name for ghost in visible]))
    below = rrb.Horizontal(
        rrb.TimeSeriesView(origin="earned", name="True return so far: expert grey, π* blue, π_R orange"),
        rrb.TextDocumentView(origin="episode", name=f"{spec.name}: one episode, all policies"),
        rrb.TextLogView(origin="ending", name="How they ended"),
        column_shares=[3, 2, 2],
    )
    above = [rrb.Grid(*scenes, grid_columns=min(4, len(scenes)))] if scenes else []
    return common.layout(spec, rrb.Vertical(*above, below, row_shares=[*[5] * len(above), 2]))
