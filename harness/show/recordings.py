"""Rerun recordings of single episodes: what was seen, and every number of every step beside it.

Open them with `irl-bench view DIR`. One timeline, `step`, from 0 to T; scenes as of `harness.show.scenes`.

    signal                 components, each a line or more of a plot, named as the task names them:
      true, learned        steps 0..T-1, what an action earned, and R*(s, a) less what absorption pays
      true_return, learned_return   steps 0..T, the undiscounted sums so far
      action_N             steps 0..T-1: entry N of what the policy did, of what the expert would have done in
                           the same state, and of f(s) where R* has one; where actions have more than `FEW`
                           entries, all of them of the policy, of the expert and of f
      precision            steps 0..T-1, the eigenvalues of L Lᵀ + I where R* has those, of more than `FEW`
                           the smallest and the largest
      observation          steps 0..T
    advantage              at some steps, what was done since the one before over what the expert would have
                           made of it, under both rewards, each in units of its largest
    map/true, map/learned  both rewards over two axes of the state, with where the episode went
    ending                 step T, why the episode ended
    episode                what this is, as a table

Numbers are in 64 bits. Of episodes longer than `scenes.LONG` steps all but the true reward are in 32 bits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from harness.show.scenes import LONG, Scene

if TYPE_CHECKING:
    from harness.show.maps import Maps  # all of RL, which what only reads recordings does without

_MARGIN = 0.08  # of the plotted range
_NAMED = 6  # lines that a legend has room for; the names of more are shown at the pointer
SLOWEST = 4.0
"""Steps a second that a recording plays at least; else as many as it takes."""

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
        send_series(stream, "signal", [series for series, _ in _series(spec, episode).values()])
        if episode.advantage:
            names, values = _advantage(episode.advantage)
            look = rr.SeriesLines(names=names, colors=np.array([GREY, BLUE][: len(names)], np.uint8))
            stream.log("advantage", look, static=True)
            steps = [rr.TimeColumn("step", sequence=episode.advantage.steps)]
            stream.send_columns("advantage", steps, rr.Scalars.columns(scalars=values))

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
        stream.save(file, blueprint, write_footer=False)
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
    """Lines of one plot. values: (N, K), of K lines by name, from step 0 on."""

    part: str
    names: Sequence[str]
    values: Array
    colours: Sequence[tuple[int, int, int]] = ()
    half: bool = False
    """Whether 32 bits will do."""

    def plot(self, entity: str, name: str) -> rrb.TimeSeriesView:
        """Of one line it shows zero, too: zoomed in on its noise, a constant reward looks eventful."""
        alone = len(self.names) == 1
        low, high = min(0.0, float(self.values.min())), max(0.0, float(self.values.max()))
        margin = _MARGIN * (high - low) or 1.0
        source = ComponentSourceKind.SourceComponent
        mapping = VisualizerComponentMapping(
            "Scalars:scalars", source, source_component=f"signal:{self.part}"
        )
        colours = np.array(self.colours, np.uint8) if self.colours else None
        # Without this, plots show averages of neighbouring steps and hide single ones.
        look = rr.SeriesLines(names=list(self.names), colors=colours, aggregation_policy="off")
        return rrb.TimeSeriesView(
            origin=f"/{entity}",
            name=name,
            axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)) if alone else None,
            plot_legend=None if 1 < len(self.names) <= _NAMED else rrb.PlotLegend(visible=False),
            overrides={entity: look.visualizer(mappings=[mapping])},
        )


def send_series(stream: rr.RecordingStream, entity: str, series: Sequence[Series]) -> None:
    """All of an entity as one chunk, each a component of its own, so that what a step costs is paid once."""
    rows = max(len(one.values) for one in series)
    columns: list[Any] = []
    for one in series:
        count, lines = one.values.shape
        flat = pa.array(one.values.astype(np.float32 if one.half else np.float64).ravel())
        column = rr.DynamicArchetype.columns(archetype="signal", components={one.part: flat})
        columns += column.partition([lines] * count + [0] * (rows - count))
    stream.send_columns(entity, [rr.TimeColumn("step", sequence=np.arange(rows))], columns)


FEW = 3
"""Entries of an action up to which each has a plot of its own; else each who acts has one."""
BLUE, ORANGE, GREY, GREEN = (66, 133, 244), (234, 134, 51), (90, 90, 90), (52, 168, 83)
"""The policy and R*; f; the true reward; the expert."""
_ACTORS = {"policy": BLUE, "expert": GREEN, "f(s)": ORANGE}


def _series(spec: EnvSpec, episode: Episode) -> dict[str, tuple[Series, str]]:
    """What is plotted, and under which heading, by the part of `signal`."""
    trajectory, half = episode.trajectory, len(episode.trajectory.act) > LONG
    found = [
        (Series("true", ["true reward"], trajectory.rewards[:, None], [GREY]), "True reward of a step"),
        (Series("true_return", ["so far"], so_far(trajectory.rewards), [GREY], half), "True return so far"),
    ]
    if (learned := episode.learned) is not None:
        name = "R* of a step, above absorption"
        found.append((Series("learned", ["R*"], learned[:, None], [BLUE], half), name))
        found.append((Series("learned_return", ["so far"], so_far(learned), [BLUE], half), "R* so far"))
    acts = {"policy": trajectory.act, "expert": episode.expert, "f(s)": episode.f}
    there = {who: values for who, values in acts.items() if values is not None}
    names = [str(quantity) for quantity in spec.actions]
    if len(names) <= FEW:
        colours = [_ACTORS[who] for who in there]
        for i, name in enumerate(names):
            columns = np.stack([values[:, i] for values in there.values()], axis=1)
            found.append((Series(f"action_{i}", [*there], columns, colours, half), name))
    else:
        for i, (who, values) in enumerate(there.items()):
            found.append((Series(f"action_{i}", names, values, half=half), f"Actions: {who}"))
    if (precision := episode.precision) is not None:
        names = [f"eigenvalue {i + 1}" for i in range(precision.shape[1])]
        if len(names) > FEW:
            names, precision = ["smallest", "largest"], precision[:, [0, -1]]
        found.append((Series("precision", names, precision, half=half), "Eigenvalues of L Lᵀ + I"))
    names = [str(quantity) for quantity in spec.observations]
    found.append((Series("observation", names, trajectory.obs, half=half), "Observations"))
    return {series.part: (series, heading) for series, heading in found}


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


def _advantage(told: Advantage) -> tuple[list[str], Array]:
    both = {"true reward": told.true, "R*": told.learned}
    there = {name: values for name, values in both.items() if values is not None}
    scaled = [values / (np.abs(values).max() or 1.0) for values in there.values()]
    return [*there], np.stack(scaled, axis=1)


def _blueprint(spec: EnvSpec, episode: Episode) -> rrb.Blueprint:
    """What was seen over the facts on the left, the plots on the right."""
    facts = rrb.Horizontal(
        rrb.TextDocumentView(origin="episode", name="Episode"),
        rrb.TextLogView(origin="ending", name="How it ended"),
    )
    left: list[Any] = [episode.scene.view(spec.name)] if episode.scene else []
    left += [rrb.Horizontal(*episode.maps.views())] if episode.maps else []
    series = _series(spec, episode)
    plots = {part: one.plot("signal", heading) for part, (one, heading) in series.items()}
    if episode.advantage:
        plots["advantage"] = rrb.TimeSeriesView(origin="/advantage", name="Advantage over the expert, scaled")
    rows = [["true", "true_return"], ["learned", "learned_return"], ["precision", "advantage"]]
    right: list[Any] = [
        rrb.Horizontal(*there) for row in rows if (there := [plots[part] for part in row if part in plots])
    ]
    actions = [view for part, view in plots.items() if part.startswith("action_")]
    right.append(rrb.Grid(*actions, grid_columns=min(3, len(actions))))
    right.append(plots["observation"])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*left, facts, row_shares=[*[4] * len(left), 3]),
            rrb.Vertical(*right),
            column_shares=[5, 4],
        ),
        playing(spec),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )
