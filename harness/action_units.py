"""The units of actions in files of demonstrations: which of them are -1 and 1 here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs import EnvSpec
from harness.demonstration_forms import Bounds, Raw
from harness.registry import BadInput
from methods.base import Array

SLACK = 1e-6
"""Largest distance outside the bounds that counts as rounding, as a share of the distance between them."""
FARTHEST = 1e6
"""Bounds of a file beyond it are none."""
POINTS = (-1.0, -0.5, 0.0, 0.25, 1.0)
"""Actions on which a wrapper is tried."""
ROUNDING = 1e-5
"""Largest difference that counts as rounding of a wrapper, as a share of the distance between the bounds."""
SCALED = (-1.0, 1.0)
OPTION = "--action-bounds"


@dataclass(frozen=True)
class Units:
    """The lowest and highest action of a file, (A,) each, and who says so. first: the number of the first
    choice in a discrete task, whose bounds are not used."""

    low: Array
    high: Array
    why: str
    first: int = 0

    def __str__(self) -> str:
        return _text((self.low, self.high))

    def excess(self, act: NDArray[Any]) -> Array:
        """Return (T, A): how far actions (T, A) of the file are outside, and 0 for rounding. A
        component of one value is not scaled: there, rounding is a share of that."""
        beyond = np.maximum(np.maximum(self.low - act, act - self.high), 0.0)
        width, size = self.high - self.low, np.maximum(abs(self.low), abs(self.high))
        slack = SLACK * np.where(width > 0, width, size)
        if act.dtype.kind == "f":
            slack += 2 * _spacing(size, act.dtype)
        return np.where(beyond > slack, beyond, 0.0)

    def scaled(self, act: Array) -> Array:
        """Return actions (T, A) of the file in [-1, 1]; 0 where both bounds are the same."""
        if (self.low == -1).all() and (self.high == 1).all():  # or rounding would change some
            return np.clip(act, -1, 1)
        width = self.high - self.low
        free = width > 0
        found = np.where(free, 2 * (act - self.low) / np.where(free, width, 1.0) - 1, 0.0)
        return np.clip(found, -1, 1)

    def native(self, act: Array) -> Array:
        """Return actions (T, A) in [-1, 1] as the file has them."""
        return self.low + (act + 1) / 2 * (self.high - self.low)


def units(raw: Raw, spec: EnvSpec, asked: Bounds | None) -> Units:
    """Return the units of a file's actions, as the user says, or the file, or else the task's own.

    Raises ValueError where these contradict each other, or where there may be two and nobody says which.
    """
    if spec.discrete:
        if asked is not None:
            raise ValueError(f"its actions are choices, which have no {OPTION}")
        first = first_choice(spec)
        if raw.first not in (None, first):
            raise ValueError(f"its choices are numbered from {raw.first} on, and the task's from {first} on")
        none = np.zeros(spec.act_size)
        return Units(none, none, "the task's own", first)
    if raw.first is not None:
        raise ValueError("its actions are choices, and the task's are numbers")
    own = _native(spec)
    public = spec.public_bounds
    if asked is not None:
        return _as_asked(asked, raw.bounds, own, spec.act_size)
    if raw.bounds is not None:
        _check_size(raw.bounds, spec.act_size)
        if not max(np.abs(end).max() for end in raw.bounds) <= FARTHEST:
            raise ValueError(f"it does not tell the bounds of its actions; give them as {OPTION}")
        known = [bounds for bounds in (SCALED, own, public) if bounds is not None]
        if not any(_same(raw.bounds, bounds) for bounds in known):
            theirs = " or ".join(dict.fromkeys(map(_text, known)))
            raise ValueError(
                f"its actions are in {_text(raw.bounds)}, and the task's in {theirs}; to scale them by their "
                f"bounds, give these as {OPTION}"
            )
        return _units(raw.bounds, spec.act_size, "as the file says")
    if raw.own:
        return _units(SCALED, spec.act_size, "by this project's form")
    if own is None:
        raise ValueError(
            f"a wrapper of the task changes its actions, so their bounds in the file are not known; give "
            f"them as {OPTION}, or {OPTION}=scaled for [-1, 1]"
        )
    if public is not None:
        if max(np.abs(rows).max(initial=0) for rows in raw.act) <= 1 + SLACK:
            raise ValueError(
                f"its actions may be in {_text(public)}, as in the public environment, or in [-1, 1], as in "
                f"this task; give {OPTION}={public[0]:g},{public[1]:g} or {OPTION}=scaled"
            )
        own = public
    return _units(own, spec.act_size, "the task's own")


def first_choice(spec: EnvSpec) -> int:
    """Return the number of a discrete task's first choice in its own environment. Raises BadInput where a
    wrapper hides it."""
    space = _beneath(spec)
    if not isinstance(space, spaces.Discrete):
        raise BadInput(f"a wrapper of {spec.name} changes its choices, so their numbers are not known")
    return int(space.start)


def _as_asked(asked: Bounds, said: Bounds | None, own: Bounds | None, size: int) -> Units:
    pairs = np.size(asked[0])
    if pairs not in (1, size):
        raise ValueError(f"{OPTION} is given {pairs} times, and its actions have {size} components")
    if pairs < size and own is not None and not _same(asked, SCALED):
        low, high = _whole(own, size)
        if np.ptp(low) or np.ptp(high):
            raise ValueError(
                f"its {size} components have other bounds each, in the task {_text(own)}; give {OPTION} for "
                "each, in this order"
            )
    if said is not None:
        _check_size(said, size)
        for its, near in zip(_whole(said, size), _near(said, asked), strict=True):
            if not (near | (np.abs(its) > FARTHEST)).all():
                raise ValueError(f"{OPTION} {_text(asked)} contradicts the file, which says {_text(said)}")
    return _units(asked, size, f"as {OPTION} says")


def _native(spec: EnvSpec) -> Bounds | None:
    """Return the bounds of actions in the task's own environment; None where a wrapper hides them."""
    space = _beneath(spec)
    if not isinstance(space, spaces.Box) or space.shape != (spec.act_size,):
        return None
    return space.low.astype(np.float64), space.high.astype(np.float64)


def _beneath(spec: EnvSpec) -> spaces.Space[Any] | None:
    """Return the space of actions beneath all wrappers that scale or number actions anew; None where one does
    something else."""
    env: gym.Env[Any, Any] = spec.make()
    while isinstance(env, gym.Wrapper):
        if env.action_space != env.env.action_space and not _only_scales(env):
            return None
        env = env.env
    return env.action_space


def _only_scales(wrapper: gym.Wrapper[Any, Any, Any, Any]) -> bool:
    """Return whether a wrapper maps its actions evenly onto those beneath, the lowest onto the lowest."""
    outer, inner = wrapper.action_space, wrapper.env.action_space
    if not isinstance(wrapper, gym.ActionWrapper):
        return False
    if isinstance(outer, spaces.Discrete) and isinstance(inner, spaces.Discrete):
        choices = range(int(outer.n))
        shift = inner.start - outer.start
        return outer.n == inner.n and all(
            wrapper.action(np.int64(outer.start + i)) == outer.start + i + shift for i in choices
        )
    if not (isinstance(outer, spaces.Box) and isinstance(inner, spaces.Box) and outer.shape == inner.shape):
        return False
    if not (outer.is_bounded() and inner.is_bounded()):
        return False
    for point in POINTS:
        share = (point + 1) / 2
        act, wanted = (box.low + share * (box.high.astype(float) - box.low) for box in (outer, inner))
        done = wrapper.action(act.astype(outer.dtype))
        width, size = inner.high.astype(float) - inner.low, np.maximum(abs(inner.low), abs(inner.high))
        if not (np.abs(done - wanted) <= ROUNDING * width + 8 * _spacing(size)).all():
            return False
    return True


def _units(bounds: Bounds, size: int, why: str) -> Units:
    low, high = _whole(bounds, size)
    return Units(low, high, why)


def _whole(bounds: Bounds, size: int) -> Sequence[Array]:
    return [np.broadcast_to(np.asarray(end, np.float64), size) for end in bounds]


def _check_size(bounds: Bounds, size: int) -> None:
    if any(np.size(end) not in (1, size) for end in bounds):
        raise ValueError("its bounds are of other actions than the task's")


def _same(one: Bounds, other: Bounds) -> bool:
    return all(near.all() for near in _near(one, other))


def _near(one: Bounds, other: Bounds) -> list[NDArray[np.bool_]]:
    """Return whether the low bounds and the high ones are the same, but for rounding to 32 bits."""
    width = np.minimum(*(np.subtract(high, low, dtype=np.float64) for low, high in (one, other)))
    pairs = [(np.asarray(a, np.float64), np.asarray(b, np.float64)) for a, b in zip(one, other, strict=True)]
    with np.errstate(invalid="ignore"):  # infinite ones are the same as none
        return [abs(a - b) <= SLACK * width + _spacing(np.minimum(abs(a), abs(b))) for a, b in pairs]


def _spacing(size: NDArray[Any], kind: Any = np.float32) -> Array:
    """Return the distance between neighbouring numbers of that size and type."""
    with np.errstate(all="ignore"):  # of sizes beyond the type
        return np.asarray(np.spacing(size.astype(kind)), np.float64)


def _text(bounds: Bounds) -> str:
    low, high = np.atleast_1d(bounds[0]), np.atleast_1d(bounds[1])
    pairs = [f"[{a:g}, {b:g}]" for a, b in zip(low, high, strict=True)]
    return pairs[0] if len(set(pairs)) == 1 else " x ".join(pairs)
