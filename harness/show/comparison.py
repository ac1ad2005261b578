"""Rerun recordings of several policies on one episode: ghosts of each method's beside the expert's, and what
they earn.

    scene/NAME             as of `harness.show.scenes`; NAME is 'expert', 'METHOD_pi_star' or 'METHOD_pi_R'
    earned/NAME            steps 0..T, the undiscounted true return so far
    ending/NAME            step T, why it ended
    episode                the table
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from envs import EnvSpec
from harness.learn.simulator import Trajectory
from harness.show.recordings import BLUE, GREY, ORANGE, playing, send_ending, so_far, written
from harness.show.scenes import Colour, Scene

_COLOURS: dict[str, Colour] = {"expert": GREY, "pi_star": BLUE, "pi_R": ORANGE}
_TITLES = {"expert": "expert", "pi_star": "π*", "pi_R": "π_R"}


@dataclass(frozen=True)
class Ghost:
    """A policy's episode. method: '' of the expert. policy: 'expert', 'pi_star' or 'pi_R'."""

    method: str
    policy: str
    trajectory: Trajectory
    scene: Scene | None

    @property
    def name(self) -> str:
        return f"{self.method}_{self.policy}" if self.method else self.policy


def identity_of(file: Path) -> str:
    """What `record` was told that the file is; '' where it is no recording."""
    try:
        with warnings.catch_warnings(action="ignore"):  # that it holds no index
            return str(RrdReader(file).recordings()[0].recording_id)
    except (OSError, ValueError, RuntimeError, IndexError):
        return ""


def record(spec: EnvSpec, identity: str, ghosts: Sequence[Ghost]) -> bytes:
    """The episodes as one .rrd file, playing side by side. Raises OSError where rerun writes nothing."""

    def send(stream: rr.RecordingStream) -> None:
        stream.send_recording_name(f"{spec.name}, compared")
        longest = max(ghosts, key=lambda ghost: len(ghost.trajectory.act))
        if longest.scene:
            longest.scene.send_fixed(stream)
        for ghost in ghosts:
            if ghost.scene:
                ghost.scene.send_moving(stream, ghost.name, _COLOURS[ghost.policy])
            _send_earned(stream, ghost)
        table = ["| | | return | steps | ending |", "|---|---|---|---|---|"]
        for ghost in ghosts:
            told = ghost.trajectory
            table.append(
                f"| {ghost.method} | {_TITLES[ghost.policy]} | {told.rewards.sum():.6g} | {len(told.act)} "
                f"| {told.ending} |"
            )
        text = rr.TextDocument("\n".join(table), media_type="text/markdown")
        stream.log("episode", text, static=True)

    return written(spec.name, identity, _blueprint(spec, ghosts), send)


def _send_earned(stream: rr.RecordingStream, ghost: Ghost) -> None:
    entity, rewards = f"earned/{ghost.name}", ghost.trajectory.rewards
    look = rr.SeriesLines(
        names=f"{ghost.method} {_TITLES[ghost.policy]}".strip(),
        colors=_COLOURS[ghost.policy],
        aggregation_policy="off",
    )
    stream.log(entity, look, static=True)
    times = [rr.TimeColumn("step", sequence=np.arange(len(rewards) + 1))]
    stream.send_columns(entity, times, rr.Scalars.columns(scalars=so_far(rewards)))
    send_ending(stream, f"ending/{ghost.name}", ghost.trajectory, f"{ghost.method} {ghost.policy}, ".lstrip())


def _blueprint(spec: EnvSpec, ghosts: Sequence[Ghost]) -> rrb.Blueprint:
    """A scene for each method, with the expert's ghost, over what they earn and how it ended."""
    methods: dict[str, list[Ghost]] = {}
    for ghost in ghosts:
        methods.setdefault(ghost.method, []).append(ghost)
    experts = methods.pop("", [])
    scenes: list[Any] = []
    for method, its in methods.items():
        there = [ghost for ghost in [*experts, *its] if ghost.scene]
        if there and (scene := there[0].scene):
            told = ", ".join(f"{_TITLES[ghost.policy]} {ghost.trajectory.rewards.sum():.4g}" for ghost in its)
            scenes.append(scene.view(f"{method}: {told}", [ghost.name for ghost in there]))
    below = rrb.Horizontal(
        rrb.TimeSeriesView(origin="earned", name="True return so far: expert grey, π* blue, π_R orange"),
        rrb.TextDocumentView(origin="episode", name=f"{spec.name}: one episode, all policies"),
        rrb.TextLogView(origin="ending", name="How they ended"),
        column_shares=[3, 2, 2],
    )
    shown = [rrb.Grid(*scenes, grid_columns=min(4, len(scenes)))] if scenes else []
    return rrb.Blueprint(
        rrb.Vertical(*shown, below, row_shares=[*[5] * len(shown), 2]),
        playing(spec),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )
