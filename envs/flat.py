"""Observations of any shape as vectors, and names of the vectors' entries."""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation
from numpy.typing import NDArray

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
    ValueError for images among other things, texts and sequences, for no entry, and for more than `MOST`.
    """
    if channels_last(space):
        return [(f"feature {number}", False) for number in range(FEATURES)]
    found = [*islice(_entries(space), MOST + 1)]
    if not 0 < len(found) <= MOST:
        count = f"more than {MOST:,} entries" if found else "no entry"
        raise ValueError(f"observations {space} have {count}; give others by wrap= of from_gymnasium")
    return found


def vectors(space: spaces.Space[Any], rows: NDArray[Any]) -> NDArray[Any]:
    """Return observations as the vectors (N, O) of `entries`.

    rows: (N, O), or the numbers of the space in its order, (N, ...), in which a choice is one number. Other
    rows are returned as they are. Raises ValueError for a choice that the space does not have.
    """
    numbers, columns = [*_numbers(space, "")], []
    if rows[:1].size != len(numbers) or rows.shape[1:] == (len(entries(space)),):
        return rows
    flat_rows = rows.reshape(len(rows), len(numbers))
    for (name, choices, _), column in zip(numbers, flat_rows.T[:, :, None], strict=True):
        chosen = column == np.array(choices)
        if choices and (odd := ~chosen.any(axis=1)).any():
            known = f"{choices[0]} to {choices[-1]}"
            raise ValueError(f"it observes {column[odd][0, 0]:g} as {name}, which is a number from {known}")
        columns.append(chosen if choices else column)
    return np.concatenate(columns, axis=1)


def _entries(space: spaces.Space[Any]) -> Iterator[tuple[str, bool]]:
    for name, choices, is_flag in _numbers(space, ""):
        if choices:
            yield from ((f"{name}={choice}", True) for choice in choices)
        else:
            yield name, is_flag


def _numbers(space: spaces.Space[Any], name: str) -> Iterator[tuple[str, range, bool]]:
    """Yield the name of each number of a space, its choices if it is one, and whether it is 0 or 1."""
    match space:
        case spaces.Dict():
            for key, part in space.spaces.items():
                yield from _numbers(part, f"{name} {key}".strip())
        case spaces.Tuple():
            for i, part in enumerate(space.spaces):
                yield from _numbers(part, f"{name or _OBS} {i}")
        case spaces.Discrete():
            yield name or _OBS, range(int(space.start), int(space.start + space.n)), True
        case spaces.MultiDiscrete():
            for place in np.ndindex(space.shape):
                first = int(space.start[place])
                yield _at(name, place), range(first, first + int(space.nvec[place])), True
        case spaces.Box() | spaces.MultiBinary() if len(space.shape) < 3:
            is_flag = isinstance(space, spaces.MultiBinary)
            yield from ((_at(name, place), range(0), is_flag) for place in np.ndindex(space.shape))
        case _:
            kind = f"images {space.shape}" if isinstance(space, spaces.Box) else type(space).__name__
            raise ValueError(
                f"observations must be numbers or choices, not {kind}, {space}; make them vectors by "
                "wrap= of from_gymnasium"
            )


def _at(name: str, place: tuple[int, ...]) -> str:
    return " ".join([name or _OBS, ",".join(map(str, place))]).strip()
