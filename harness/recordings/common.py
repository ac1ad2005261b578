"""Parts that all recordings share: colours, the layout of the viewer, and the file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from envs import EnvSpec
from envs.spec import Array

Colour = tuple[int, int, int]
BLUE, ORANGE, GREY, GREEN = (66, 133, 244), (234, 134, 51), (90, 90, 90), (52, 168, 83)
WHITE = (255, 255, 255)
LONG = 500
"""Steps above which an episode is written leaner: fewer poses, and numbers in 32 bits."""
SLOWEST = 4.0
"""Least speed of a recording, in steps a second."""

rr.set_strict_mode(True)  # mismatched columns raise an error instead of a warning


def layout(spec: EnvSpec, views: rrb.Container) -> rrb.Blueprint:
    """Return a layout of these views alone, which plays at the task's own speed."""
    fps = max(SLOWEST, 1 / spec.time_step)
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline="step", state="collapsed", fps=fps, play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def send_columns(stream: rr.RecordingStream, entity: str, steps: NDArray[np.int64], columns: Any) -> None:
    """Send values of an entity at these steps (S,)."""
    stream.send_columns(entity, [rr.TimeColumn("step", sequence=steps)], columns)


def send_table(stream: rr.RecordingStream, *lines: str) -> None:
    """Send lines of Markdown as the recording's table."""
    stream.log("episode", rr.TextDocument("\n".join(lines), media_type="text/markdown"), static=True)


def so_far(rewards: Array) -> Array:
    """Return the sum of rewards (T,) before each step and after the last, (T+1, 1)."""
    return np.concatenate([[0.0], np.cumsum(rewards)])[:, None]


def rrd_file(
    task: str, identity: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]
) -> bytes:
    """Return everything that `send` sends as an .rrd file. Raises OSError where rerun writes nothing."""
    # rerun's own properties hold the time of day, so equal episodes would differ.
    stream = rr.RecordingStream(f"irl-bench-{task}", recording_id=identity, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "episode.rrd"
        stream.save(file, blueprint, write_footer=False)
        send(stream)
        stream.flush()
        stream.disconnect()
        if not file.exists() or not (data := file.read_bytes()):
            raise OSError("rerun wrote nothing")
        return data
