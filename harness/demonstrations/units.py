"""Units of actions in files of demonstrations: which of them are -1 and 1 in the task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation, RescaleAction
from numpy.typing import NDArray

from envs import EnvSpec
from envs.scaled import Scaled, combinations, wrappers
from harness.demonstrations.recording import OWN_FORM, Bounds, Recording
from harness.registry import BadInput
from methods.base import Array

SLACK = 1e-6
"""Largest difference between bounds, or distance outside of them, that counts as rounding: a share."""
FARTHEST = 1e6
"""Bounds of a file beyond it count as unbounded."""
SCALED: Bounds = np.array([[-1.0], [1.0]])
OPTION = "--action-bounds"


@dataclass(frozen=True)
class Units:
    """Lowest and highest action of a file, (A,) each, and who says so.

    first: number of the first choice in a discrete task, whose bounds are not used.
    """

    low: Array
    high: Array
    why: str
    first: int = 0

    def __str__(self) -> str:
        return as_pairs(np.array([self.low, self.high]))

    def beyond(self, act: NDArray[Any]) -> Array:
        """Return (T, A): how far actions (T, A) of the file are outside."""
        return np.asarray(np.maximum(np.maximum(self.low - act, act - self.high), 0.0))

    def excess(self, act: NDArray[Any]) -> Array:
        """Return (T, A): how far actions (T, A) of the file are outside, and 0 for rounding."""
        beyond = self.beyond(act)
        width, size = self.high - self.low, np.maximum(abs(self.low), abs(self.high))
        return np.where(beyond > SLACK * np.where(width > 0, width, size), beyond, 0.0)

    def scaled(self, act: Array) -> Array:
        """Return actions (T, A) of the file in [-1, 1]; 0 where both bounds are the same."""
        if (self.low == -1).all() and (self.high == 1).all():  # where a product would round some
            return np.clip(act, -1, 1)
        width = self.high - self.low
        free = width > 0
        shares = np.where(free, 2 * (act - self.low) / np.where(free, width, 1.0) - 1, 0.0)
        return np.clip(shares, -1, 1)

    def native(self, act: Array) -> Array:
        """Return actions (T, A) in [-1, 1] as the file has them."""
        return self.low + (act + 1) / 2 * (self.high - self.low)


def units_of(recording: Recording, spec: EnvSpec, env: gym.Env[Any, Any], asked: Bounds | None) -> Units:
    """Return the units of a file's actions: as the user says (`asked`), or the file, or else the task.

    env: the environment of the task.
    Raises ValueError where these contradict each other, or where two are possible and nobody says which.
    """
    if spec.discrete:
        if asked is not None:
            raise ValueError(f"its actions are choices, which have no {OPTION}")
        first = first_choice(env)
        if recording.first not in (None, first):
            raise ValueError(
                f"its choices are numbered from {recording.first} on, and the task's from {first} on"
            )
        unused = np.zeros(spec.act_size)
        return Units(unused, unused, "the task's own", first)
    if recording.first is not None:
        raise ValueError("its actions are choices, and the task's are numbers")
    if recording.bounds is not None and recording.bounds.shape[1] not in (1, spec.act_size):
        raise ValueError("its bounds are of other actions than the task's")
    native, public = _native_bounds(env, spec.act_size), None
    if spec.public_bounds is not None:
        public = np.array(spec.public_bounds)[:, None]
    if asked is not None:
        why = f"as {OPTION} says"
        bounds = _as_asked(asked, recording.bounds, native, spec.act_size)
    elif recording.bounds is not None:
        why = "as the file says"
        bounds = _as_recorded(recording.bounds, [one for one in (SCALED, native, public) if one is not None])
    elif recording.form == OWN_FORM:
        bounds, why = SCALED, "by this project's form"
    else:
        bounds, why = _as_in_task(recording.arrays["act"], native, public), "the task's own"
    low, high = np.broadcast_to(bounds, (2, spec.act_size)).astype(np.float64)
    return Units(low, high, why)


def first_choice(env: gym.Env[Any, Any]) -> int:
    """Return the number of the first choice of a discrete task: its own, or 0 for the first of combinations.
    Raises BadInput as `choices`."""
    table = choices(env)
    return int(table[0, 0]) if table.shape[1] == 1 else 0


def choices(env: gym.Env[Any, Any]) -> NDArray[Any]:
    """Return the choices of a discrete task as its own environment has them, (N, P) of P whole numbers each.
    Raises BadInput where a wrapper hides them."""
    space = _space_beneath(env)
    if space is None:
        raise BadInput("a wrapper of the task changes its choices, so their numbers are not known")
    if isinstance(space, spaces.Discrete):
        return np.arange(space.start, space.start + space.n)[:, None]
    table = combinations(space)
    return table.reshape(len(table), -1)


def space_observed(env: gym.Env[Any, Any]) -> spaces.Space[Any] | None:
    """Return the space of the observations that a task makes vectors; None where it makes none, or changes
    the vectors."""
    for wrapper in wrappers(env):
        if isinstance(wrapper, gym.ObservationWrapper):
            return wrapper.env.observation_space if isinstance(wrapper, FlattenObservation) else None
    return None


def _as_asked(asked: Bounds, recorded: Bounds | None, native: Bounds | None, size: int) -> Bounds:
    pairs = asked.shape[1]
    if pairs not in (1, size):
        raise ValueError(f"{OPTION} is given {pairs} times, and its actions have {size} components")
    if pairs < size and native is not None and not _same(asked, SCALED) and np.ptp(native, axis=1).any():
        raise ValueError(
            f"its {size} components have other bounds each, in the task {as_pairs(native)}; give {OPTION} "
            "for each, in this order"
        )
    if recorded is not None and not _same(np.where(abs(recorded) > FARTHEST, asked, recorded), asked):
        raise ValueError(f"{OPTION} {as_pairs(asked)} contradicts the file, which says {as_pairs(recorded)}")
    return asked


def _as_recorded(recorded: Bounds, known: list[Bounds]) -> Bounds:
    if not np.abs(recorded).max() <= FARTHEST:
        raise ValueError(f"it does not tell the bounds of its actions; give them as {OPTION}")
    if not any(_same(recorded, bounds) for bounds in known):
        names = " or ".join(dict.fromkeys(map(as_pairs, known)))
        raise ValueError(
            f"its actions are in {as_pairs(recorded)}, and the task's in {names}; to scale them by their "
            f"bounds, give these as {OPTION}"
        )
    return recorded


def _as_in_task(act: NDArray[Any], native: Bounds | None, public: Bounds | None) -> Bounds:
    if native is None:
        raise ValueError(
            f"a wrapper of the task changes its actions, so their bounds in the file are not known; give "
            f"them as {OPTION}, or {OPTION}=scaled for [-1, 1]"
        )
    if public is not None and np.abs(act).max(initial=0) <= 1 + SLACK:
        low, high = public.ravel()
        raise ValueError(
            f"its actions may be in {as_pairs(public)}, as in the public environment, or in [-1, 1], as in "
            f"this task; give {OPTION}={low:g},{high:g} or {OPTION}=scaled"
        )
    return native if public is None else public


def _native_bounds(env: gym.Env[Any, Any], size: int) -> Bounds | None:
    """Return the bounds of actions in the task's own environment; None where a wrapper hides them."""
    space = _space_beneath(env)
    if not isinstance(space, spaces.Box) or space.shape != (size,):
        return None
    return np.array([space.low, space.high], np.float64)


def _space_beneath(env: gym.Env[Any, Any]) -> spaces.Space[Any] | None:
    """Return the space of actions beneath all wrappers; None where they do more than scale or number anew."""
    for wrapper in wrappers(env):
        evenly = isinstance(wrapper, Scaled | RescaleAction)
        if not evenly and (
            isinstance(wrapper, gym.ActionWrapper) or wrapper.action_space != wrapper.env.action_space
        ):
            return None
    return env.unwrapped.action_space


def _same(one: Bounds, other: Bounds) -> bool:
    return bool(np.allclose(one, other, rtol=SLACK, atol=0))


def as_pairs(bounds: Bounds) -> str:
    """Return bounds as text, such as '[-1, 1] x [0, 5]'."""
    pairs = [f"[{low:g}, {high:g}]" for low, high in bounds.T]
    return pairs[0] if len(set(pairs)) == 1 else " x ".join(pairs)
