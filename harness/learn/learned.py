"""Checks of what a method returns, before anything is computed with it."""

from __future__ import annotations

import numpy as np

from envs import EnvSpec
from methods.base import Episodes, Learned

ROWS = 5
"""Demonstrated pairs that policy and reward are tried on."""


def check_learned(learned: object, spec: EnvSpec, demos: Episodes) -> None:
    """Raise TypeError or ValueError, naming the fault, unless it is a `Learned` whose policy and reward
    answer for demonstrated pairs."""
    if not isinstance(learned, Learned):
        raise TypeError(f"fit must return a Learned, not {type(learned).__name__}")
    obs, act = (values[:ROWS] for values in demos.pairs())
    if not callable(learned.policy):
        raise TypeError("the policy of what fit returns cannot be called")
    chosen = spec.executed(np.asarray(learned.policy(obs.copy())))
    if len(chosen) != len(obs):
        raise ValueError(f"a policy gave {len(chosen)} actions for {len(obs)} observations")
    reward = learned.reward
    if reward is None:
        return
    if not callable(reward):
        raise TypeError("the reward of what fit returns cannot be called")
    if not hasattr(reward, "absorbing"):
        raise TypeError(
            "the reward of what fit returns lacks `absorbing`, what a step in the absorbing state pays "
            "(docs/termination.md)"
        )
    paid = np.asarray(reward(obs.copy(), act.copy(), obs.copy()))
    if paid.shape != (len(obs),) or not np.isfinite([*paid, float(reward.absorbing)]).all():
        raise ValueError("the reward must give one finite number for each step, and one for absorption")
