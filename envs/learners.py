"""What reinforcement learning uses in a task: the learner and its hyper-parameters, as plain data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OffPolicy:
    """Of every learner with a replay buffer: the same for the expert, inner loops and pi_R in one task."""

    net: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    final_learning_rate: float = 1e-3
    """Reached linearly at the end of each solve."""
    tau: float = 0.02
    batch: int = 128
    n_steps: int = 3
    noise: float = 0.3
    """How much it explores."""
    copies: int = 10
    """Environments that an agent acts in side by side."""
    gradient_steps: int = 10
    """Gradient steps after each step of all copies."""
    buffer: int = 100_000
    """Latest steps that it keeps."""
    checkpoint_every: int = 500
    """Steps between checkpoints; a multiple of `copies`."""
    check_episodes: int = 20
    """Episodes that a checkpoint is judged by, at most."""


@dataclass(frozen=True)
class DDPG(OffPolicy):
    """Lillicrap et al. 2015. noise: scale of its Ornstein-Uhlenbeck noise, of actions in [-1, 1]."""

    critics: int = 1
    """Of several, the smallest value counts (Fujimoto et al. 2018, TD3)."""


@dataclass(frozen=True)
class DQN(OffPolicy):
    """Mnih et al. 2013, where actions are choices. noise: share of random actions."""


Learner = DDPG | DQN
