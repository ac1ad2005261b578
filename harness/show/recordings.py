"""Rerun recordings of single episodes: the scene as it moves, and every number of every step beside it.

Open one with `rerun FILE --bind 127.0.0.1`. This is the one file that imports the rerun SDK.

    scene/<shape>          line strips, steps 0..T; metres, y negated, since 2D views point y downwards
    observation/<i>        steps 0..T
    action/<i>             steps 0..T-1, the action taken there
    reward/true            steps 0..T-1, what that action earned
    reward/learned         steps 0..T-1, R*(s, a) minus what absorption pays; absent without an R*
    return/true            steps 0..T, the undiscounted true return so far
    ending                 step T, why the episode ended
    episode                what this is, as a table
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from envs import EnvSpec
from envs.spec import Array, Shape
from harness.judge.results import Cell
from harness.learn.simulator import Trajectory

_MARGIN = 0.08  # of the scene's larger side
_LINE_RADIUS = -1.5  # negative: in pixels, whatever the zoom

rr.set_strict_mode(True)  # or mismatched columns would only be a warning


def record(
    spec: EnvSpec,
    cell: Cell,
    policy: str,
    trajectory: Trajectory,
    frames: Sequence[dict[str, Shape]],
    learned_reward: Array | None,
) -> bytes:
    """One episode of T steps as an .rrd file; equal input gives equal content.

    frames: T+1 drawings, after the reset and after each step, with the same names throughout.
    learned_reward: (T,), R*(s, a) minus its absorbing value; None where there is no R*.
    Raises ValueError where lengths or names disagree, OSError where rerun writes nothing.
    """
    length, dt = len(trajectory.act), spec.time_step
    if len(frames) != length + 1 or any(frame.keys() != frames[0].keys() for frame in frames):
        raise ValueError(f"{length} steps need {length + 1} drawings with the same names")
    if learned_reward is not None and learned_reward.shape != (length,):
        raise ValueError(f"{length} steps need as many learned rewards, not {learned_reward.shape}")

    # No properties of rerun's own: they hold the time of day, and equal episodes would differ.
    stream = rr.RecordingStream(
        f"irl-bench-{spec.name}", recording_id=f"{cell.name}__{policy}", send_properties=False
    )
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    # rerun writes to no path that is not UTF-8, and where it was told not to, by RERUN=off, writes nothing.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "episode.rrd"
        stream.save(file, _blueprint(spec, trajectory, frames, learned_reward))
        _send_facts(stream, cell, policy, trajectory, dt)
        for name in frames[0]:
            _send_shape(stream, f"scene/{name}", [frame[name] for frame in frames], dt)
        for i, values in enumerate(trajectory.obs.T):
            _send_scalars(stream, f"observation/{i}", str(spec.obs_names[i]), values, dt)
        for i, values in enumerate(trajectory.act.T):
            _send_scalars(stream, f"action/{i}", str(spec.act_names[i]), values, dt)
        _send_scalars(stream, "reward/true", "true reward", trajectory.rewards, dt)
        if learned_reward is not None:
            _send_scalars(stream, "reward/learned", "R* - absorbing", learned_reward, dt)
        total = np.concatenate([[0.0], np.cumsum(trajectory.rewards)])
        _send_scalars(stream, "return/true", "return so far", total, dt)
        stream.flush()
        stream.disconnect()
        if not file.exists() or not (recording := file.read_bytes()):
            raise OSError("rerun wrote nothing")
        return recording


def _times(first: int, count: int, dt: float) -> list[rr.TimeColumn]:
    steps = np.arange(first, first + count)
    return [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("sim_time", duration=steps * dt)]


def _send_scalars(stream: rr.RecordingStream, entity: str, name: str, values: Array, dt: float) -> None:
    # Without this, plots show averages of neighbouring steps and hide single ones.
    stream.log(entity, rr.SeriesLines(names=name, aggregation_policy="off"), static=True)
    stream.send_columns(entity, _times(0, len(values), dt), rr.Scalars.columns(scalars=values))


def _send_shape(stream: rr.RecordingStream, entity: str, shapes: Sequence[Shape], dt: float) -> None:
    stream.log(entity, rr.LineStrips2D.from_fields(radii=_LINE_RADIUS), static=True)
    columns = rr.LineStrips2D.columns(
        strips=[(shape.points * [1.0, -1.0]).astype(np.float32) for shape in shapes],
        colors=np.array([shape.colour for shape in shapes], np.uint8),
    )
    stream.send_columns(entity, _times(0, len(shapes), dt), columns)


def _send_facts(
    stream: rr.RecordingStream, cell: Cell, policy: str, trajectory: Trajectory, dt: float
) -> None:
    length = len(trajectory.act)
    facts: dict[str, Any] = {
        "env": cell.env,
        "method": cell.method,
        "seed": cell.seed,
        "policy": policy,
        "return": round(float(trajectory.rewards.sum()), 6),
        "length": length,
        "ending": trajectory.ending,
    }
    stream.send_recording_name(f"{cell.method} {policy}, seed {cell.seed}")
    stream.send_property("episode", rr.AnyValues(**facts))
    lines = [f"| {name} | {value} |" for name, value in facts.items()]
    table = "\n".join(["| | |", "|---|---|", *lines])
    stream.log("episode", rr.TextDocument(table, media_type="text/markdown"), static=True)
    level = "WARN" if trajectory.terminated else "INFO"
    text = f"step {length}: {trajectory.ending}"
    stream.send_columns("ending", _times(length, 1, dt), rr.TextLog.columns(text=[text], level=[level]))


def _blueprint(
    spec: EnvSpec, trajectory: Trajectory, frames: Sequence[dict[str, Shape]], learned_reward: Array | None
) -> rrb.Blueprint:
    """The scene, where there is one, over the facts on the left, the plots on the right."""
    facts = rrb.Horizontal(
        rrb.TextDocumentView(origin="episode", name="Episode"),
        rrb.TextLogView(origin="ending", name="How it ended"),
    )
    told = rrb.Vertical(_scene(spec, frames), facts, row_shares=[5, 3]) if frames[0] else facts
    plots = [_plot("reward/true", "True reward of a step", trajectory.rewards)]
    if learned_reward is not None:
        plots.append(_plot("reward/learned", "R* of a step, above absorption", learned_reward))
    plots.append(_plot("return/true", "True return so far", np.cumsum(trajectory.rewards)))
    plots.append(_plot("action", "Actions", np.array([-1.0, 1.0])))
    plots.append(_plot("observation", "Observations", trajectory.obs))
    return rrb.Blueprint(
        rrb.Horizontal(told, rrb.Vertical(*plots), column_shares=[3, 2]),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def _scene(spec: EnvSpec, frames: Sequence[dict[str, Shape]]) -> rrb.Spatial2DView:
    """All that is drawn, with a margin."""
    points = np.concatenate([shape.points for frame in frames for shape in frame.values()]) * [1.0, -1.0]
    margin = _MARGIN * float(np.ptp(points, axis=0).max())
    (left, top), (right, bottom) = points.min(axis=0) - margin, points.max(axis=0) + margin
    return rrb.Spatial2DView(
        origin="scene",
        name=spec.name,
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom)),
        background=[255, 255, 255],
    )


def _plot(origin: str, name: str, values: Array) -> rrb.TimeSeriesView:
    """A plot that shows all values and zero: zoomed in on its noise, a constant reward looks eventful."""
    low, high = min(0.0, float(values.min())), max(0.0, float(values.max()))
    margin = _MARGIN * (high - low) or 1.0
    axis = rrb.ScalarAxis(range=(low - margin, high + margin))
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis)
