"""Recordings of single episodes, on the timeline `step` from 0 to T.

`scene`: the scene.
`signal`: one component for each `Plot`.
`advantage`: under both rewards, each in units of its largest.
`camera`: images that are observed.
`map/true`, `map/learned`: both rewards over two axes of the state, with the episode's path.
`ending`: the reason, at step T.
`episode`: the facts, as a table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from envs import EnvSpec
from envs.spec import Array
from harness.recordings import common
from harness.recordings.maps import Maps
from harness.recordings.pictures import send_pictures
from harness.recordings.scenes import Scene
from harness.records import Cell
from harness.rl.simulator import Trajectory

FEW = 3
"""Most entries of an action that have a plot each. Of more entries each actor has one plot."""
_MARGIN = 0.08  # of the plotted range
_LEGEND = 6  # most lines in a legend; the viewer shows other names at the pointer
_COLOURS = {"policy": common.BLUE, "expert": common.GREEN, "f(s)": common.ORANGE}


@dataclass(frozen=True)
class Advantage:
    """Advantage of the actions since the step before over the expert's, at K ascending steps.

    true, learned: (K,), under the true reward and under R*.
    """

    steps: NDArray[np.int64]
    true: Array
    learned: Array | None


@dataclass(frozen=True)
class Episode:
    """An episode of T steps with everything that is recorded of it. None stands for what does not exist.

    `learned`: (T,), R*(s, a) less what absorption pays. `expert`: (T, A), its actions in the same states.
    `f`: (T, A), f(s) of a shaped reward. `precision`: (T, A), the ascending eigenvalues of its L Lᵀ + I.
    `pictures`: (T+1, H, W, C), images that are observed. `facts`: further lines of the table.
    """

    trajectory: Trajectory
    scene: Scene | None = None
    learned: Array | None = None
    expert: Array | None = None
    f: Array | None = None
    precision: Array | None = None
    advantage: Advantage | None = None
    maps: Maps | None = None
    pictures: NDArray[np.uint8] | None = None
    facts: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Plot:
    """K lines of a plot from step 0 on, (N, K)."""

    component: str
    title: str
    names: Sequence[str]
    values: Array
    colours: Sequence[common.Colour] = ()

    def view(self) -> rrb.TimeSeriesView:
        """Return the view. A single line is shown with zero, because its noise would look eventful."""
        count = len(self.names)
        low, high = min(0.0, float(self.values.min())), max(0.0, float(self.values.max()))
        margin = _MARGIN * (high - low) or 1.0
        source, component = ComponentSourceKind.SourceComponent, f"signal:{self.component}"
        mapping = VisualizerComponentMapping("Scalars:scalars", source, source_component=component)
        colours = np.array(self.colours, np.uint8) if self.colours else None
        # By default, plots show averages of neighbouring steps and hide single ones.
        lines = rr.SeriesLines(names=list(self.names), colors=colours, aggregation_policy="off")
        return rrb.TimeSeriesView(
            origin="/signal",
            name=self.title,
            axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)) if count == 1 else None,
            plot_legend=None if 1 < count <= _LEGEND else rrb.PlotLegend(visible=False),
            overrides={"signal": lines.visualizer(mappings=[mapping])},
        )


def record(spec: EnvSpec, cell: Cell, policy: str, which: str, episode: Episode) -> bytes:
    """Return an episode as an .rrd file. Equal input gives equal content.

    which: a word for the episode among the policy's. Raises OSError where rerun writes nothing.
    """
    plots, played = _plots(spec, episode), episode.trajectory
    facts = {
        **{"env": cell.task, "method": cell.method, "seed": cell.seed, "policy": policy, "episode": which},
        **{"return": round(float(played.rewards.sum()), 6), "length": len(played.act)},
        **{"ending": played.ending, **episode.facts},
    }

    def send(stream: rr.RecordingStream) -> None:
        stream.send_recording_name(f"{cell.method} {policy}, {which}")
        common.send_table(stream, "| | |", "|---|---|", *(f"| {k} | {v} |" for k, v in facts.items()))
        send_ending(stream, "ending", played)
        if episode.scene:
            episode.scene.send_fixed(stream)
            episode.scene.send_moving(stream, "policy")
        if episode.maps:
            episode.maps.send(stream)
        if episode.pictures is not None:
            send_pictures(stream, episode.pictures)
        _send_plots(stream, plots)
        if episode.advantage:
            _send_advantage(stream, episode.advantage)

    return common.rrd_file(spec.name, f"{cell.name}__{policy}.{which}", _layout(spec, episode, plots), send)


def send_ending(stream: rr.RecordingStream, entity: str, trajectory: Trajectory, actor: str = "") -> None:
    """Send the reason why an episode ended, at its last step."""
    length = len(trajectory.act)
    text, level = f"{actor}step {length}: {trajectory.ending}", "WARN" if trajectory.terminated else "INFO"
    common.send_columns(stream, entity, np.array([length]), rr.TextLog.columns(text=[text], level=[level]))


def _plots(spec: EnvSpec, episode: Episode) -> list[Plot]:
    played, learned, precision = episode.trajectory, episode.learned, episode.precision
    rewards = [("true", "True reward", "True return so far", played.rewards, common.GREY)]
    if learned is not None:
        rewards.append(("learned", "R* above absorption", "R* so far", learned, common.BLUE))
    plots = []
    for name, title, total, paid, colour in rewards:
        plots.append(Plot(name, f"{title}, of a step", [title], paid[:, None], [colour]))
        plots.append(Plot(f"{name}_return", total, ["so far"], common.so_far(paid), [colour]))
    acts = {"policy": played.act, "expert": episode.expert, "f(s)": episode.f}
    known = {actor: values for actor, values in acts.items() if values is not None}
    names = [str(quantity) for quantity in spec.actions]
    if len(names) > FEW:
        for i, (actor, values) in enumerate(known.items()):
            plots.append(Plot(f"action_{i}", f"Actions: {actor}", names, values))
    else:
        colours, entries = [_COLOURS[actor] for actor in known], np.stack([*known.values()], axis=2)
        plots += [Plot(f"action_{i}", n, [*known], entries[:, i], colours) for i, n in enumerate(names)]
    if precision is not None:
        names = [f"eigenvalue {i + 1}" for i in range(precision.shape[1])]
        if len(names) > FEW:
            names, precision = ["smallest", "largest"], precision[:, [0, -1]]
        plots.append(Plot("precision", "Eigenvalues of L Lᵀ + I", names, precision))
    names = [str(quantity) for quantity in spec.observations]
    return [*plots, Plot("observation", "Observations", names, played.obs)]


def _send_plots(stream: rr.RecordingStream, plots: Sequence[Plot]) -> None:
    """Send all plots as one chunk, so that each step is stored once.

    Numbers are in 64 bits. Those of long episodes are in 32 bits, except the true rewards.
    """
    rows = max(len(plot.values) for plot in plots)
    columns: list[Any] = []
    for plot in plots:
        count, lines = plot.values.shape
        is_lean = rows > common.LONG + 1 and plot.component != "true"
        values = pa.array(plot.values.astype(np.float32 if is_lean else np.float64).ravel())
        column = rr.DynamicArchetype.columns(archetype="signal", components={plot.component: values})
        columns += column.partition([lines] * count + [0] * (rows - count))
    common.send_columns(stream, "signal", np.arange(rows), columns)


def _send_advantage(stream: rr.RecordingStream, advantage: Advantage) -> None:
    both = {"true reward": advantage.true, "R*": advantage.learned}
    known = {name: values for name, values in both.items() if values is not None}
    scaled = [values / (np.abs(values).max() or 1.0) for values in known.values()]
    colours = np.array([common.GREY, common.BLUE][: len(known)], np.uint8)
    stream.log("advantage", rr.SeriesLines(names=[*known], colors=colours), static=True)
    columns = rr.Scalars.columns(scalars=np.stack(scaled, axis=1))
    common.send_columns(stream, "advantage", advantage.steps, columns)


def _layout(spec: EnvSpec, episode: Episode, plots: Sequence[Plot]) -> rrb.Blueprint:
    """Return the scene above the facts on the left, and the plots on the right."""
    facts = rrb.Horizontal(
        rrb.TextDocumentView(origin="episode", name="Episode"),
        rrb.TextLogView(origin="ending", name="How it ended"),
    )
    left: list[Any] = [episode.scene.view(spec.name)] if episode.scene else []
    left += [rrb.Horizontal(*episode.maps.views())] if episode.maps else []
    left += [] if episode.pictures is None else [rrb.Spatial2DView(origin="camera", name="What is seen")]
    views = {plot.component: plot.view() for plot in plots}
    if episode.advantage:
        views["advantage"] = rrb.TimeSeriesView(origin="/advantage", name="Advantage over the expert, scaled")
    pairs = [["true", "true_return"], ["learned", "learned_return"], ["precision", "advantage"]]
    rows = [[views[name] for name in pair if name in views] for pair in pairs]
    actions = [view for name, view in views.items() if name.startswith("action_")]
    grid = rrb.Grid(*actions, grid_columns=min(3, len(actions)))
    right = rrb.Vertical(*(rrb.Horizontal(*row) for row in rows if row), grid, views["observation"])
    sides = rrb.Vertical(*left, facts, row_shares=[*[4] * len(left), 3])
    return common.layout(spec, rrb.Horizontal(sides, right, column_shares=[5, 4]))
