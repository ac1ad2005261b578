"""What an episode looks like: MuJoCo's bodies in three dimensions, other tasks' drawings as lines in two.

scene/fixed            what never moves, once
scene/WHO/BODY         a body's shapes, once, and where it is, at each moment shown (`Solid`)
scene/WHO              the lines that move (`Flat`); metres, y negated, since 2D views point y downwards
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from gymnasium.envs.mujoco import MujocoEnv

from envs import EnvSpec
from envs.spec import Array, Shape
from harness.learn.simulator import drawings

FIXED = "scene/fixed"
LONG = 500
"""Steps above which an episode is written leaner: every second pose, observations and actions in 32 bits."""
Colour = tuple[int, int, int]
_MARGIN = 0.08  # of the scene's larger side
_LINE_RADIUS = -1.5  # negative: in pixels, whatever the zoom
_ALONG, _ACROSS, _THICK = 5.0, 1.5, 0.02  # m, of a floor: beyond the path, to each side, and its half height
_STRIPE = 1.0  # m, between the floor's stripes
_FOLLOWED = 2.0  # m: a scene that moves farther is followed
_SHOWN_GROUPS = 3  # MuJoCo's viewer hides geometries of groups from this on
_GHOST = 0.35  # how opaque one of several in a scene is
_WHITE = [255, 255, 255]


@dataclass(frozen=True)
class Solid:
    """An episode of T steps in MuJoCo. poses: (T+1, B, 7), of each body its place [m] and its quaternion, w
    first, as the simulator has them."""

    model: mujoco.MjModel
    poses: Array

    @property
    def length(self) -> int:
        return len(self.poses) - 1

    @property
    def shown(self) -> Array:
        """The steps whose poses are written: each, or every second and the last of a long episode."""
        every = 2 if self.length > LONG else 1
        return np.union1d(np.arange(0, self.length + 1, every), self.length)

    @property
    def moving(self) -> list[int]:
        """Bodies, but for the world's."""
        return list(range(1, self.model.nbody))

    def body(self, index: int) -> str:
        """Its name."""
        return self.model.body(index).name or f"body_{index}"

    @property
    def follows(self) -> str | None:
        """The body that a view follows, where the scene is wide."""
        path = self.poses[:, 1, :2] if self.moving else np.zeros((1, 2))
        return self.body(1) if np.ptp(path, axis=0).max() > _FOLLOWED else None

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """What belongs to the world, floors as far as the episode leads."""
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for geom in self._geoms(0):
            if geom.type[0] == mujoco.mjtGeom.mjGEOM_PLANE:
                self._send_floor(stream, float(geom.pos[2]))
            else:
                stream.log(f"{FIXED}/{geom.name or geom.id}", *_solid(self.model, geom, None), static=True)

    def send_moving(self, stream: rr.RecordingStream, who: str, colour: Colour | None = None) -> None:
        """Bodies below scene/WHO. colour: of a ghost among others."""
        times = [rr.TimeColumn("step", sequence=self.shown)]
        for index in self.moving:
            entity = f"scene/{who}/{self.body(index)}"
            for geom in self._geoms(index):
                stream.log(f"{entity}/{geom.name or geom.id}", *_solid(self.model, geom, colour), static=True)
            poses = self.poses[self.shown, index].astype(np.float32)
            placed = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, [4, 5, 6, 3]])
            stream.send_columns(entity, times, placed)

    def view(self, name: str, who: Sequence[str] = ("policy",)) -> rrb.Spatial3DView:
        """Of what is fixed and these. It follows the first where the scene is wide."""
        low, high = self._box
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
        flat = high[2] - low[2] < 0.2 * size  # is seen from above
        away = np.array([0.0, -0.35, 1.0]) if flat else np.array([0.25, -1.0, 0.25])
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=middle + 0.95 * size * away / np.linalg.norm(away),
            look_target=middle,
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity=f"/scene/{who[0]}/{self.follows}" if self.follows else None,
        )
        return rrb.Spatial3DView(
            origin="scene",
            contents=[f"/{FIXED}/**", *(f"/scene/{one}/**" for one in who)],
            name=name,
            eye_controls=eye,
            background=_WHITE,
            line_grid=False,
        )

    def _geoms(self, body: int) -> list[Any]:
        geoms = [self.model.geom(i) for i in range(self.model.ngeom) if self.model.geom_bodyid[i] == body]
        return [geom for geom in geoms if geom.group[0] < _SHOWN_GROUPS and geom.rgba[3] > 0]

    @cached_property
    def _box(self) -> tuple[Array, Array]:
        """The corners [m] of what is in view at the start, or at any time where nothing is followed."""
        model, poses = self.model, self.poses[:1] if self.follows else self.poses
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in range(model.ngeom):
            if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE:
                continue
            body = poses[:, model.geom_bodyid[i]]
            places = np.array([pose[:3] + _turned(model.geom_pos[i], pose[3:]) for pose in body])
            reach = model.geom_size[i, 1] if model.geom_bodyid[i] == 0 else model.geom_rbound[i]
            low, high = np.minimum(low, places.min(0) - reach), np.maximum(high, places.max(0) + reach)
        return low, high

    def _send_floor(self, stream: rr.RecordingStream, height: float) -> None:
        places = self.poses[:, 1:, :2].reshape(-1, 2)
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
        stripes = [[[x, near, above], [x, far, above]] for x in np.arange(left, right + _STRIPE, _STRIPE)]
        lines = rr.LineStrips3D(np.array(stripes, np.float32), radii=0.01, colors=[170, 175, 182])
        stream.log(f"{FIXED}/stripes", lines, static=True)


@dataclass(frozen=True)
class Flat:
    """An episode of T steps as drawings. frames: T+1, after the reset and after each step, with the same
    names throughout. bounds: what a view shows, left, bottom, right and top [m]; default: all that is drawn."""

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


def scene(spec: EnvSpec, seed: int, act: Array) -> Scene | None:
    """The episode of these actions (T, A) as it looks; None where the task draws nothing."""
    env = spec.make()
    inner = env.unwrapped
    if not isinstance(inner, MujocoEnv):
        frames = drawings(spec, seed, act)
        return Flat(frames, VIEWS.get(spec.name.partition(".")[0])) if frames[0] else None
    env.reset(seed=seed)
    poses = np.empty((len(act) + 1, inner.model.nbody, 7))
    for step in range(len(act) + 1):
        if step:
            env.step(spec.native(act[step - 1]))
        poses[step] = np.hstack([inner.data.xpos, inner.data.xquat])
    return Solid(inner.model, poses)


VIEWS = {"highway": (-35.0, -20.0, 75.0, 12.0)}
"""Bounds of views, as of `Flat`, of tasks whose drawings move with what is followed."""


def _upright(points: Array) -> Any:
    return (points * [1.0, -1.0]).astype(np.float32)


def _turned(vector: Array, quaternion: Array) -> Array:
    """The vector (3,) turned by a quaternion, w first."""
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(vector, np.float64), np.asarray(quaternion, np.float64))
    return turned


def _solid(model: mujoco.MjModel, geom: Any, colour: Colour | None) -> list[Any]:
    """A geometry as rerun has it, in its body's frame."""
    place, turn = np.array(geom.pos), np.array(geom.quat)
    colours = np.round(255 * np.array(geom.rgba)).astype(np.uint8)
    if colour:
        colours = np.array([*colour, round(255 * _GHOST)], np.uint8)
    quaternion, size = turn[[1, 2, 3, 0]], np.array(geom.size)
    look: dict[str, Any] = {"quaternions": [quaternion], "colors": [colours], "fill_mode": "solid"}
    kind = mujoco.mjtGeom
    match geom.type[0]:
        case kind.mjGEOM_CAPSULE:  # rerun's begins at its lower end
            start = place - _turned(np.array([0.0, 0.0, size[1]]), turn)
            return [rr.Capsules3D(lengths=2 * size[1], radii=size[0], translations=[start], **look)]
        case kind.mjGEOM_CYLINDER:
            return [rr.Cylinders3D(lengths=2 * size[1], radii=size[0], centers=[place], **look)]
        case kind.mjGEOM_SPHERE:
            return [rr.Ellipsoids3D(radii=[size[0]], centers=[place], **look)]
        case kind.mjGEOM_ELLIPSOID:
            return [rr.Ellipsoids3D(half_sizes=[size], centers=[place], **look)]
        case kind.mjGEOM_BOX:
            return [rr.Boxes3D(half_sizes=[size], centers=[place], **look)]
        case kind.mjGEOM_MESH:
            mesh = model.mesh(int(geom.dataid[0]))
            vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
            faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
            moved = np.array([place + _turned(vertex, turn) for vertex in vertices], np.float32)
            return [rr.Mesh3D(vertex_positions=moved, triangle_indices=faces, albedo_factor=colours)]
    return []
