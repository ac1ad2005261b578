"""Checks of what a method returns, before anything is computed with it."""

from __future__ import annotations

import numbers

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from methods.base import Array, Episodes, Learned, Method, Reward, Unsuitable

ROWS = 5
"""Demonstrated pairs that it is tried on."""
LARGEST = 1e100
"""The largest number that a reward may give: sums and squares of such numbers are finite."""


def needs_actions(method: Method) -> bool:
    """Return whether a method needs the actions of demonstrations."""
    return bool(getattr(method, "needs_actions", True))


def check_suitable(method: Method, demos: Episodes) -> None:
    """Raise Unsuitable where a method needs the actions of demonstrations that have none."""
    if needs_actions(method) and not demos.has_actions:
        raise Unsuitable("it learns from actions, and the demonstrations have none")


def check_learned(learned: object, spec: EnvSpec, demos: Episodes, rows: int = ROWS) -> None:
    """Raise TypeError or ValueError unless it is a `Learned` that answers for demonstrated pairs.

    rows: the number of pairs that it is tried on.
    """
    if not isinstance(learned, Learned):
        raise TypeError(f"fit must return a Learned, not {type(learned).__name__}")
    for name, part in (("policy", learned.policy), ("reward", learned.reward)):
        if not callable(part) and (name, part) != ("reward", None):
            raise TypeError(f"the {name} of what fit returns cannot be called")
    obs, act = (values[:rows] for values in demos.pairs())
    chosen = spec.executed(_real("actions", learned.policy(obs.copy())))
    if len(chosen) != len(obs):
        raise ValueError(f"a policy gave {len(chosen)} actions for {len(obs)} observations")
    for name, curve in learned.curves.items():
        if not all(isinstance(value, numbers.Real) for value in curve):
            raise ValueError(f"the curve {name!r} must hold numbers")
    for name, value in learned.details.items():
        if not isinstance(value, numbers.Real):
            raise ValueError(f"the detail {name!r} must be a number, not {value!r:.40}")
    if learned.reward is not None:
        _check_reward(learned.reward, obs, act if demos.has_actions else chosen)


def _check_reward(reward: Reward, obs: Array, act: Array) -> None:
    absorbing: object = getattr(reward, "absorbing", None)
    if not isinstance(absorbing, numbers.Real):
        raise TypeError(
            "the reward of what fit returns lacks `absorbing`, what a step in the absorbing state pays "
            f"(docs/termination.md): `absorbing` must be a number, not {absorbing!r:.60}"
        )
    paid = _real("rewards", reward(obs.copy(), act.copy(), obs.copy()))
    if paid.shape != (len(obs),):
        raise ValueError(f"the reward must give one number a step, ({len(obs)},), not {paid.shape}")
    if not (np.abs([*paid, float(absorbing)]) <= LARGEST).all():
        raise ValueError(
            f"the reward must give one finite number for each step, and one for absorption, up to {LARGEST:g}"
        )


def _real(what: str, values: object) -> NDArray[np.float64]:
    """Return an array of real numbers. Raises TypeError for others."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{what} must be real numbers, not {array.dtype}")
    return array
