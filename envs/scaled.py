"""Environments with actions in [-1, 1] or choices from 0 on, and the time limits of wrappers."""

import math
from collections.abc import Callable, Iterator
from typing import Any, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.utils import rescale_box
from numpy.typing import NDArray

from envs.flat import flat

UNEVEN = 0.01
"""Largest error of an action by rounding in its own precision, as a share of the distance of its bounds."""
MOST = 64
"""Largest number of combinations of whole actions that are choices."""
WAY_OUT = "give other actions by wrap= of from_gymnasium, such as gymnasium.wrappers.TransformAction"


class Scaled(gym.ActionWrapper[Any, Any, Any], RecordConstructorArgs):
    """An environment with actions in [-1, 1]^A, in 32 bits, or choices from 0. Equal bounds fix an action.

    Whole actions of several parts, or within bounds, are choices among all their combinations. Raises
    ValueError for unbounded actions, more than `MOST` combinations, and other actions.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ActionWrapper.__init__(self, env)
        space = env.action_space
        if isinstance(space, spaces.Discrete):
            first = int(space.start)
            self._native: Callable[[Any], Any] = lambda choice: np.int64(choice + first)
            self.action_space = spaces.Discrete(int(space.n))
        elif is_real(space):
            self._native = _reals(space)
            self.action_space = spaces.Box(-1.0, 1.0, (math.prod(space.shape),), np.float32)
        else:
            table = combinations(space)
            self._native = lambda choice: np.array(table[choice])
            self.action_space = spaces.Discrete(len(table))

    def action(self, action: Any) -> Any:
        return self._native(action)


def is_real(space: spaces.Space[Any]) -> TypeGuard[spaces.Box]:
    """Return whether actions are real numbers."""
    return isinstance(space, spaces.Box) and space.dtype.kind == "f"


def combinations(space: spaces.Space[Any]) -> NDArray[Any]:
    """Return all actions (N, ...) of a space of whole numbers. Raises ValueError as `Scaled` does."""
    match space:
        case spaces.MultiDiscrete():
            first, sizes = space.start, space.nvec
        case spaces.MultiBinary():
            first, sizes = np.zeros(space.shape, int), np.full(space.shape, 2)
        case spaces.Box():
            first, sizes = space.low, space.high.astype(object) - space.low.astype(object) + 1
        case _:
            raise ValueError(f"actions must be choices or bounded numbers, not {space}; {WAY_OUT}")
    parts = [int(size) for size in np.ravel(sizes)]
    if (count := math.prod(parts)) > MOST:
        raise ValueError(
            f"whole actions {space} have {count:,} combinations, more than the {MOST} that can be choices; "
            f"{WAY_OUT}"
        )
    places = np.array(list(np.ndindex(*parts)), np.int64).reshape(count, len(parts))
    return np.asarray((places + first.ravel()).reshape(count, *space.shape).astype(space.dtype))


def _reals(space: spaces.Box) -> Callable[[Any], NDArray[Any]]:
    """Return the function from actions (..., A) in [-1, 1] to the space's own."""
    if not space.is_bounded() or 0 in space.shape:
        lack = "a component" if space.is_bounded() else "bounds"
        raise ValueError(f"actions must have {lack}, which {space} has not; {WAY_OUT}")
    lowest, highest = space.low.ravel(), space.high.ravel()
    wide, free = np.promote_types(space.dtype, np.float32), lowest < highest
    low, high = np.where(free, lowest, 0).astype(wide), np.where(free, highest, 1).astype(wide)
    ends = low.astype(np.float64), high.astype(np.float64)

    def precise(act: Any) -> NDArray[Any]:
        share = (np.asarray(act, np.float64) + 1) / 2
        return np.asarray((1 - share) * ends[0] + share * ends[1])

    with np.errstate(all="ignore"):  # some bounds are too far apart for 32 bits
        _, _, rescaled = rescale_box(spaces.Box(low, high, dtype=wide.type), np.float32(-1), np.float32(1))
        points = np.stack([np.full(low.shape, end, np.float32) for end in (-1, 0, 1)])
        width = ends[1] / 2 - ends[0] / 2
        near = np.abs(rescaled(points).astype(np.float64) - precise(points)) <= UNEVEN * width
        even = near.all(axis=0)

    def native(act: Any) -> NDArray[Any]:
        if even.all():
            result = rescaled(act).astype(space.dtype)
        else:
            with np.errstate(all="ignore"):
                result = np.where(even, rescaled(act), precise(act)).astype(space.dtype)
        # Rounding must not lead out of the bounds, which some environments check.
        bounded = np.clip(result, lowest, highest)
        return bounded if len(space.shape) == 1 else bounded.reshape(space.shape)

    return native


def scaled(env: gym.Env[Any, Any]) -> Scaled:
    """Return the environment with actions in [-1, 1], in 32 bits, or choices from 0 on."""
    return env if isinstance(env, Scaled) else Scaled(env)


def standard(
    env: gym.Env[Any, Any],
    wrap: Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None = None,
    encoder: str = "small",
) -> gym.Env[Any, Any]:
    """Return the environment in a wrapper, with observations as vectors and with `scaled` actions."""
    return scaled(flat(wrap(env) if wrap else env, encoder))


def time_limit(env: gym.Env[Any, Any]) -> int | None:
    """Return the steps after which the environment's wrappers truncate an episode, None if never."""
    limits = [wrapper._max_episode_steps for wrapper in wrappers(env) if isinstance(wrapper, TimeLimit)]
    return min(limits, default=None)


def wrappers(env: gym.Env[Any, Any]) -> Iterator[gym.Wrapper[Any, Any, Any, Any]]:
    """Yield the environment's wrappers, the outermost first."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
