"""The one table of reinforcement learning's hyper-parameters."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Of DDPG or DQN: the same for the expert, inner loops and pi_R in one environment."""

    net: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    final_learning_rate: float = 1e-3
    """Reached linearly at the end of each solve."""
    tau: float = 0.02
    batch: int = 128
    critics: int = 1
    """Of several, the smallest value counts (Fujimoto et al. 2018, TD3)."""
    n_steps: int = 3
    noise: float = 0.3
    """Scale of DDPG's Ornstein-Uhlenbeck exploration noise, of actions in [-1, 1]; DQN's share of random
    actions."""
    copies: int = 10
    """Environments that an agent acts in side by side."""
    gradient_steps: int = 10
    """Gradient steps after each step of all copies."""
    checkpoint_every: int = 500
    """Steps between checkpoints; a multiple of `copies`."""
    check_episodes: int = 20
    """Episodes that a checkpoint is judged by, at most."""


SETTINGS: dict[str, Settings] = {
    # Its episodes are long, and begin alike.
    "pendulum": Settings(checkpoint_every=2000, check_episodes=5),
    "highway": Settings(
        final_learning_rate=5e-5,
        tau=0.005,
        batch=256,
        critics=2,
        noise=0.15,
        copies=40,
        gradient_steps=20,
        checkpoint_every=4000,
        check_episodes=40,
    ),
}
"""By environment; the defaults elsewhere."""


def rl_settings_for(env: str) -> Settings:
    """What RL uses in an environment."""
    return SETTINGS.get(env, Settings())
