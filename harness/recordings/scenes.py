"""Scenes of episodes: MuJoCo's bodies in three dimensions, the drawings of other tasks as lines in two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from envs import EnvSpec
from envs.point_maze import TARGET
from envs.spec import Array, Shape
from harness.recordings.common import WHITE, Colour, send_columns
from harness.recordings.solid_scene import Solid
from harness.rl.simulator import drawings

_TARGETS = {"point_maze": (*TARGET, 0.0)}
"""Places of a task that are not in its model [m]."""
_BOUNDS = {"highway": (-35.0, -20.0, 75.0, 12.0)}
"""Bounds of `Flat` for tasks whose drawings move with an actor."""
_MARGIN = 0.08  # of the scene's larger side
_WIDTH = -2.0  # of a line: negative, because it is in pixels at any zoom


@dataclass(frozen=True)
class Flat:
    """An episode of T steps as drawings.

    `frames`: T+1, after the reset and after each step, all with the same names.
    `bounds`: left, bottom, right and top of a view [m]; None for everything.
    """

    frames: Sequence[Mapping[str, Shape]]
    bounds: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if any(frame.keys() != self.frames[0].keys() for frame in self.frames):
            raise ValueError("an episode's drawings must have the same names throughout")

    @property
    def length(self) -> int:
        return len(self.frames) - 1

    @property
    def fixed(self) -> list[str]:
        """Names of shapes that never change."""
        return [
            name
            for name, shape in self.frames[0].items()
            if all(np.array_equal(frame[name].points, shape.points) for frame in self.frames)
        ]

    @property
    def moving(self) -> list[str]:
        """Names of the other shapes."""
        fixed = self.fixed
        return [name for name in self.frames[0] if name not in fixed]

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """Send the shapes that never change, as scene/fixed."""
        if shapes := [self.frames[0][name] for name in self.fixed]:
            colours = np.array([shape.colour for shape in shapes], np.uint8)
            strips = [_mirrored(shape.points) for shape in shapes]
            stream.log("scene/fixed", rr.LineStrips2D(strips, radii=_WIDTH, colors=colours), static=True)

    def send_moving(self, stream: rr.RecordingStream, actor: str, ghost: Colour | None = None) -> None:
        """Send the other shapes, as scene/ACTOR. ghost: the colour of a ghost."""
        if moving := self.moving:
            colours = np.array([ghost or self.frames[0][name].colour for name in moving], np.uint8)
            lines = rr.LineStrips2D.from_fields(radii=_WIDTH, colors=colours)
            stream.log(f"scene/{actor}", lines, static=True)
            strips = [_mirrored(frame[name].points) for frame in self.frames for name in moving]
            columns = rr.LineStrips2D.columns(strips=strips).partition([len(moving)] * len(self.frames))
            send_columns(stream, f"scene/{actor}", np.arange(len(self.frames)), columns)

    def view(self, name: str, actors: Sequence[str] = ("policy",)) -> rrb.Spatial2DView:
        """Return a view of these actors and of what is fixed."""
        left, bottom, right, top = self.bounds or self._box()
        return rrb.Spatial2DView(
            origin="scene",
            contents=["/scene/fixed/**", *(f"/scene/{actor}/**" for actor in actors)],
            name=name,
            visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(-top, -bottom)),
            background=WHITE,
        )

    def _box(self) -> tuple[float, float, float, float]:
        points = np.concatenate([shape.points for frame in self.frames for shape in frame.values()])
        margin = _MARGIN * float(np.ptp(points, axis=0).max())
        (left, bottom), (right, top) = points.min(axis=0) - margin, points.max(axis=0) + margin
        return left, bottom, right, top


Scene = Solid | Flat


def scene(spec: EnvSpec, seed: int, act: Array) -> Scene | None:
    """Return the scene of the episode with these actions (T, A). None where nothing can be drawn."""
    env, name = spec.make(), spec.name.partition(".")[0]
    inner = env.unwrapped
    if not isinstance(inner, MujocoEnv):
        frames = drawings(spec, seed, act)
        return Flat(frames, _BOUNDS.get(name)) if frames[0] else None
    env.reset(seed=seed)
    count = inner.model.ngeom
    places, turns = np.empty((len(act) + 1, count, 3)), np.empty((len(act) + 1, count, 4))
    for step in range(len(act) + 1):
        if step:
            env.step(spec.native(act[step - 1]))
        places[step] = inner.data.geom_xpos
        for geom in range(count):
            mujoco.mju_mat2Quat(turns[step, geom], inner.data.geom_xmat[geom])
    solid = Solid(inner.model, places, turns, _TARGETS.get(name))
    return solid if solid.moving else None


def _mirrored(points: Array) -> NDArray[np.float32]:
    """Return points (P, 2) with y negated, because 2D views point y downwards."""
    return (points * [1.0, -1.0]).astype(np.float32)
