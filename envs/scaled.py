"""Environments with actions in [-1, 1] or choices from 0 on, and the time limits of wrappers."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.utils import rescale_box
from numpy.typing import NDArray

UNEVEN = 0.01
"""Largest error of an action by rounding in its own precision, as a share of the distance of its bounds."""


class Scaled(gym.ActionWrapper[Any, Any, Any], RecordConstructorArgs):
    """An environment with actions in [-1, 1], in 32 bits, or choices from 0. Equal bounds fix an action."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ActionWrapper.__init__(self, env)
        space = env.action_space
        if isinstance(space, spaces.Discrete):
            first = int(space.start)
            self._native: Callable[[Any], Any] = lambda choice: np.int64(choice + first)
            self.action_space = spaces.Discrete(int(space.n))
            return
        assert isinstance(space, spaces.Box)
        wide, free = np.promote_types(space.dtype, np.float32), space.low < space.high
        low, high = np.where(free, space.low, 0).astype(wide), np.where(free, space.high, 1).astype(wide)
        ends = low.astype(np.float64), high.astype(np.float64)

        def precise(act: Any) -> NDArray[Any]:
            share = (np.asarray(act, np.float64) + 1) / 2
            return np.asarray((1 - share) * ends[0] + share * ends[1])

        with np.errstate(all="ignore"):  # some bounds are too far apart for 32 bits
            _, _, rescaled = rescale_box(
                spaces.Box(low, high, dtype=wide.type), np.float32(-1), np.float32(1)
            )
            points = np.stack([np.full(low.shape, end, np.float32) for end in (-1, 0, 1)])
            width = ends[1] / 2 - ends[0] / 2
            near = np.abs(rescaled(points).astype(np.float64) - precise(points)) <= UNEVEN * width
            even = near.all(axis=0)

        def native(act: Any) -> Any:
            if even.all():
                result = rescaled(act).astype(space.dtype)
            else:
                with np.errstate(all="ignore"):
                    result = np.where(even, rescaled(act), precise(act)).astype(space.dtype)
            # Rounding must not lead out of the bounds, which some environments check.
            return np.clip(result, space.low, space.high)

        self._native = native
        self.action_space = spaces.Box(-1.0, 1.0, space.shape, np.float32)

    def action(self, action: Any) -> Any:
        return self._native(action)


def scaled(env: gym.Env[Any, Any]) -> Scaled:
    """Return the environment with actions in [-1, 1], in 32 bits, or choices from 0 on."""
    return Scaled(env)


def time_limit(env: gym.Env[Any, Any]) -> int | None:
    """Return the steps after which the environment's wrappers truncate an episode, None if never."""
    limits = [wrapper._max_episode_steps for wrapper in wrappers(env) if isinstance(wrapper, TimeLimit)]
    return min(limits, default=None)


def wrappers(env: gym.Env[Any, Any]) -> Iterator[gym.Wrapper[Any, Any, Any, Any]]:
    """Yield the environment's wrappers, the outermost first."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
