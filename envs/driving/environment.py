"""The highway as an environment and as a batch, stepped by compiled traffic (`envs.driving.traffic`)."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray

from envs.driving import scene as road
from envs.driving.scene import Scene, first_scene, in_line
from envs.dynamics import Draws, namespace
from envs.spec import Array, Flags, Floats

Ints = NDArray[np.int64]

VEHICLES = 12  # besides the ego
OBS_SIZE = 18
BLOCK = 64  # scenes in a compiled step: always as many, so that a scene's bits do not depend on other scenes


@dataclass(frozen=True)
class Traffic:
    """The task's dynamics (`envs.dynamics.Dynamics`) in JAX. A state is a scene's rows, one after the
    other."""

    vehicles: int = VEHICLES
    """Vehicles besides the ego."""
    density: float = 1.0
    """Density of vehicles, relative to highway-env's."""
    act_size = 2
    bounds = (50.0,) * OBS_SIZE

    def first(self, rng: np.random.Generator) -> Array:
        """Return a first scene (12, 1 + vehicles), as highway-env draws it."""
        return first_scene(rng, self.vehicles, self.density)

    def start(self, draws: Draws) -> Any:
        low, high = np.transpose([(0, road.LANES), road.SPEEDS, road.SPREADS, road.DELTAS])[..., None]
        one = np.ones(1 + self.vehicles)
        lane, speed, spread, delta = draws.uniform(low * one, high * one)
        xp, ego = namespace(lane), np.arange(len(one)) == 0
        speed, delta = xp.where(ego, road.EGO_SPEED, speed), xp.where(ego, 0.0, delta)
        return in_line(xp.floor(lane), speed, spread, delta, self.density).ravel()

    def advance(self, state: Any, act: Any) -> Any:
        from envs.driving import traffic

        after = traffic.step(_rows(state), act.T)
        return after.reshape(len(after), -1).T

    def observe(self, state: Any) -> Any:
        from envs.driving import observing

        return observing.observe(_rows(state)).T

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        from envs.driving import observing

        return observing.judge(_rows(after))[0]

    def fails(self, state: Any) -> Any:
        from envs.driving import observing

        return observing.judge(_rows(state))[1]

    def failure(self, state: Array) -> str:
        return "crashed" if Scene(*state.reshape(len(Scene._fields), -1)).crashed[0] else "left the road"


def _rows(state: Any) -> Any:
    """Return states (S, B) in the form of traffic, (B, 12, N)."""
    return state.T.reshape(state.shape[1], len(Scene._fields), -1)


NOMINAL = Traffic()


class Highway(gym.Env[Floats, Floats]):
    """Observation (18,), with units in brackets. The ego: offsets from the road's middle [4 m] and its lane's
    [1 m], lateral speed [1 m/s], and forward speed less 25 m/s [5 m/s].

    Then the distances to the left and right [4 m], up to 8 m. They are to the road's edge, or to a vehicle
    that is beside the ego or will be within a second. The left, own and right lane follow, each centred on
    the ego. Each has the free gap ahead [20 m], up to 60 m, the relative speed there [5 m/s], and both
    behind. Missing lanes are 0. Action (2,) in [-1, 1]: acceleration and steering. Terminates on a crash or
    off the road. Reward: forward speed from 10 to 25 m/s mapped to [0, 1], less 25 on a crash, and 0 off the
    road.
    """

    def __init__(self, physics: Traffic) -> None:
        self.physics = physics
        bounds = np.array(physics.bounds, np.float32)
        self.observation_space = spaces.Box(-bounds, bounds)
        self.action_space = spaces.Box(-1.0, 1.0, (physics.act_size,), np.float32)
        self.state = np.empty((0, 0))

    @property
    def scene(self) -> Scene:
        """The present scene. Its rows (1 + vehicles,) can be written to."""
        return Scene(*self.state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.state = self.physics.first(self.np_random)
        obs: Floats = look(self.state[None])[0]
        return obs, {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        (obs,), (reward,), (terminated,) = drive(self.state[None], np.zeros(1, np.int64), action[None])
        return obs, float(reward), bool(terminated), False, {"crashed": bool(self.scene.crashed[0])}


def first_states(seeds: Sequence[int], physics: Traffic = NOMINAL) -> Array:
    """Return the first states of the episodes of these seeds, (R, 12, 1 + vehicles)."""
    return np.array([physics.first(seeding.np_random(seed)[0]) for seed in seeds])


def look(states: Array) -> Floats:
    """Return the observations (R, 18) of states (R, 12, N)."""
    (obs,) = _in_blocks("look", states)
    return obs


def drive(states: Array, places: Ints, act: NDArray[Any]) -> tuple[Floats, Array, NDArray[Any]]:
    """Step the states (R, 12, N) at `places`, in place, by actions (B, 2). Return observations (B, 18),
    rewards (B,), and flags of termination (B,)."""
    states[places], obs, rewards, terminated = _in_blocks("drive", states[places], act.astype(np.float32))
    return obs, rewards, terminated


def _in_blocks(program: str, *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the results of a compiled program for arrays, `BLOCK` rows at a time."""
    import jax

    count = len(arrays[0])
    if count % BLOCK:  # filled up with the first rows again
        arrays = tuple(np.resize(array, (count + -count % BLOCK, *array.shape[1:])) for array in arrays)
    parts = []
    with jax.enable_x64(True):
        for row in range(0, count, BLOCK):
            results = _programs()[program](*(array[row : row + BLOCK] for array in arrays))
            parts.append([np.asarray(result) for result in results])
    whole = parts[0] if len(parts) == 1 else [np.concatenate(part) for part in zip(*parts, strict=True)]
    return [result[:count] for result in whole]


@functools.cache
def _programs() -> dict[str, Callable[..., Any]]:
    import jax

    from envs.driving import observing, traffic

    def drive(states: Any, act: Any) -> Any:
        states = traffic.step(states, act)
        return states, observing.observe(states), *observing.judge(states)

    return {"look": jax.jit(lambda states: (observing.observe(states),)), "drive": jax.jit(drive)}


class HighwayBatch:
    """Scenes of the task in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, physics: Traffic) -> None:
        self._physics = physics
        self._states = np.zeros((count, len(Scene._fields), 1 + physics.vehicles))

    def reset(self, place: int, seed: int) -> Array:
        first = first_states([seed], self._physics)
        self._states[place] = first[0]
        return np.asarray(look(first)[0], np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags]:
        obs, rewards, terminated = drive(self._states, np.array(places), act)
        return obs.astype(np.float64), rewards, terminated

    def why_ended(self, place: int) -> str:
        return self._physics.failure(self._states[place])
