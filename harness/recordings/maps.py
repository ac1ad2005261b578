"""Maps of both rewards over two axes of the state, with an episode's path.

The other axes of the state are 0, and the action is the policy's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from envs import EnvSpec, gridworld, point_maze
from envs.spec import Array
from harness.recordings.common import GREY, WHITE, send_columns
from harness.rl.exact import expected_rewards
from methods.base import Policy, Reward

SIDE = 48
"""Cells of a map along each axis of a continuous state."""
_VIRIDIS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
_RED = (234, 67, 53)


@dataclass(frozen=True)
class Maps:
    """Rewards by name, (H, W) with the lowest row first, and the path of an episode.

    `path`: (T+1, 2), in cells from the lower left corner. `axes`: labels of both axes, horizontal first.
    """

    rewards: dict[str, Array]
    path: Array
    axes: tuple[str, str]

    def send(self, stream: rr.RecordingStream) -> None:
        """Send the maps, the path, and the place of the episode at each step."""
        height, width = self.rewards["true"].shape
        for name, values in self.rewards.items():
            stream.log(f"map/{name}", rr.Image(_coloured(values[::-1])), static=True)
        places = (self.path * [1, -1] + [0, height]).astype(np.float32)
        # An angle that passes one end of its range continues at the other.
        jumps = np.flatnonzero(np.abs(np.diff(places, axis=0)).max(axis=1) > width / 2) + 1
        strips = [part for part in np.split(places, jumps) if len(part) > 1]
        stream.log("map/path", rr.LineStrips2D(strips, radii=-1.0, colors=WHITE), static=True)
        stream.log("map/here", rr.Points2D.from_fields(radii=-5.0, colors=_RED), static=True)
        send_columns(stream, "map/here", np.arange(len(places)), rr.Points2D.columns(positions=places))
        corners = [[width / 2, height * 1.02], [width / 2, -height * 0.12]]  # a label hangs below its place
        labels = [f"across: {self.axes[0]}", f"upwards: {self.axes[1]}"]
        texts = rr.Points2D(corners, labels=labels, show_labels=True, radii=0.0, colors=GREY)
        stream.log("map/axes", texts, static=True)

    def views(self) -> list[rrb.Spatial2DView]:
        """Return a view of each map."""
        height, width = self.rewards["true"].shape
        x_range, y_range = (-0.05 * width, 1.05 * width), (-0.2 * height, 1.2 * height)
        titles = {"true": "True reward", "learned": "R* above absorption"}
        return [
            rrb.Spatial2DView(
                origin="map",
                contents=[f"/map/{name}", "/map/path", "/map/here", "/map/axes"],
                name=f"{titles[name]}: {values.min():.3g} dark, {values.max():.3g} bright",
                visual_bounds=rrb.VisualBounds2D(x_range=x_range, y_range=y_range),
                background=WHITE,
            )
            for name, values in self.rewards.items()
        ]


def _coloured(values: Array) -> Array:
    """Return colours in bytes, (H, W, 3), from dark for the least to bright for the greatest."""
    spread = np.ptp(values)
    scaled = (values - values.min()) / spread if spread else np.full(values.shape, 0.5)
    anchors = np.linspace(0, 1, len(_VIRIDIS))
    channels = [np.interp(scaled, anchors, channel) for channel in _VIRIDIS.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def maps(spec: EnvSpec, policy: Policy, reward: Reward | None, obs: Array) -> Maps | None:
    """Return the maps of an episode with observations (T+1, O). None for a task without maps.

    policy: deterministic. reward: R*, which only the grid world does without.
    """
    if spec.name == "gridworld":
        return _cells(spec, policy, reward, obs)
    axes = _AXES.get(spec.name.partition(".")[0])
    if axes is None or reward is None:
        return None
    low, high = np.array(axes.low or np.negative(axes.high)), np.array(axes.high)
    middles = (np.arange(SIDE) + 0.5) / SIDE
    grid = np.meshgrid(*(low + middles[:, None] * (high - low)).T)
    before, act, after, true = _steps(spec, policy, axes, np.stack([values.ravel() for values in grid]))
    learned = reward(before, act, after) - reward.absorbing
    places = [obs[:, at] if isinstance(at, int) else np.arctan2(*obs[:, at].T) for at in axes.place]
    path = (np.stack(places, axis=1) - low) / (high - low) * SIDE
    across, upwards = (
        f"{name}, {a:.3g} to {b:.3g}" for name, a, b in zip(axes.names, low, high, strict=True)
    )
    rewards = {"true": true.reshape(SIDE, SIDE), "learned": learned.reshape(SIDE, SIDE)}
    return Maps(rewards, path, (across, upwards))


def _cells(spec: EnvSpec, policy: Policy, reward: Reward | None, obs: Array) -> Maps:
    """Return the maps of the grid world. R* of a cell is expected over where the policy's action leads."""
    tabular, shape = spec.tabular, (gridworld.SIZE, gridworld.SIZE)
    assert tabular is not None
    rewards = {"true": tabular.reward.reshape(shape)}
    if reward is not None:
        chosen = policy(tabular.obs.copy()).argmax(axis=1)
        paid = expected_rewards(tabular, reward)[np.arange(len(chosen)), chosen]
        rewards["learned"] = (paid - reward.absorbing).reshape(shape)
    path = gridworld.positions(gridworld.SIZE)[tabular.states(obs)] + 0.5
    return Maps(rewards, np.asarray(path, np.float64), ("x [cells]", "y [cells]"))


@dataclass(frozen=True)
class Axes:
    """Two axes of a task's state, from `low`, by default -`high`, to `high`.

    `place`: for each axis the entry of observations, or the entries of an angle's sine and cosine.
    `entries`: the entries of the state; None for the maze, where they are those of observations.
    """

    names: tuple[str, str]
    high: tuple[float, float]
    place: Sequence[int | list[int]]
    entries: tuple[int, int] | None
    low: tuple[float, float] | None = None


def _steps(
    spec: EnvSpec, policy: Policy, axes: Axes, coordinates: Array
) -> tuple[Array, Array, Array, Array]:
    """Return observations, actions, next observations and true rewards of steps from coordinates (2, N).

    In the maze they are those of a ball that stands still.
    """
    if axes.entries is None:
        before = np.concatenate([coordinates, 0 * coordinates]).T
        act = np.array(spec.executed(policy(before.copy("K"))))
        distance = np.linalg.norm(before[:, :2] - point_maze.TARGET, axis=1)
        return before, act, before, -distance - point_maze.ENERGY * np.square(act).sum(axis=1)
    physics = spec.kwargs["physics"]
    state = np.zeros((len(physics.start(np.random.default_rng(0))), coordinates.shape[1]))
    state[list(axes.entries)] = coordinates
    before = np.asarray(physics.observe(state)).T
    act = np.array(spec.executed(policy(before.copy("K"))))
    forces = act.T.astype(np.float32)
    after = physics.advance(state, forces)
    true = np.broadcast_to(physics.pay(state, forces, after), len(act))
    return before, act, np.asarray(physics.observe(after)).T, true


_POLE = ("pole angle [rad]", "cart position [m]")
_CARTPOLE = Axes(_POLE, (0.25, 2.6), (2, 0), (2, 0))
_AXES = {
    "cartpole": _CARTPOLE,
    "cartpole_discrete": _CARTPOLE,
    "cartpole_swingup": Axes(_POLE, (np.pi, 3.2), ([3, 2], 0), (2, 0)),
    "swingup": Axes(("angle from upright [rad]", "rate [rad/s]"), (np.pi, 8.0), ([1, 0], 2), (0, 1)),
    "acrobot": Axes(("first angle [rad]", "second angle [rad]"), (np.pi, np.pi), ([1, 0], [3, 2]), (0, 1)),
    "point_maze": Axes(("x [m]", "y [m]"), (point_maze.HIGH,) * 2, (0, 1), None, low=(point_maze.LOW,) * 2),
}
"""Axes of the tasks with maps, without the grid world."""
