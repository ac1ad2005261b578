"""Episodes of MuJoCo's tasks as bodies in three dimensions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from envs.spec import Array
from harness.recordings.common import GREEN, LONG, WHITE, Colour

_ALONG, _ACROSS, _THICK = 5.0, 1.5, 0.02  # m, of a floor: beyond the path, to each side, and half its height
_STRIPE, _STRIPES = 1.0, 150  # m, least distance of a floor's stripes; their largest number
_POSE, _POSES = 28, 80_000  # bytes of a geometry's pose; of all poses of a long episode
_FOLLOWED = 2.0  # m, path from which on a view follows what moves
_SHOWN_GROUPS = 3  # MuJoCo's viewer hides geometries of groups from this on
_GHOST = 0.35  # opacity of a ghost
_KINDS: dict[str, Any] = {
    "capsule": rr.Capsules3D,
    "cylinder": rr.Cylinders3D,
    "box": rr.Boxes3D,
    "sphere": rr.Ellipsoids3D,
    "ellipsoid": rr.Ellipsoids3D,
}
"""rerun's shapes of MuJoCo's geometries. Meshes are not shown."""


@dataclass(frozen=True)
class Solid:
    """An episode of T steps in MuJoCo.

    `places`: (T+1, G, 3), the centre of each geometry [m]. `turns`: (T+1, G, 4), its quaternion, w first.
    `target`: a place that the model does not show [m].
    """

    model: mujoco.MjModel
    places: Array
    turns: Array
    target: tuple[float, float, float] | None = None

    @property
    def length(self) -> int:
        return len(self.places) - 1

    @property
    def moving(self) -> dict[str, list[int]]:
        """Visible geometries of bodies that can move, by kind."""
        return self._geometries(movable=True)

    def send_fixed(self, stream: rr.RecordingStream) -> None:
        """Send what never moves, with a floor as long as the episode's path."""
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self.target:
            mark = rr.Ellipsoids3D(radii=[0.02], centers=[self.target], colors=GREEN, fill_mode="solid")
            stream.log("scene/fixed/target", mark, static=True)
        for kind, geoms in self._geometries(movable=False).items():
            if kind == "plane":
                self._send_floor(stream, float(self.places[0, geoms[0], 2]))
            else:
                self._send(stream, f"scene/fixed/{kind}", kind, geoms)

    def send_moving(self, stream: rr.RecordingStream, actor: str, ghost: Colour | None = None) -> None:
        """Send what moves, below scene/ACTOR. ghost: the colour of a ghost."""
        size = (self.length + 1) * len(self._movable()) * _POSE
        every = max(2, math.ceil(size / _POSES)) if self.length > LONG else 1
        steps = np.union1d(np.arange(0, self.length + 1, every), self.length)
        for kind, geoms in self.moving.items():
            self._send(stream, f"scene/{actor}/{kind}", kind, geoms, steps, ghost)

    def view(self, name: str, actors: Sequence[str] = ("policy",)) -> rrb.Spatial3DView:
        """Return a view of these actors. It follows the first one where the path is long."""
        path = self.places[:, self._movable()].mean(axis=1)
        follows = bool(np.ptp(path, axis=0).max() > _FOLLOWED)
        low, high = self._box(1 if follows else len(self.places))
        size = float(np.linalg.norm(high - low))
        is_flat = high[2] - low[2] < 0.2 * size
        eye = np.array([0.0, -0.35, 1.0] if is_flat else [0.25, -1.0, 0.25])
        middle = (low + high) / 2
        return rrb.Spatial3DView(
            origin="scene",
            contents=["/scene/fixed/**", *(f"/scene/{actor}/**" for actor in actors)],
            name=name,
            eye_controls=rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital,
                position=middle + 0.95 * size * eye / np.linalg.norm(eye),
                look_target=middle,
                eye_up=(0.0, 0.0, 1.0),
                tracking_entity=f"/scene/{actors[0]}/{next(iter(self.moving))}" if follows else None,
            ),
            background=WHITE,
            line_grid=False,
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

    def _movable(self) -> list[int]:
        return [geom for geoms in self.moving.values() for geom in geoms]

    def _box(self, steps: int) -> tuple[Array, Array]:
        """Return the corners [m] of everything in view at the first steps."""
        lowest, highest = [], []
        for movable in (True, False):
            for kind, geoms in self._geometries(movable).items():
                places, reach = self.places[:steps, geoms], self.model.geom_rbound[geoms, None]
                if kind in ("capsule", "cylinder"):
                    radii, halves, _ = self.model.geom_size[geoms].T[..., None]
                    reach = radii + halves * np.abs(_upwards(self.turns[:steps, geoms]))
                if kind != "plane":
                    lowest.append((places - reach).min(axis=(0, 1)))
                    highest.append((places + reach).max(axis=(0, 1)))
        return np.min(lowest, axis=0), np.max(highest, axis=0)

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

    def _send_floor(self, stream: rr.RecordingStream, height: float) -> None:
        places = self.places[:, self._movable(), :2].reshape(-1, 2)
        (left, near), (right, far) = places.min(axis=0), places.max(axis=0)
        left, right = np.floor(left - _ALONG), np.ceil(right + _ALONG)
        near, far = near - _ACROSS, far + _ACROSS
        floor = rr.Boxes3D(
            centers=[(left + right) / 2, (near + far) / 2, height - _THICK],
            half_sizes=[(right - left) / 2, (far - near) / 2, _THICK],
            colors=[225, 228, 232],
            fill_mode="solid",
        )
        stream.log("scene/fixed/floor", floor, static=True)
        above = height + _THICK / 10
        distance = max(_STRIPE, np.ceil((right - left) / _STRIPES))
        stripes = [[[x, near, above], [x, far, above]] for x in np.arange(left, right + distance, distance)]
        lines = rr.LineStrips3D(np.array(stripes, np.float32), radii=0.01, colors=[170, 175, 182])
        stream.log("scene/fixed/stripes", lines, static=True)


def _upwards(turns: Array) -> Array:
    """Return the third axis, (..., 3), after turns by quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(turns, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
