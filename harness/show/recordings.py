"""Rerun recordings of single episodes: what was seen, and every number of every step beside it.

Open them with `irl-bench view DIR`. One timeline, `step`, from 0 to T; scenes as of `harness.show.scenes`.

    observation            steps 0..T; the names of all series are the task's
    action/N               steps 0..T-1: entry N of what the policy did, of what the expert would have done in
                           the same state, and of f(s) where R* has one
    reward/true            steps 0..T-1, what that action earned
    reward/learned         steps 0..T-1, R*(s, a) less what absorption pays; absent without an R*
    return/true, /learned  steps 0..T, undiscounted, so far
    precision              steps 0..T-1, the eigenvalues of L Lᵀ + I where R* has those
    advantage              at some steps, what was done since the one before over what the expert would have
                           made of it, under both rewards, each in units of its largest
    map/true, map/learned  both rewards over two axes of the state, with where the episode went
    ending                 step T, why the episode ended
    episode                what this is, as a table

Rewards and returns are in 64 bits. So are observations and actions of episodes up to `scenes.LONG` steps;
longer ones' are in 32 bits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from envs import EnvSpec
from envs.spec import Array
from harness.judge.results import Cell
from harness.learn.simulator import Trajectory
from harness.show.maps import Maps
from harness.show.scenes import LONG, Scene

_MARGIN = 0.08  # of the plotted range
SLOWEST = 4.0
"""Steps a second that a recording plays at least; else as many as it takes."""
_HALF = "signal:values"
"""The component of series in 32 bits, for which rerun's own, of 64, has no room."""

rr.set_strict_mode(True)  # or mismatched columns would only be a warning


@dataclass(frozen=True)
class Advantage:
    """At K steps, in ascending order: what was done since the one before, or since the start, is worth over
    what the expert would have made of it, by the true reward and by R* (None: there is none), (K,) each."""

    steps: NDArray[np.int64]
    true: Array
    learned: Array | None


@dataclass(frozen=True)
class Episode:
    """One episode of T steps, with what is known of it. None is what there is not."""

    trajectory: Trajectory
    scene: Scene | None = None
    learned: Array | None = None
    """(T,): R*(s, a) less what absorption pays."""
    expert: Array | None = None
    """(T, A): what the expert does in the same states."""
    f: Array | None = None
    """(T, A): f(s) of a shaped reward."""
    precision: Array | None = None
    """(T, A): the eigenvalues of its L Lᵀ + I, ascending."""
    advantage: Advantage | None = None
    maps: Maps | None = None
    facts: Mapping[str, str | float] = field(default_factory=dict)
    """Of this episode among others, by name."""


def record(spec: EnvSpec, cell: Cell, policy: str, which: str, episode: Episode) -> bytes:
    """One episode as an .rrd file; equal input gives equal content. which: of the policy's, in one word.

    Raises ValueError where lengths disagree, OSError where rerun writes nothing.
    """
    length, told = len(episode.trajectory.act), episode
    for values in (told.learned, told.expert, told.f, told.precision):
        if values is not None and len(values) != length:
            raise ValueError(f"{length} steps need as many values, not {len(values)}")
    if told.scene and told.scene.length != length:
        raise ValueError(f"{length} steps need a scene as long, not of {told.scene.length}")
    name = f"{cell.method} {policy}, {which}"

    def send(stream: rr.RecordingStream) -> None:
        stream.send_recording_name(name)
        _send_facts(stream, cell, policy, which, episode)
        if episode.scene:
            episode.scene.send_fixed(stream)
            episode.scene.send_moving(stream, "policy")
        if episode.maps:
            episode.maps.send(stream)
        for series in _series(spec, episode):
            series.send(stream)

    return written(spec.name, f"{cell.name}__{policy}.{which}", _blueprint(spec, episode), send)


def written(
    task: str, identity: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]
) -> bytes:
    """The .rrd file of what is sent. Raises OSError where rerun writes nothing."""
    # No properties of rerun's own: they hold the time of day, and equal episodes would differ.
    stream = rr.RecordingStream(f"irl-bench-{task}", recording_id=identity, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    # rerun writes to no path that is not UTF-8, and where it was told not to, by RERUN=off, writes nothing.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "episode.rrd"
        stream.save(file, blueprint)
        send(stream)
        stream.flush()
        stream.disconnect()
        if not file.exists() or not (recording := file.read_bytes()):
            raise OSError("rerun wrote nothing")
        return recording


def playing(spec: EnvSpec) -> rrb.TimePanel:
    """The one timeline, at the task's own speed, from when it is opened."""
    fps = max(SLOWEST, 1 / spec.time_step)
    return rrb.TimePanel(timeline="step", state="collapsed", fps=fps, play_state="playing", loop_mode="all")


@dataclass(frozen=True)
class Series:
    """Lines of one plot, of which all begin at one step. values: (N, K), of K lines by name."""

    entity: str
    names: Sequence[str]
    values: Array
    colours: Sequence[tuple[int, int, int]] = ()
    half: bool = False
    """Whether 32 bits will do."""
    steps: NDArray[np.int64] | None = None
    """(N,); default: from 0."""

    def send(self, stream: rr.RecordingStream) -> None:
        count, lines = self.values.shape
        stream.log(self.entity, self._look(), static=True)
        if self.half:
            flat = pa.array(self.values.astype(np.float32).ravel())
            columns = rr.DynamicArchetype.columns(archetype="signal", components={"values": flat})
            columns = columns.partition(np.full(count, lines))
        else:
            columns = rr.Scalars.columns(scalars=self.values)
        steps = np.arange(count) if self.steps is None else self.steps
        stream.send_columns(self.entity, [rr.TimeColumn("step", sequence=steps)], columns)

    def _look(self) -> rr.SeriesLines:
        # Without this, plots show averages of neighbouring steps and hide single ones.
        colours = np.array(self.colours, np.uint8) if self.colours else None
        return rr.SeriesLines(names=list(self.names), colors=colours, aggregation_policy="off")

    @property
    def override(self) -> dict[str, Any]:
        """What a plot must be told to show it."""
        source = ComponentSourceKind.SourceComponent
        mapping = VisualizerComponentMapping("Scalars:scalars", source, source_component=_HALF)
        return {self.entity: rr.SeriesLines().visualizer(mappings=[mapping])} if self.half else {}


BLUE, ORANGE, GREY, GREEN = (66, 133, 244), (234, 134, 51), (90, 90, 90), (52, 168, 83)
"""The policy and R*; f; the true reward; the expert."""


def _series(spec: EnvSpec, episode: Episode) -> list[Series]:
    trajectory, half = episode.trajectory, len(episode.trajectory.act) > LONG
    found = [Series("reward/true", ["true reward"], trajectory.rewards[:, None], [GREY])]
    found.append(Series("return/true", ["true return so far"], so_far(trajectory.rewards), [GREY]))
    if (learned := episode.learned) is not None:
        found.append(Series("reward/learned", ["R* above absorption"], learned[:, None], [BLUE]))
        found.append(Series("return/learned", ["R* so far"], so_far(learned), [BLUE]))
    for i, quantity in enumerate(spec.act_names):
        beside = {
            "policy": (trajectory.act, BLUE),
            "expert": (episode.expert, GREEN),
            "f(s)": (episode.f, ORANGE),
        }
        there = {who: (values, colour) for who, (values, colour) in beside.items() if values is not None}
        columns = np.stack([values[:, i] for values, _ in there.values()], axis=1)
        names = [f"{quantity}, {who}" for who in there]
        found.append(Series(f"action/{i}", names, columns, [colour for _, colour in there.values()], half))
    if episode.precision is not None:
        names = [f"eigenvalue {i + 1}" for i in range(episode.precision.shape[1])]
        found.append(Series("precision", names, episode.precision, half=half))
    if (advantage := episode.advantage) is not None:
        both = {"true reward": (advantage.true, GREY), "R*": (advantage.learned, BLUE)}
        there = {who: (values, colour) for who, (values, colour) in both.items() if values is not None}
        columns = np.stack([values / (np.abs(values).max() or 1.0) for values, _ in there.values()], axis=1)
        found.append(
            Series(
                "advantage",
                [*there],
                columns,
                [colour for _, colour in there.values()],
                steps=advantage.steps,
            )
        )
    found.append(Series("observation", [*map(str, spec.obs_names)], trajectory.obs, half=half))
    return found


def so_far(rewards: Array) -> Array:
    """(T+1, 1): their sum before each step and after the last."""
    return np.concatenate([[0.0], np.cumsum(rewards)])[:, None]


def _send_facts(stream: rr.RecordingStream, cell: Cell, policy: str, which: str, episode: Episode) -> None:
    trajectory = episode.trajectory
    length = len(trajectory.act)
    facts: dict[str, Any] = {
        "env": cell.task,
        "method": cell.method,
        "seed": cell.seed,
        "policy": policy,
        "episode": which,
        "return": round(float(trajectory.rewards.sum()), 6),
        "length": length,
        "ending": trajectory.ending,
        **episode.facts,
    }
    stream.send_property("episode", rr.AnyValues(**facts))
    lines = [f"| {name} | {value} |" for name, value in facts.items()]
    table = "\n".join(["| | |", "|---|---|", *lines])
    stream.log("episode", rr.TextDocument(table, media_type="text/markdown"), static=True)
    send_ending(stream, "ending", trajectory)


def send_ending(stream: rr.RecordingStream, entity: str, trajectory: Trajectory, who: str = "") -> None:
    """Why the episode ended, at the step when it did."""
    length = len(trajectory.act)
    columns = rr.TextLog.columns(
        text=[f"{who}step {length}: {trajectory.ending}"],
        level=["WARN" if trajectory.terminated else "INFO"],
    )
    stream.send_columns(entity, [rr.TimeColumn("step", sequence=[length])], columns)


def _blueprint(spec: EnvSpec, episode: Episode) -> rrb.Blueprint:
    """What was seen over the facts on the left, the plots on the right."""
    facts = rrb.Horizontal(
        rrb.TextDocumentView(origin="episode", name="Episode"),
        rrb.TextLogView(origin="ending", name="How it ended"),
    )
    parts: list[Any] = [episode.scene.view(spec.name)] if episode.scene else []
    if episode.maps:
        parts.append(rrb.Horizontal(*episode.maps.views()))
    left = rrb.Vertical(*parts, facts, row_shares=[*[4] * len(parts), 3])
    series = {one.entity: one for one in _series(spec, episode)}
    plots = [
        [("reward/true", "True reward of a step"), ("return/true", "True return so far")],
        [("reward/learned", "R* of a step, above absorption"), ("return/learned", "R* so far")],
        [("precision", "Eigenvalues of L Lᵀ + I"), ("advantage", "Advantage since the step before")],
    ]
    rows: list[Any] = []
    for row in plots:
        there = [plot([series[entity]], name) for entity, name in row if entity in series]
        rows += [rrb.Horizontal(*there)] if there else []
    actions = [one for entity, one in series.items() if entity.startswith("action/")]
    rows.append(rrb.Grid(*(plot([one], one.names[0].rpartition(", ")[0]) for one in actions)))
    rows.append(plot([series["observation"]], "Observations"))
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*rows), column_shares=[5, 4]),
        playing(spec),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def plot(series: Sequence[Series], name: str) -> rrb.TimeSeriesView:
    """A plot that shows all values and zero: zoomed in on its noise, a constant reward looks eventful."""
    low = min(0.0, *(float(one.values.min()) for one in series))
    high = max(0.0, *(float(one.values.max()) for one in series))
    margin = _MARGIN * (high - low) or 1.0
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{one.entity}" for one in series],
        name=name,
        axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)),
        overrides={entity: look for one in series for entity, look in one.override.items()},
    )
