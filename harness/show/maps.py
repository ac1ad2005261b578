"""Maps of tasks in which two axes of the state matter most: the true reward and R* over both, the other axes
being 0 and the action being the policy's own, with where an episode went."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from envs import EnvSpec
from envs.spec import Array
from harness.learn.exact import expected_rewards
from methods.base import Policy, Reward

SIDE = 48
"""Cells of a map along each axis, where states are no cells themselves."""
_VIRIDIS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
_PATH, _HERE, _TEXT = [255, 255, 255], [234, 67, 53], [90, 90, 90]


@dataclass(frozen=True)
class Maps:
    """true, learned: (H, W), the first row lowest; learned None where there is no R*. path: (T+1, 2), in
    cells from the lower left corner. axes: what is across and what is upwards, with their ranges."""

    true: Array
    learned: Array | None
    path: Array
    axes: tuple[str, str]

    def send(self, stream: rr.RecordingStream) -> None:
        """Both maps, the path once, and where the episode is at each step."""
        height, width = self.true.shape
        for name, values in self._named.items():
            stream.log(f"map/{name}", rr.Image(_coloured(values[::-1])), static=True)
        down = (self.path * [1, -1] + [0, height]).astype(np.float32)
        # An angle that passes the end of its range goes on at the other.
        jumps = np.flatnonzero(np.abs(np.diff(down, axis=0)).max(axis=1) > width / 2) + 1
        strips = [part for part in np.split(down, jumps) if len(part) > 1]
        stream.log("map/path", rr.LineStrips2D(strips, radii=-1.0, colors=_PATH), static=True)
        look = rr.Points2D.from_fields(radii=-5.0, colors=_HERE)
        stream.log("map/here", look, static=True)
        steps = rr.TimeColumn("step", sequence=np.arange(len(down)))
        stream.send_columns("map/here", [steps], rr.Points2D.columns(positions=down))
        places = [[width / 2, height * 1.02], [width / 2, -height * 0.12]]  # a label hangs below its place
        words = [f"across: {self.axes[0]}", f"upwards: {self.axes[1]}"]
        texts = rr.Points2D(places, labels=words, show_labels=True, radii=0.0, colors=_TEXT)
        stream.log("map/axes", texts, static=True)

    def views(self) -> list[rrb.Spatial2DView]:
        """One for each."""
        height, width = self.true.shape
        bounds = rrb.VisualBounds2D(
            x_range=(-0.05 * width, 1.05 * width), y_range=(-0.2 * height, 1.2 * height)
        )
        titles = {"true": "True reward", "learned": "R* above absorption"}
        return [
            rrb.Spatial2DView(
                origin="map",
                contents=[f"/map/{name}", "/map/path", "/map/here", "/map/axes"],
                name=f"{titles[name]}: {values.min():.3g} dark, {values.max():.3g} bright",
                visual_bounds=bounds,
                background=[255, 255, 255],
            )
            for name, values in self._named.items()
        ]

    @property
    def _named(self) -> dict[str, Array]:
        return {"true": self.true} | ({} if self.learned is None else {"learned": self.learned})


def maps(spec: EnvSpec, policy: Policy, reward: Reward | None, obs: Array) -> Maps | None:
    """Of an episode with observations (T+1, O); None where the task has no map. policy: deterministic."""
    if spec.name == "gridworld":
        return _of_cells(spec, policy, reward, obs)
    plane = _PLANES.get(spec.name.partition(".")[0])
    if plane is None or reward is None:
        return None
    low, high = np.array(plane(spec).low), np.array(plane(spec).high)
    middles = (np.arange(SIDE) + 0.5) / SIDE
    across, upwards = np.meshgrid(*(low + middles[:, None] * (high - low)).T)
    before, act, after, true = plane(spec).step(np.stack([across.ravel(), upwards.ravel()]), policy)
    learned = reward(before, act, after) - reward.absorbing
    place = (np.stack(plane(spec).place(obs.T), axis=1) - low) / (high - low) * SIDE
    axes = tuple(
        f"{name}, {a:.3g} to {b:.3g}" for name, a, b in zip(plane(spec).names, low, high, strict=True)
    )
    return Maps(true.reshape(SIDE, SIDE), learned.reshape(SIDE, SIDE), place, (axes[0], axes[1]))


@dataclass(frozen=True)
class Plane:
    """Two axes of a task's state. step: of states (2, N) and the policy's actions there, observations (N, O),
    actions (N, A), next observations and true rewards (N,). place: where observations (O, N) are."""

    names: tuple[str, str]
    low: tuple[float, float]
    high: tuple[float, float]
    step: Callable[[Array, Policy], tuple[Array, Array, Array, Array]]
    place: Callable[[Array], Sequence[Array]]


def _dynamics(
    spec: EnvSpec,
    names: tuple[str, str],
    at: tuple[int, int],
    reach: tuple[float, float],
    place: Callable[[Array], Sequence[Array]],
) -> Plane:
    """Of a task whose dynamics are written down. at: which entries of its state the axes are."""
    physics = spec.kwargs["physics"]

    def step(where: Array, policy: Policy) -> tuple[Array, Array, Array, Array]:
        state = np.zeros((len(physics.start(np.random.default_rng(0))), where.shape[1]))
        state[list(at)] = where
        before = np.asarray(physics.observe(state)).T
        act = np.array(spec.executed(policy(before.copy("K"))))
        given = act.T.astype(np.float32)
        after = physics.advance(state, given)
        true = np.broadcast_to(physics.pay(state, given, after), len(act))
        return before, act, np.asarray(physics.observe(after)).T, true

    return Plane(names, (-reach[0], -reach[1]), reach, step, place)


def _cart_and_pole(spec: EnvSpec) -> Plane:
    names = ("pole angle [rad]", "cart position [m]")
    return _dynamics(spec, names, (2, 0), (0.25, 2.6), lambda obs: (obs[2], obs[0]))


def _cart_swingup(spec: EnvSpec) -> Plane:
    names = ("pole angle [rad]", "cart position [m]")
    return _dynamics(spec, names, (2, 0), (np.pi, 3.2), lambda obs: (np.arctan2(obs[3], obs[2]), obs[0]))


def _swingup(spec: EnvSpec) -> Plane:
    names = ("angle from upright [rad]", "rate [rad/s]")
    return _dynamics(spec, names, (0, 1), (np.pi, 8.0), lambda obs: (np.arctan2(obs[1], obs[0]), obs[2]))


def _acrobot(spec: EnvSpec) -> Plane:
    names = ("first angle [rad]", "second angle [rad]")
    angles = lambda obs: (np.arctan2(obs[1], obs[0]), np.arctan2(obs[3], obs[2]))  # noqa: E731
    return _dynamics(spec, names, (0, 1), (np.pi, np.pi), angles)


def _still(
    spec: EnvSpec, policy: Policy, before: Array, pay: Callable[[Array, Array], Array]
) -> tuple[Array, Array, Array, Array]:
    """What stays where it is for a step."""
    act = np.array(spec.executed(policy(before.copy("K"))))
    return before, act, before, pay(before, act)


def _pendulum(spec: EnvSpec) -> Plane:
    from envs.balancing.pendulum import MAX_ANGLE, RAIL

    def step(where: Array, policy: Policy) -> tuple[Array, Array, Array, Array]:
        before = np.stack([where[1], where[0], 0 * where[0], 0 * where[0]], axis=1)
        return _still(
            spec, policy, before, lambda obs, act: (np.abs(obs[:, 1]) <= MAX_ANGLE).astype(np.float64)
        )

    names, reach = ("pole angle [rad]", "cart position [m]"), (1.25 * MAX_ANGLE, RAIL)
    return Plane(names, (-reach[0], -reach[1]), reach, step, lambda obs: (obs[1], obs[0]))


def _point_maze(spec: EnvSpec) -> Plane:
    from envs.point_maze import ENERGY, HIGH, LOW, TARGET

    def pay(obs: Array, act: Array) -> Array:
        away = np.linalg.norm(obs[:, :2] - TARGET, axis=1)
        return np.asarray(-away - ENERGY * np.square(act).sum(axis=1))

    def step(where: Array, policy: Policy) -> tuple[Array, Array, Array, Array]:
        return _still(spec, policy, np.concatenate([where, 0 * where]).T, pay)

    return Plane(("x [m]", "y [m]"), (LOW, LOW), (HIGH, HIGH), step, lambda obs: (obs[0], obs[1]))


_PLANES: dict[str, Callable[[EnvSpec], Plane]] = {
    **{"cartpole": _cart_and_pole, "cartpole_discrete": _cart_and_pole, "pendulum": _pendulum},
    **{"swingup": _swingup, "cartpole_swingup": _cart_swingup, "acrobot": _acrobot},
    "point_maze": _point_maze,
}
"""Tasks that are mapped, beside the grid world."""


def _of_cells(spec: EnvSpec, policy: Policy, reward: Reward | None, obs: Array) -> Maps:
    """Of the grid world, cell by cell; R* is expected over where the policy's action leads."""
    from envs.gridworld import SIZE, positions

    tabular = spec.tabular
    assert tabular is not None
    learned = None
    if reward is not None:
        chosen = policy(tabular.obs.copy()).argmax(axis=1)
        paid = expected_rewards(tabular, reward)[np.arange(len(chosen)), chosen]
        learned = (paid - reward.absorbing).reshape(SIZE, SIZE)
    path = np.asarray(positions(SIZE)[tabular.states(obs)] + 0.5, np.float64)
    return Maps(tabular.reward.reshape(SIZE, SIZE), learned, path, ("x [cells]", "y [cells]"))


def _coloured(values: Array) -> Array:
    """(H, W, 3): from dark for the least to bright for the greatest, in bytes."""
    spread = np.ptp(values)
    scaled = (values - values.min()) / spread if spread else np.full(values.shape, 0.5)
    anchors = np.linspace(0, 1, len(_VIRIDIS))
    channels = [np.interp(scaled, anchors, channel) for channel in _VIRIDIS.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
