"""The car on its road as an environment and as a batch."""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from envs.hills.car import DROP, FRAMES, STEER, TURNS, WHEEL, WHEELS, Physics
from envs.hills.tracks import HALF_WIDTH, POINTS, RELIEF, Track, cross, draw_track, height, nearest
from envs.spec import Array, Flags

ASIDE, ASKEW, FASTEST = 2.5, 0.5, 8.0  # m, rad, m/s: largest displacement and speed at the start
MOST = 1.0  # m, of progress in a step that is paid
UPRIGHT = 0.3  # cosine of the tilt from which on the car counts as upside down
AHEAD, FAR = (5.0, 10.0, 15.0, 20.0, 30.0), (10.0, 20.0)  # m along the road, of what is observed there
OBS_SIZE, OFFSET = 8 + len(AHEAD) + len(FAR), 6  # and the entry of the offset
NOMINAL = Physics()


class Drive(MujocoEnv, EzPickle):
    """Observation (15,): `envs.hills.drive.OBS_NAMES`. Action (2,) in [-1, 1]: steering to the left, and
    throttle or, below 0, brake.

    Each step pays the progress along the road's centre line [m], up to `MOST`. It terminates where the car's
    centre is off the road, or the car upside down.
    """

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 10}  # noqa: RUF012
    track: Track
    place: int
    """Number of the road's point that is nearest to the car."""

    def __init__(self, physics: Physics = NOMINAL) -> None:
        self.physics = physics
        super().__init__(__file__, FRAMES, spaces.Box(-np.inf, np.inf, (OBS_SIZE,), np.float64))
        EzPickle.__init__(self, physics)

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        model = self.physics.compile()
        return model, mujoco.MjData(model)

    def _set_action_space(self) -> spaces.Box:
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        return self.action_space

    def reset_model(self) -> Array:
        rng = self.np_random
        self.put(
            draw_track(rng), rng.uniform(-ASIDE, ASIDE), rng.uniform(-ASKEW, ASKEW), rng.uniform(0, FASTEST)
        )
        return np.asarray(look([self])[0][0])

    def put(self, track: Track, aside: float, askew: float, speed: float) -> None:
        """Put the car on a track, `aside` [m] and `askew` [rad] to the left, at a forward speed [m/s]."""
        self.track, self.place = track, 0
        self.model.hfield_data[:] = track.terrain.ravel() / RELIEF
        along = track.tangents[0]
        yaw = math.atan2(along[1], along[0]) + askew
        ahead, left = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        centre = track.points[0] + aside * np.array([-along[1], along[0]])
        wheels = np.array([*WHEELS.values()])
        ground = height(track.terrain, *(centre + wheels @ [ahead, left]).T)
        # Mean slopes under the wheels, ahead and to the left.
        slopes = (ground * np.sign(wheels.T)).sum(axis=1) / np.abs(wheels).sum(axis=0)
        turn = np.array([1.0, 0, 0, 0])
        for axis, angle in (
            ((0.0, 0, 1), yaw),
            ((0.0, 1, 0), -math.atan(slopes[0])),
            ((1.0, 0, 0), math.atan(slopes[1])),
        ):
            one, before = np.zeros(4), turn.copy()
            mujoco.mju_axisAngle2Quat(one, np.array(axis), angle)
            mujoco.mju_mulQuat(turn, before, one)
        qpos, qvel = np.zeros(self.model.nq), np.zeros(self.model.nv)
        qpos[:2], qpos[3:7] = centre, turn
        qpos[2] = ground.mean() + (WHEEL + DROP) * math.hypot(1, *slopes)
        qvel[:3] = speed / math.hypot(1, slopes[0]) * np.array([*ahead, slopes[0]])
        for wheel in WHEELS:
            qvel[self.model.joint(f"{wheel}_spin").dofadr] = speed / WHEEL
        self.set_state(qpos, qvel)  # type: ignore[no-untyped-call]

    def edges(self) -> Array:
        """Return the road's left and right edge, (2, POINTS + 1, 3) [m]."""
        points, tangents, terrain = self.track.points, self.track.tangents, self.track.terrain
        aside = HALF_WIDTH * np.column_stack([-tangents[:, 1], tangents[:, 0]])
        closed = np.array([np.concatenate([edge, edge[:1]]) for edge in (points + aside, points - aside)])
        return np.concatenate([closed, height(terrain, *np.moveaxis(closed, -1, 0))[..., None]], axis=-1)

    def step(self, action: NDArray[np.float32]) -> Any:
        (obs,), (reward,), (ended,) = drive([self], action[None])
        return obs, float(reward), bool(ended), False, {}


def drive(envs: Sequence[Drive], act: NDArray[Any]) -> tuple[Array, Array, Flags]:
    """Step environments by actions (B, 2). Return observations (B, O), rewards (B,) and flags of termination
    (B,)."""
    before = look(envs)[1]
    steer, pedal = np.clip(act.astype(np.float32), -1, 1).astype(np.float64).T
    angle = STEER * envs[0].physics.steering * steer
    controls = np.repeat([angle, np.maximum(pedal, 0), np.maximum(-pedal, 0)], (2, 4, 4), axis=0)
    for env, control in zip(envs, controls.T, strict=True):
        env.data.ctrl[:] = control
        mujoco.mj_step(env.model, env.data, FRAMES)
    obs, after, upright = look(envs)
    half = POINTS / 2 * np.array([env.track.spacing for env in envs])
    progress = (after - before + half) % (2 * half) - half
    return obs, np.minimum(progress, MOST), (np.abs(obs[:, OFFSET]) > HALF_WIDTH) | (upright < UPRIGHT)


def look(envs: Sequence[Drive]) -> tuple[Array, Array, Array]:
    """Return observations (B, O), positions along the road (B,) [m] and cosines of tilts (B,), and note the
    nearest points of the roads."""
    state = np.array([env.data.qpos for env in envs])
    speeds = np.array([env.data.qvel[:6] for env in envs])
    points, tangents, rises = (
        np.array([getattr(env.track, name) for env in envs]) for name in ("points", "tangents", "rises")
    )
    spacing, at, rows = np.array([env.track.spacing for env in envs]), state[:, :2], np.arange(len(envs))
    place = nearest(points, np.array([env.place for env in envs]), at)
    for env, number in zip(envs, place.tolist(), strict=True):
        env.place = number
    ahead, left, up = rotated(state[:, 3:7])
    tangent, away = tangents[rows, place], at - points[rows, place]
    along = tangent[:, 0] * away[:, 0] + tangent[:, 1] * away[:, 1]

    def on_road(values: Array, distances: Sequence[float]) -> Array:
        """Return values (B, K, C) at distances ahead, of those of roads' points (B, POINTS, C)."""
        steps = place[:, None] + (along[:, None] + np.array(distances)) / spacing[:, None]
        whole = np.floor(steps)
        share, first = (steps - whole)[..., None], whole.astype(np.int64) % POINTS
        near, far = values[rows[:, None], first], values[rows[:, None], (first + 1) % POINTS]
        return np.asarray(near * (1 - share) + far * share)

    road, heights = on_road(points, AHEAD) - at[:, None], on_road(rises[..., None], (0.0, *FAR))[..., 0]
    level = ahead[:, None, :2] / np.maximum(np.hypot(ahead[:, 0], ahead[:, 1]), 1e-6)[:, None, None]
    cosine = tangent[:, 0] * ahead[:, 0] + tangent[:, 1] * ahead[:, 1]
    columns = [
        (ahead * speeds[:, :3]).sum(axis=1),
        (left * speeds[:, :3]).sum(axis=1),
        speeds[:, 5],
        ahead[:, 2],
        left[:, 2],
        state[:, TURNS].mean(axis=1),
        cross(tangent, away),
        np.arctan2(cross(tangent, ahead), cosine),
        cross(level, road),
        heights[:, 1:] - heights[:, :1],
    ]
    return np.column_stack(columns), place * spacing + along, up[:, 2]


def rotated(quaternions: Array) -> tuple[Array, Array, Array]:
    """Return the directions ahead, left and up, (B, 3) each, of bodies with quaternions (B, 4), w first."""
    w, x, y, z = quaternions.T
    ahead = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    left = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    up = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    return np.column_stack(ahead), np.column_stack(left), np.column_stack(up)


class DriveBatch:
    """Cars in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, physics: Physics = NOMINAL) -> None:
        self._envs = [Drive(physics) for _ in range(count)]

    def reset(self, place: int, seed: int) -> Array:
        obs: Array = self._envs[place].reset(seed=seed)[0]
        return obs

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags]:
        return drive([self._envs[place] for place in places], act)

    def why_ended(self, place: int) -> str:
        return why_ended(self._envs[place])


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return why an episode terminated."""
    inner: Any = env.unwrapped
    return "upside down" if look([inner])[2][0] < UPRIGHT else "off the road"
