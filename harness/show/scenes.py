"""What an episode looks like: MuJoCo's bodies in three dimensions, other tasks' drawings as lines in two.

scene/fixed            what never moves, once
scene/WHO/BODY         a body's shapes, once, and where it is, at each moment shown (`Solid`)
scene/WHO              the lines that move (`Flat`); metres, y negated, since 2D views point y downwards
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from envs import EnvSpec
from envs.spec import Array, Shape
from harness.learn.simulator import drawings

FIXED = "scene/fixed"
LONG = 500
"""Steps above which an episode is written leaner: every second pose or fewer, numbers in 32 bits."""
Colour = tuple[int, int, int]
_MARGIN = 0.08  # of the scene's larger side
_LINE_RADIUS = -2.0  # negative: in pixels, whatever the zoom
_ALONG, _ACROSS, _THICK = 5.0, 1.5, 0.02  # m, of a floor: beyond the path, to each side, and its half height
_STRIPE, _STRIPES = 1.0, 150  # m, between the floor's stripes at least; how many at most
_POSE, _POSES = 28, 80_000  # bytes of a geometry's pose; of all poses of a long episode
_FOLLOWED = 2.0  # m: a scene that moves farther is followed
_SHOWN_GROUPS = 3  # MuJoCo's viewer hides geometries of groups from this on
_GHOST = 0.35  # how opaque one of several in a scene is
_WHITE = [255, 255, 255]


@dataclass(frozen=True)
class Solid:
    """An episode of T steps in MuJoCo. places: (T+1, G, 3), where the centre of each geometry is [m], and
    turns: (T+1, G, 4), its quaternion, w first. target: (3,), a place that the model does not show [m]."""

    model: mujoco.MjModel
    places: Array
    turns: Array
    target: tuple[float, float, float] | None = None

    @property
    def length(self) -> int:
        return len(self.places) - 1

    @property
    def shown(self) -> NDArray[np.int64]:
        """The steps whose poses are written: each, or of a long episode every so-many-th and the last."""
        size = (self.length + 1) * len(self._movable) * _POSE
        every = max(2, math.ceil(size / _POSES)) if self.length > LONG else 1
        return np.union1d(np.arange(0, self.length + 1, every), self.length)

    @cached_property
    def moving(self) -> dict[str, list[int]]:
        """Geometries that are seen and belong to a body that can move, by kind."""
        return self._by_kind(lambda geom: self.model.body_weldid[geom.bodyid[0]] != 0)

    @cached_property
    def fixed(self) -> dict[str, list[int]]:
        """Those that are seen and cannot."""
        return self._by_kind(lambda geom: self.model.body_weldid[geom.bodyid[0]] == 0)

    @property
    def follows(self) -> bool:
        """Whether the scene is wide, and a view follows what moves."""
        path = self.places[:, self._movable].mean(axis=1)
        return bool(np.ptp(path, axis=0).max() > _FOLLOWED)

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """What never moves, floors as far as the episode leads."""
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self.target:
            mark = rr.Ellipsoids3D(
                radii=[0.02], centers=[self.target], colors=[52, 168, 83], fill_mode="solid"
            )
            stream.log(f"{FIXED}/target", mark, static=True)
        for kind, geoms in self.fixed.items():
            if kind == "plane":
                self._send_floor(stream, float(self.places[0, geoms[0], 2]))
            else:
                for name, look, columns in self._shapes(kind, geoms, np.array([0]), None):
                    stream.log(f"{FIXED}/{name}", look, static=True)
                    placed = {key: values[0] for key, values in columns.items()}
                    stream.log(f"{FIXED}/{name}", _KINDS[kind].from_fields(**placed), static=True)

    def send_moving(self, stream: rr.RecordingStream, who: str, colour: Colour | None = None) -> None:
        """What moves, below scene/WHO: shapes once, and where they are. colour: of a ghost among others."""
        times = [rr.TimeColumn("step", sequence=self.shown)]
        for kind, geoms in self.moving.items():
            for name, look, columns in self._shapes(kind, geoms, self.shown, colour):
                stream.log(f"scene/{who}/{name}", look, static=True)
                count = next(iter(columns.values())).shape[1]
                flat = {key: values.reshape(-1, values.shape[2]) for key, values in columns.items()}
                column = _KINDS[kind].columns(**flat).partition([count] * len(self.shown))
                stream.send_columns(f"scene/{who}/{name}", times, column)

    def view(self, name: str, who: Sequence[str] = ("policy",)) -> rrb.Spatial3DView:
        """Of what is fixed and these. It follows the first where the scene is wide."""
        low, high = self._box
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
        flat = high[2] - low[2] < 0.2 * size  # is seen from above
        away = np.array([0.0, -0.35, 1.0]) if flat else np.array([0.25, -1.0, 0.25])
        followed = f"/scene/{who[0]}/{next(iter(self.moving))}" if self.follows else None
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=middle + 0.95 * size * away / np.linalg.norm(away),
            look_target=middle,
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity=followed,
        )
        return rrb.Spatial3DView(
            origin="scene",
            contents=[f"/{FIXED}/**", *(f"/scene/{one}/**" for one in who)],
            name=name,
            eye_controls=eye,
            background=_WHITE,
            line_grid=False,
        )

    def _by_kind(self, wanted: Callable[[Any], bool]) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for i in range(self.model.ngeom):
            geom = self.model.geom(i)
            kind = mujoco.mjtGeom(int(geom.type[0])).name.removeprefix("mjGEOM_").lower()
            if geom.group[0] < _SHOWN_GROUPS and geom.rgba[3] > 0 and wanted(geom) and kind in _DRAWN:
                found.setdefault(kind, []).append(i)
        return found

    @property
    def _movable(self) -> list[int]:
        return [geom for geoms in self.moving.values() for geom in geoms]

    @cached_property
    def _box(self) -> tuple[Array, Array]:
        """The corners [m] of what is in view at the start, or at any time where nothing is followed."""
        seen = slice(1 if self.follows else None)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for kind, geoms in [*self.moving.items(), *self.fixed.items()]:
            for i in geoms if kind != "plane" else ():
                places, reach = self.places[seen, i], np.full(3, self.model.geom_rbound[i])
                if kind in ("capsule", "cylinder"):
                    radius, half, _ = self.model.geom_size[i]
                    reach = radius + half * np.abs(_up(self.turns[seen, i]))
                low = np.minimum(low, (places - reach).min(axis=0))
                high = np.maximum(high, (places + reach).max(axis=0))
        return low, high

    def _shapes(
        self, kind: str, geoms: list[int], steps: NDArray[np.int64], colour: Colour | None
    ) -> list[tuple[str, Any, dict[str, Any]]]:
        """Entities' names, how their shapes look, and where they are at these steps: of geometries of one
        kind all as one entity, of meshes each."""
        model = self.model
        turns = self.turns[steps][:, geoms][:, :, [1, 2, 3, 0]].astype(np.float32)
        places, sizes = self.places[steps][:, geoms], model.geom_size[geoms]
        colours = np.round(255 * model.geom_rgba[geoms]).astype(np.uint8)
        if colour:
            colours[:] = [*colour, round(255 * _GHOST)]
        if kind == "mesh":
            parts = zip(geoms, colours, strict=True)
            return [
                (
                    f"mesh/{i}",
                    _mesh(model, int(geom), tint),
                    {"translations": places[:, [i]], "quaternions": turns[:, [i]]},
                )
                for i, (geom, tint) in enumerate(parts)
            ]
        where, shape = "centers", dict[str, Any](half_sizes=sizes)
        if kind == "sphere":
            shape = {"half_sizes": np.repeat(sizes[:, :1], 3, axis=1)}
        if kind in ("capsule", "cylinder"):
            shape = {"lengths": 2 * sizes[:, 1], "radii": sizes[:, 0]}
        if kind == "capsule":  # rerun's begins at its lower end
            where = "translations"
            places = places - _up(self.turns[steps][:, geoms]) * sizes[:, 1:2]
        look = _KINDS[kind].from_fields(**shape, colors=colours, fill_mode="solid")
        return [(kind, look, {where: places.astype(np.float32), "quaternions": turns})]

    def _send_floor(self, stream: rr.RecordingStream, height: float) -> None:
        places = self.places[:, self._movable, :2].reshape(-1, 2)
        (left, near), (right, far) = places.min(0), places.max(0)
        left, right = np.floor(left - _ALONG), np.ceil(right + _ALONG)
        near, far = near - _ACROSS, far + _ACROSS
        floor = rr.Boxes3D(
            centers=[(left + right) / 2, (near + far) / 2, height - _THICK],
            half_sizes=[(right - left) / 2, (far - near) / 2, _THICK],
            colors=[225, 228, 232],
            fill_mode="solid",
        )
        stream.log(f"{FIXED}/floor", floor, static=True)
        above = height + _THICK / 10
        apart = max(_STRIPE, np.ceil((right - left) / _STRIPES))
        stripes = [[[x, near, above], [x, far, above]] for x in np.arange(left, right + apart, apart)]
        lines = rr.LineStrips3D(np.array(stripes, np.float32), radii=0.01, colors=[170, 175, 182])
        stream.log(f"{FIXED}/stripes", lines, static=True)


@dataclass(frozen=True)
class Flat:
    """An episode of T steps as drawings. frames: T+1, after the reset and after each step, with the same
    names throughout. bounds: what a view shows, left, bottom, right and top [m]; by default all."""

    frames: Sequence[Mapping[str, Shape]]
    bounds: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if any(frame.keys() != self.frames[0].keys() for frame in self.frames):
            raise ValueError("an episode's drawings must have the same names throughout")

    @property
    def length(self) -> int:
        return len(self.frames) - 1

    @cached_property
    def fixed(self) -> list[str]:
        """Names of what never changes."""
        first = self.frames[0]
        return [
            name
            for name, shape in first.items()
            if all(np.array_equal(frame[name].points, shape.points) for frame in self.frames)
        ]

    @property
    def moving(self) -> list[str]:
        """The others."""
        return [name for name in self.frames[0] if name not in self.fixed]

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """What never moves."""
        if self.fixed:
            stream.log(FIXED, self._lines(self.frames[0], self.fixed), static=True)

    def send_moving(self, stream: rr.RecordingStream, who: str, colour: Colour | None = None) -> None:
        """The rest, as scene/WHO. colour: of a ghost among others."""
        if not self.moving:
            return
        colours = [colour or self.frames[0][name].colour for name in self.moving]
        look = rr.LineStrips2D.from_fields(radii=_LINE_RADIUS, colors=np.array(colours, np.uint8))
        stream.log(f"scene/{who}", look, static=True)
        strips = [_upright(frame[name].points) for frame in self.frames for name in self.moving]
        column = rr.LineStrips2D.columns(strips=strips).partition([len(self.moving)] * len(self.frames))
        times = [rr.TimeColumn("step", sequence=np.arange(len(self.frames)))]
        stream.send_columns(f"scene/{who}", times, column)

    def view(self, name: str, who: Sequence[str] = ("policy",)) -> rrb.Spatial2DView:
        """Of what is fixed and these, with a margin."""
        left, bottom, right, top = self.bounds or self._box
        return rrb.Spatial2DView(
            origin="scene",
            contents=[f"/{FIXED}/**", *(f"/scene/{one}/**" for one in who)],
            name=name,
            visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(-top, -bottom)),
            background=_WHITE,
        )

    @property
    def _box(self) -> tuple[float, float, float, float]:
        points = np.concatenate([shape.points for frame in self.frames for shape in frame.values()])
        margin = _MARGIN * float(np.ptp(points, axis=0).max())
        (left, bottom), (right, top) = points.min(axis=0) - margin, points.max(axis=0) + margin
        return left, bottom, right, top

    @staticmethod
    def _lines(frame: Mapping[str, Shape], names: Sequence[str]) -> rr.LineStrips2D:
        return rr.LineStrips2D(
            [_upright(frame[name].points) for name in names],
            radii=_LINE_RADIUS,
            colors=np.array([frame[name].colour for name in names], np.uint8),
        )


Scene = Solid | Flat
_KINDS: dict[str, Any] = {
    **{"capsule": rr.Capsules3D, "cylinder": rr.Cylinders3D, "box": rr.Boxes3D},
    **{"sphere": rr.Ellipsoids3D, "ellipsoid": rr.Ellipsoids3D, "mesh": rr.InstancePoses3D},
}
"""MuJoCo's kinds of geometries, and what rerun places them by."""
_DRAWN = {*_KINDS, "plane"}


def scene(spec: EnvSpec, seed: int, act: Array) -> Scene | None:
    """The episode of these actions (T, A) as it looks; None where the task draws nothing."""
    env = spec.make()
    inner = env.unwrapped
    if not isinstance(inner, MujocoEnv):
        frames = drawings(spec, seed, act)
        return Flat(frames, VIEWS.get(spec.name.partition(".")[0])) if frames[0] else None
    env.reset(seed=seed)
    model, data = inner.model, inner.data
    places, turns = np.empty((len(act) + 1, model.ngeom, 3)), np.empty((len(act) + 1, model.ngeom, 4))
    for step in range(len(act) + 1):
        if step:
            env.step(spec.native(act[step - 1]))
        places[step] = data.geom_xpos
        for i in range(model.ngeom):
            mujoco.mju_mat2Quat(turns[step, i], data.geom_xmat[i])
    return Solid(model, places, turns, TARGETS.get(spec.name.partition(".")[0]))


TARGETS = {"point_maze": (0.3, 0.5, 0.0)}
"""Places that matter and are in no model [m]."""
VIEWS = {"highway": (-35.0, -20.0, 75.0, 12.0)}
"""Bounds of views, as of `Flat`, of tasks whose drawings move with what is followed."""


def _upright(points: Array) -> Any:
    return (points * [1.0, -1.0]).astype(np.float32)


def _up(turns: Array) -> Array:
    """(..., 3): the third axis of what quaternions (..., 4), w first, turn."""
    w, x, y, z = np.moveaxis(turns, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def _mesh(model: mujoco.MjModel, geom: int, colour: Any) -> rr.Mesh3D:
    mesh = model.mesh(int(model.geom_dataid[geom]))
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=colour)
