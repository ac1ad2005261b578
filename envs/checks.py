"""Checks of the values that tasks return: real, finite numbers of the right shapes, and flags."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.spec import Array

LARGEST = 1e100  # largest size of a reward that counts as finite: sums of these are finite too
INSTANCES = 3  # instances of a task that are made to see whether they agree


class Misgiven(ValueError):
    """An error about a value that no task may return. `row`: number of the copy among those stepped."""

    def __init__(self, value: object, role: str, needed: str) -> None:
        super().__init__(f"it gives {value!r} as {role}, which must be {needed}")
        self.value, self.role, self.needed, self.row = value, role, needed, 0


def started(result: Any) -> Any:
    """Return the observation of what `reset` returned. Raises ValueError unless that is a pair."""
    if not (isinstance(result, tuple) and len(result) == 2):
        raise ValueError(f"reset must return an observation and a dict, not {result!r:.80}")
    return result[0]


@contextmanager
def named(task: str, steps: Sequence[int]) -> Iterator[None]:
    """Raise ValueError with the task and the step for each `Misgiven`. `steps`: of each episode so far."""
    try:
        yield
    except Misgiven as wrong:
        value = " ".join(repr(wrong.value).split())
        start = f"{task} gives {value:.80} as {wrong.role} of step {steps[wrong.row]}"
        raise ValueError(f"{start}, which must be {wrong.needed}") from wrong


def real(value: Any, role: str = "observation", kinds: str = "fiub") -> NDArray[Any]:
    """Return a task's value as an array of real numbers, or of other `kinds`. Raises `Misgiven` for other
    arrays and masked ones."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        array = np.empty(0, object)
    if array.dtype.kind not in kinds or isinstance(value, np.ma.MaskedArray):
        raise Misgiven(value, role, "real numbers without a mask" if "f" in kinds else "true or false")
    return array


def number(reward: Any) -> float:
    """Return a reward, which is a number or an array of one. Raises `Misgiven` for others."""
    if type(reward) is float:
        return reward
    array = real(reward, "reward")
    if array.size != 1:
        raise Misgiven(reward, "reward", "one number")
    return float(array.item())


def flags(reward: Any, terminated: Any, truncated: Any) -> tuple[float, bool, bool]:
    """Return a step's reward and flags. Raises `Misgiven` unless they are a number and true or false, or
    arrays of one such entry."""
    return number(reward), _flag(terminated, "terminated"), _flag(truncated, "truncated")


def _flag(value: Any, role: str) -> bool:
    if type(value) is bool:
        return value
    array = real(value, role, "b")
    if array.size != 1:
        raise Misgiven(value, role, "true or false")
    return bool(array.item())


def check_numbers(task: str, size: int, obs: Array, rewards: Array, steps: Sequence[int]) -> None:
    """Raise ValueError unless observations (B, size) and rewards (B,) fit and are finite, after `steps`
    each."""
    if obs.shape[1:] != (size,):
        raise ValueError(f"{task} gives an observation of the shape {obs.shape[1:]}, not ({size},)")
    if rewards.shape != obs.shape[:1]:
        raise ValueError(f"{task} gives rewards of the shape {rewards.shape} for {len(obs)} steps")
    if not np.isfinite(obs).all():
        row, entry = np.argwhere(~np.isfinite(obs))[0]
        raise ValueError(f"{task} gives {obs[row, entry]} as observation {entry} after step {steps[row]}")
    if not (np.abs(rewards) <= LARGEST).all():
        (row,) = np.argwhere(~(np.abs(rewards) <= LARGEST))[0]
        raise ValueError(f"{task} gives {rewards[row]} as reward of step {steps[row]}")
