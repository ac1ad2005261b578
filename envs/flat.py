"""Observations of any shape as vectors, and names of the vectors' entries."""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation

from envs.encoders import FEATURES, Encoded, channels_last

MOST = 10_000
"""Largest number of entries of an observation that is made a vector."""
_OBS = "obs"


def flat(env: gym.Env[Any, Any], encoder: str = "small") -> gym.Env[Any, Any]:
    """Return the environment with observations as vectors (O,), images by an encoder (`envs.encoders`).
    Raises ValueError as `entries`."""
    space = env.observation_space
    if channels_last(space):
        return Encoded(env, encoder)
    if isinstance(space, spaces.Box) and len(space.shape) == 1:
        return env
    entries(space)
    return FlattenObservation(env)


def entries(space: spaces.Space[Any]) -> list[tuple[str, bool]]:
    """Return the name of each entry of observations that are made vectors, and whether it is 0 or 1.

    A choice has an entry for each value, 1 for the chosen one: 'gear=2'. An image has features. Raises
    ValueError for images among other things, texts and sequences, and for more than `MOST` entries.
    """
    if channels_last(space):
        return [(f"feature {number}", False) for number in range(FEATURES)]
    found = [*islice(_entries(space, ""), MOST + 1)]
    if len(found) > MOST:
        raise ValueError(
            f"observations {space} have more than {MOST:,} entries; reduce them by wrap= of from_gymnasium"
        )
    return found


def _entries(space: spaces.Space[Any], name: str) -> Iterator[tuple[str, bool]]:
    match space:
        case spaces.Dict():
            for key, part in space.spaces.items():
                yield from _entries(part, f"{name} {key}".strip())
        case spaces.Tuple():
            for i, part in enumerate(space.spaces):
                yield from _entries(part, f"{name or _OBS} {i}")
        case spaces.Discrete():
            yield from ((f"{name or _OBS}={space.start + i}", True) for i in range(space.n))
        case spaces.MultiDiscrete():
            for place in np.ndindex(space.shape):
                first = space.start[place]
                yield from ((f"{_at(name, place)}={first + i}", True) for i in range(space.nvec[place]))
        case spaces.Box() | spaces.MultiBinary() if len(space.shape) < 3:
            is_flag = isinstance(space, spaces.MultiBinary)
            yield from ((_at(name, place), is_flag) for place in np.ndindex(space.shape))
        case _:
            kind = f"images {space.shape}" if isinstance(space, spaces.Box) else type(space).__name__
            raise ValueError(
                f"observations must be numbers or choices, not {kind}, {space}; make them vectors by "
                "wrap= of from_gymnasium"
            )


def _at(name: str, place: tuple[int, ...]) -> str:
    return " ".join([name or _OBS, ",".join(map(str, place))]).strip()
