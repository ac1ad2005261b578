"""Scenes of episodes: MuJoCo's bodies in three dimensions, the drawings of other tasks as lines in two."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from envs import EnvSpec
from envs.hills.environment import Drive
from envs.point_maze import TARGET
from envs.spec import Array, Shape
from harness.recordings.common import GREEN, LONG, WHITE, Colour, send_columns
from harness.rl.simulator import drawings

_TARGETS = {"point_maze": (*TARGET, 0.0)}
"""Places of a task that are not in its model [m]."""
_BOUNDS = {"highway": (-35.0, -20.0, 75.0, 12.0)}
"""Bounds of `Flat` for tasks whose drawings move with an actor."""
_MARGIN = 0.08  # of the scene's larger side
_WIDTH = -2.0  # of a line: negative, because it is in pixels at any zoom
_POSE, _POSES = 28, 80_000  # bytes of a geometry's pose; of all poses of a long episode
_ABOVE = 0.2  # m, of edges above the ground, whose triangles they would be below in places
_FOLLOWED = 2.0  # m, path from which on a view follows what moves
_SHOWN_GROUPS = 3  # MuJoCo's viewer hides geometries of groups from this on
_GHOST = 0.35  # opacity of a ghost
_LONG = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
_KINDS: dict[str, Any] = {
    "capsule": rr.Capsules3D,
    "cylinder": rr.Cylinders3D,
    "box": rr.Boxes3D,
    "sphere": rr.Ellipsoids3D,
    "ellipsoid": rr.Ellipsoids3D,
}
"""rerun's shapes of MuJoCo's geometries. Meshes are not shown, and a floor is the viewer's grid."""


@dataclass(frozen=True)
class Flat:
    """An episode of T steps as drawings.

    `frames`: T+1, after the reset and after each step, all with the same names.
    `bounds`: left, bottom, right and top of a view [m]; None for everything.
    """

    frames: Sequence[Mapping[str, Shape]]
    bounds: tuple[float, float, float, float] | None = None

    @property
    def length(self) -> int:
        return len(self.frames) - 1

    @property
    def fixed(self) -> list[str]:
        """Names of shapes that never change."""
        first = self.frames[0].items()
        same = {n for n, s in first if all(np.array_equal(f[n].points, s.points) for f in self.frames)}
        return [name for name in self.frames[0] if name in same]

    @property
    def moving(self) -> list[str]:
        """Names of the other shapes."""
        fixed = self.fixed
        return [name for name in self.frames[0] if name not in fixed]

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """Send the shapes that never change, as scene/fixed."""
        if shapes := [self.frames[0][name] for name in self.fixed]:
            colours = np.array([shape.colour for shape in shapes], np.uint8)
            strips = _strips([shape.points for shape in shapes])
            stream.log("scene/fixed", rr.LineStrips2D(strips, radii=_WIDTH, colors=colours), static=True)

    def send_moving(self, stream: rr.RecordingStream, actor: str, ghost: Colour | None = None) -> None:
        """Send the other shapes, as scene/ACTOR. ghost: the colour of a ghost."""
        if moving := self.moving:
            colours = np.array([ghost or self.frames[0][name].colour for name in moving], np.uint8)
            lines = rr.LineStrips2D.from_fields(radii=_WIDTH, colors=colours)
            stream.log(f"scene/{actor}", lines, static=True)
            strips = _strips([frame[name].points for frame in self.frames for name in moving])
            columns = rr.LineStrips2D.columns(strips=strips).partition([len(moving)] * len(self.frames))
            send_columns(stream, f"scene/{actor}", np.arange(len(self.frames)), columns)

    def view(self, name: str, actors: Sequence[str] = ("policy",)) -> rrb.Spatial2DView:
        """Return a view of these actors and of what is fixed."""
        points = np.concatenate([shape.points for frame in self.frames for shape in frame.values()])
        margin = _MARGIN * float(np.ptp(points, axis=0).max())
        box = (*(points.min(axis=0) - margin), *(points.max(axis=0) + margin))
        left, bottom, right, top = self.bounds or box
        return rrb.Spatial2DView(
            origin="scene",
            contents=_contents(actors),
            name=name,
            visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(-top, -bottom)),
            background=WHITE,
        )


@dataclass(frozen=True)
class Solid:
    """An episode of T steps in MuJoCo.

    `places`: (T+1, G, 3), the centre of each geometry [m]. `turns`: (T+1, G, 4), its quaternion, w first.
    `target`: a place that the model does not show [m]. `edges`: lines (P, 3) that it does not show [m].
    """

    model: mujoco.MjModel
    places: Array
    turns: Array
    target: tuple[float, float, float] | None = None
    edges: Sequence[Array] = ()

    @property
    def length(self) -> int:
        return len(self.places) - 1

    @property
    def moving(self) -> dict[str, list[int]]:
        """Visible geometries of bodies that can move, by kind."""
        return self._geometries(movable=True)

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """Send what never moves, below scene/fixed."""
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self.target:
            mark = rr.Ellipsoids3D(radii=[0.02], centers=[self.target], colors=GREEN, fill_mode="solid")
            stream.log("scene/fixed/target", mark, static=True)
        if len(self.edges):
            lines = rr.LineStrips3D(self.edges, radii=_WIDTH, colors=WHITE)
            stream.log("scene/fixed/edges", lines, static=True)
        for field in range(self.model.nhfield):
            stream.log(f"scene/fixed/ground_{field}", _ground(self.model, field), static=True)
        for kind, geoms in self._geometries(movable=False).items():
            if kind != "plane":
                self._send(stream, f"scene/fixed/{kind}", kind, geoms)

    def send_moving(self, stream: rr.RecordingStream, actor: str, ghost: Colour | None = None) -> None:
        """Send what moves, below scene/ACTOR. ghost: the colour of a ghost."""
        size = (self.length + 1) * sum(map(len, self.moving.values())) * _POSE
        every = max(2, math.ceil(size / _POSES)) if self.length > LONG else 1
        steps = np.union1d(np.arange(0, self.length + 1, every), self.length)
        for kind, geoms in self.moving.items():
            self._send(stream, f"scene/{actor}/{kind}", kind, geoms, steps, ghost)

    def view(self, name: str, actors: Sequence[str] = ("policy",)) -> rrb.Spatial3DView:
        """Return a view of these actors. It follows the first one where the path is long."""
        movable, fixed = self.moving, self._geometries(movable=False)
        path = self.places[:, [geom for geoms in movable.values() for geom in geoms]].mean(axis=1)
        follows = bool(np.ptp(path, axis=0).max() > _FOLLOWED)
        visible = [g for part in (movable, fixed) for kind, gs in part.items() if kind != "plane" for g in gs]
        steps = slice(1 if follows else None)
        places, turns = self.places[steps, visible], self.turns[steps, visible]
        radii, halves, _ = self.model.geom_size[visible].T[..., None]
        is_long = np.isin(self.model.geom_type[visible, None], _LONG)
        bounds = self.model.geom_rbound[visible, None]
        reach = np.where(is_long, radii + halves * np.abs(_upwards(turns)), bounds)
        low, high = (places - reach).min(axis=(0, 1)), (places + reach).max(axis=(0, 1))
        size = float(np.linalg.norm(high - low))
        eye = np.array([0.0, -0.35, 1.0] if high[2] - low[2] < 0.2 * size else [0.25, -1.0, 0.25])
        middle = (low + high) / 2
        return rrb.Spatial3DView(
            origin="scene",
            contents=_contents(actors),
            name=name,
            eye_controls=rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital,
                position=middle + 0.95 * size * eye / np.linalg.norm(eye),
                look_target=middle,
                eye_up=(0.0, 0.0, 1.0),
                tracking_entity=f"/scene/{actors[0]}/{next(iter(movable))}" if follows else None,
            ),
            background=WHITE,
            line_grid="plane" in fixed,
        )

    def _geometries(self, movable: bool) -> dict[str, list[int]]:
        """Return the visible geometries whose bodies can move, or those whose bodies cannot, by kind."""
        result: dict[str, list[int]] = {}
        for i in range(self.model.ngeom):
            geom = self.model.geom(i)
            kind = mujoco.mjtGeom(int(geom.type[0])).name.removeprefix("mjGEOM_").lower()
            is_visible = geom.group[0] < _SHOWN_GROUPS and geom.rgba[3] > 0 and kind in {*_KINDS, "plane"}
            if is_visible and movable == (self.model.body_weldid[geom.bodyid[0]] != 0):
                result.setdefault(kind, []).append(i)
        return result

    def _send(
        self,
        stream: rr.RecordingStream,
        entity: str,
        kind: str,
        geoms: list[int],
        steps: NDArray[np.int64] | None = None,
        ghost: Colour | None = None,
    ) -> None:
        """Send geometries of a kind: their shapes once, and their poses at these steps, or once."""
        at = np.array([0]) if steps is None else steps
        turns, places = self.turns[at][:, geoms], self.places[at][:, geoms]
        sizes = self.model.geom_size[geoms]
        colours = np.round(255 * self.model.geom_rgba[geoms]).astype(np.uint8)
        if ghost:
            colours[:] = [*ghost, round(255 * _GHOST)]
        shape = {"half_sizes": np.repeat(sizes[:, :1], 3, axis=1) if kind == "sphere" else sizes}
        if kind in ("capsule", "cylinder"):
            shape = {"lengths": 2 * sizes[:, 1], "radii": sizes[:, 0]}
        field = "centers"
        if kind == "capsule":  # rerun's place of a capsule is its lower end
            field, places = "translations", places - _upwards(turns) * sizes[:, 1:2]
        shapes = _KINDS[kind].from_fields(**shape, colors=colours, fill_mode="solid")
        stream.log(entity, shapes, static=True)
        flat = {field: places.reshape(-1, 3), "quaternions": turns[..., [1, 2, 3, 0]].reshape(-1, 4)}
        poses = {name: values.astype(np.float32) for name, values in flat.items()}
        columns = _KINDS[kind].columns(**poses).partition([len(geoms)] * len(at))
        times = [] if steps is None else [rr.TimeColumn("step", sequence=steps)]
        stream.send_columns(entity, times, columns)


Scene = Solid | Flat


def scene(spec: EnvSpec, seed: int, act: Array) -> Scene | None:
    """Return the scene of the episode with these actions (T, A). None where nothing can be drawn."""
    spec = spec.expert_sees  # where a task of images has its scene
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
    edges = [*(inner.edges() + np.array([0, 0, _ABOVE]))] if isinstance(inner, Drive) else []
    solid = Solid(inner.model, places, turns, _TARGETS.get(name), edges)
    return solid if solid.moving else None


def _contents(actors: Sequence[str]) -> list[str]:
    return ["/scene/fixed/**", *(f"/scene/{actor}/**" for actor in actors)]


def _ground(model: mujoco.MjModel, number: int) -> rr.Mesh3D:
    """Return a height field, centred on 0, as a mesh of two triangles for each cell."""
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    along, across, up, _ = model.hfield_size[number]
    y, x = np.meshgrid(np.linspace(-across, across, rows), np.linspace(-along, along, columns), indexing="ij")
    first = int(model.hfield_adr[number])
    places = np.column_stack([x.ravel(), y.ravel(), up * model.hfield_data[first : first + rows * columns]])
    corner = (columns * np.arange(rows - 1)[:, None] + np.arange(columns - 1)).ravel()
    right, above = corner + 1, corner + columns
    cells = np.column_stack([corner, right, above, above, right, above + 1]).reshape(-1, 3)
    shade = np.round(70 + 130 * (places[:, 2] - places[:, 2].min()) / up).astype(np.uint8)
    colours = np.column_stack([shade // 2, shade, shade // 3])
    return rr.Mesh3D(vertex_positions=places, triangle_indices=cells, vertex_colors=colours)


def _strips(lines: Sequence[Array]) -> pa.Array:
    """Return lines (P, 2) for rerun, with y negated, because 2D views point y downwards. rerun itself would
    convert each line alone, which takes longer than to play an episode."""
    points = (np.concatenate(lines) * [1.0, -1.0]).astype(np.float32)
    ends = np.cumsum([0, *map(len, lines)], dtype=np.int32)
    kind = rr.components.LineStrip2DBatch([]).as_arrow_array().type
    return pa.ListArray.from_arrays(ends, rr.components.Position2DBatch(points).as_arrow_array(), type=kind)


def _upwards(turns: Array) -> Array:
    """Return the third axis, (..., 3), after turns by quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(turns, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
