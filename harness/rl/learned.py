"""Checks of what a method returns, before anything is computed with it."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from methods.base import Episodes, Learned

ROWS = 5
"""Demonstrated pairs that it is tried on."""
LARGEST = 1e100
"""The largest number that a reward may give: sums and squares of such numbers are finite."""


def check_learned(learned: object, spec: EnvSpec, demos: Episodes, rows: int = ROWS) -> None:
    """Raise TypeError or ValueError unless it is a `Learned` that answers for demonstrated pairs.

    rows: the number of pairs that it is tried on.
    """
    if not isinstance(learned, Learned):
        raise TypeError(f"fit must return a Learned, not {type(learned).__name__}")
    obs, act = (values[:rows] for values in demos.pairs())
    if not callable(learned.policy):
        raise TypeError("the policy of what fit returns cannot be called")
    chosen = spec.executed(_real("actions", learned.policy(obs.copy())))
    if len(chosen) != len(obs):
        raise ValueError(f"a policy gave {len(chosen)} actions for {len(obs)} observations")
    for name, curve in learned.curves.items():
        if not all(isinstance(value, numbers.Real) for value in curve):
            raise ValueError(f"the curve {name!r} must hold numbers")
    if learned.reward is not None:
        _check_reward(learned.reward, obs, act)


def _check_reward(reward: Any, obs: NDArray[np.float64], act: NDArray[np.float64]) -> None:
    if not callable(reward):
        raise TypeError("the reward of what fit returns cannot be called")
    if not hasattr(reward, "absorbing"):
        raise TypeError(
            "the reward of what fit returns lacks `absorbing`, what a step in the absorbing state pays "
            "(docs/termination.md)"
        )
    if not isinstance(reward.absorbing, numbers.Real):
        raise TypeError(f"the reward's `absorbing` must be a number, not {reward.absorbing!r:.60}")
    paid = _real("rewards", reward(obs.copy(), act.copy(), obs.copy()))
    if paid.shape != (len(obs),):
        raise ValueError(f"the reward must give one number a step, ({len(obs)},), not {paid.shape}")
    if not (np.abs([*paid, float(reward.absorbing)]) <= LARGEST).all():
        raise ValueError(
            f"the reward must give one finite number for each step, and one for absorption, up to {LARGEST:g}"
        )


def _real(what: str, values: object) -> NDArray[np.float64]:
    """Return an array of real numbers. Raises TypeError for others."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{what} must be real numbers, not {array.dtype}")
    return array
