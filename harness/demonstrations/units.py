"""Units of actions in files of demonstrations: which of them are -1 and 1 in the task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs import EnvSpec
from harness.demonstrations.npz import OWN_FORM
from harness.demonstrations.recording import Bounds, Recording
from harness.registry import BadInput
from methods.base import Array

SLACK = 1e-6
"""Largest distance outside the bounds that counts as rounding, as a share of the distance between them."""
FARTHEST = 1e6
"""Bounds of a file beyond it count as unbounded."""
SHARES = (0.0, 0.25, 0.5, 0.625, 1.0)
"""Actions on which wrappers are tried, as shares of the way from the lowest to the highest."""
ROUNDING = 1e-5
"""Largest difference that counts as rounding of a wrapper, as a share of the distance between the bounds."""
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
        return _text(np.array([self.low, self.high]))

    def excess(self, act: NDArray[Any]) -> Array:
        """Return (T, A): how far actions (T, A) of the file are outside, and 0 for rounding. A component of
        one value is not scaled: there, rounding is a share of that."""
        beyond = np.maximum(np.maximum(self.low - act, act - self.high), 0.0)
        width, size = self.high - self.low, np.maximum(abs(self.low), abs(self.high))
        slack = SLACK * np.where(width > 0, width, size)
        if act.dtype.kind == "f":
            slack += 2 * _spacing(size, act.dtype)
        return np.where(beyond > slack, beyond, 0.0)

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
    native = _native_bounds(env, spec.act_size)
    if asked is not None:
        return _as_asked(asked, recording.bounds, native, spec.act_size)
    if recording.bounds is not None:
        return _as_recorded(recording.bounds, native, spec)
    if recording.form == OWN_FORM:
        return _units(SCALED, spec.act_size, "by this project's form")
    return _as_in_task(recording.arrays["act"], native, spec)


def first_choice(env: gym.Env[Any, Any]) -> int:
    """Return the number of the first choice beneath the wrappers of a discrete task. Raises BadInput where a
    wrapper hides it."""
    space = _space_beneath(env)
    if not isinstance(space, spaces.Discrete):
        raise BadInput("a wrapper of the task changes its choices, so their numbers are not known")
    return int(space.start)


def same(one: Bounds, other: Bounds) -> bool:
    """Return whether two bounds are the same, but for rounding to 32 bits."""
    return bool(_near(one, other).all())


def _as_asked(asked: Bounds, recorded: Bounds | None, native: Bounds | None, size: int) -> Units:
    pairs = asked.shape[1]
    if pairs not in (1, size):
        raise ValueError(f"{OPTION} is given {pairs} times, and its actions have {size} components")
    if pairs < size and native is not None and not same(asked, SCALED) and np.ptp(native, axis=1).any():
        raise ValueError(
            f"its {size} components have other bounds each, in the task {_text(native)}; give {OPTION} for "
            "each, in this order"
        )
    if recorded is not None:
        _check_size(recorded, size)
        if not (_near(recorded, asked) | (np.abs(recorded) > FARTHEST)).all():
            raise ValueError(f"{OPTION} {_text(asked)} contradicts the file, which says {_text(recorded)}")
    return _units(asked, size, f"as {OPTION} says")


def _as_recorded(recorded: Bounds, native: Bounds | None, spec: EnvSpec) -> Units:
    _check_size(recorded, spec.act_size)
    if not np.abs(recorded).max() <= FARTHEST:
        raise ValueError(f"it does not tell the bounds of its actions; give them as {OPTION}")
    known = [bounds for bounds in (SCALED, native, _public_bounds(spec)) if bounds is not None]
    if not any(same(recorded, bounds) for bounds in known):
        names = " or ".join(dict.fromkeys(map(_text, known)))
        raise ValueError(
            f"its actions are in {_text(recorded)}, and the task's in {names}; to scale them by their "
            f"bounds, give these as {OPTION}"
        )
    return _units(recorded, spec.act_size, "as the file says")


def _as_in_task(act: NDArray[Any], native: Bounds | None, spec: EnvSpec) -> Units:
    if native is None:
        raise ValueError(
            f"a wrapper of the task changes its actions, so their bounds in the file are not known; give "
            f"them as {OPTION}, or {OPTION}=scaled for [-1, 1]"
        )
    public = _public_bounds(spec)
    if public is not None and np.abs(act).max(initial=0) <= 1 + SLACK:
        low, high = public.ravel()
        raise ValueError(
            f"its actions may be in {_text(public)}, as in the public environment, or in [-1, 1], as in "
            f"this task; give {OPTION}={low:g},{high:g} or {OPTION}=scaled"
        )
    return _units(native if public is None else public, spec.act_size, "the task's own")


def _public_bounds(spec: EnvSpec) -> Bounds | None:
    return None if spec.public_bounds is None else np.array(spec.public_bounds)[:, None]


def _native_bounds(env: gym.Env[Any, Any], size: int) -> Bounds | None:
    """Return the bounds of actions in the task's own environment; None where a wrapper hides them."""
    space = _space_beneath(env)
    if not isinstance(space, spaces.Box) or space.shape != (size,):
        return None
    return np.array([space.low, space.high], np.float64)


def _space_beneath(env: gym.Env[Any, Any]) -> spaces.Space[Any] | None:
    """Return the space of actions beneath all wrappers; None where they do more than scale or number anew."""
    outer = env.action_space
    actions = _samples(outer)
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.ActionWrapper):
            actions = [env.action(action) for action in actions]
        elif env.action_space != env.env.action_space:
            return None
        env = env.env
    inner = env.action_space
    if outer != inner and outer.shape != inner.shape:
        return None
    wanted = np.array(_samples(inner), np.float64)
    size = np.abs(wanted).max(axis=0, initial=0)
    rounding = ROUNDING * np.ptp(wanted, axis=0) + 8 * _spacing(size) if len(wanted) else 0
    evenly = len(actions) == len(wanted) and (np.abs(np.array(actions) - wanted) <= rounding).all()
    return inner if evenly else None


def _samples(space: spaces.Space[Any]) -> list[Any]:
    """Return actions at equal shares of a space; none where it is unbounded, or neither choices nor
    numbers."""
    if isinstance(space, spaces.Discrete):
        return [np.int64(space.start + i) for i in range(int(space.n))]
    if not (isinstance(space, spaces.Box) and space.is_bounded()):
        return []
    low, high = space.low.astype(float), space.high.astype(float)
    return [(low + share * (high - low)).astype(space.dtype) for share in SHARES]


def _units(bounds: Bounds, size: int, why: str) -> Units:
    low, high = np.broadcast_to(bounds, (2, size))
    return Units(low, high, why)


def _check_size(bounds: Bounds, size: int) -> None:
    if bounds.shape[1] not in (1, size):
        raise ValueError("its bounds are of other actions than the task's")


def _near(one: Bounds, other: Bounds) -> NDArray[np.bool_]:
    """Return (2, A): whether low and high bounds are the same, but for rounding to 32 bits."""
    width = np.minimum(one[1] - one[0], other[1] - other[0])
    with np.errstate(invalid="ignore"):  # infinite ones are never the same
        return np.asarray(np.abs(one - other) <= SLACK * width + _spacing(np.minimum(abs(one), abs(other))))


def _spacing(size: NDArray[Any], kind: Any = np.float32) -> Array:
    """Return the distance between neighbouring numbers of that size and type."""
    with np.errstate(all="ignore"):  # for sizes beyond the type
        return np.asarray(np.spacing(size.astype(kind)), np.float64)


def _text(bounds: Bounds) -> str:
    pairs = [f"[{low:g}, {high:g}]" for low, high in bounds.T]
    return pairs[0] if len(set(pairs)) == 1 else " x ".join(pairs)
