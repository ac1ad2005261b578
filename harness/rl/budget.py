"""Steps and episodes that a solve takes by its learner's settings."""

from __future__ import annotations

from envs.learners import PPO, Learner

WARM_UP = 1000
"""Random steps before learning; half of a solve that is shorter than twice that."""
STEPS_PER_CHECK_EPISODE = 75
"""A short solve checks a checkpoint on one episode for each of this many steps."""
JUDGING_EPISODES = 20
"""Episodes on which the solves of one reward are compared."""


def warm_up(learner: Learner, steps: int) -> int:
    """Return the random steps before a new agent learns, of a solve's `steps`. PPO takes none."""
    return 0 if isinstance(learner, PPO) else min(WARM_UP, steps // 2) // learner.unit * learner.unit


def check_episodes(learner: Learner, steps: int) -> int:
    """Return the episodes that each checkpoint of a solve is scored by."""
    return max(1, min(learner.check_episodes, steps // STEPS_PER_CHECK_EPISODE))


def checkpoints(learner: Learner, steps: int) -> int:
    """Return the checkpoints of a new agent's solve, with the untrained and the last one."""
    every = learner.checkpoint_every
    return 2 + (steps - 1) // every - warm_up(learner, steps) // every
