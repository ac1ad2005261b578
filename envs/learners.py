"""Learners of reinforcement learning and their hyper-parameters, as plain data."""

from dataclasses import dataclass, fields, replace


@dataclass(frozen=True)
class Common:
    """Hyper-parameters of every learner: the same for the expert, inner loops and pi_R in one task."""

    net: tuple[int, ...] = (64, 64)
    """Units of each hidden layer, of actor and critics alike."""
    learning_rate: float = 1e-3
    """Learning rate of Adam, above 0, of actor and critics alike."""
    final_learning_rate: float = 1e-3
    """Learning rate at the end of each solve, reached linearly."""
    batch: int = 128
    """Steps in each gradient."""
    noise: float = 0.3
    """Size of exploration, and of the noise that ranks equal checkpoints."""
    copies: int = 10
    """Environments that an agent acts in side by side."""
    checkpoint_every: int = 500
    """Steps between checkpoints; a multiple of `unit`."""
    check_episodes: int = 20
    """Episodes that a checkpoint is scored by, at most."""

    @property
    def unit(self) -> int:
        """Unit of steps: solves take a multiple of it, at least two."""
        return self.copies


@dataclass(frozen=True)
class OffPolicy(Common):
    """Hyper-parameters of every learner with a replay buffer."""

    tau: float = 0.02
    """Share in (0, 1] by which target networks move towards the networks in each gradient step."""
    n_steps: int = 3
    """Rewards summed before the critic's value, at least 1."""
    gradient_steps: int = 10
    """Gradient steps after each step of all copies."""
    buffer: int = 100_000
    """Latest steps in the replay buffer."""


@dataclass(frozen=True)
class DDPG(OffPolicy):
    """DDPG (Lillicrap et al. 2015). `noise`: scale of its Ornstein-Uhlenbeck noise on actions in [-1, 1],
    which drifts over hundreds of steps."""

    critics: int = 1
    """Critics. The smallest value counts (Fujimoto et al. 2018, TD3)."""


@dataclass(frozen=True)
class TD3(OffPolicy):
    """TD3 (Fujimoto et al. 2018). `noise`: standard deviation of its white noise on actions in [-1, 1]."""

    critics: int = 2
    """Critics, at least 1. The smallest value counts."""
    policy_delay: int = 2
    """Gradient steps of the critics, at least 1, for each of the actor."""
    target_noise: float = 0.2
    """Standard deviation of the noise on actions in [-1, 1] of the target critics."""
    target_noise_clip: float = 0.5
    """The largest such noise, above 0."""


@dataclass(frozen=True)
class SAC(OffPolicy):
    """Soft actor-critic (Haarnoja et al. 2018), which explores by its own policy. `noise`: standard deviation
    of the noise on actions in [-1, 1] that ranks equal checkpoints."""

    critics: int = 2
    """Critics, at least 1. The smallest value counts."""
    entropy: float | None = None
    """Reward of a nat of an action's entropy, above 0, where rewards have a mean size of 0.1. None to learn
    it such that the entropy is -A nats on average."""


@dataclass(frozen=True)
class DQN(OffPolicy):
    """DQN (Mnih et al. 2013), for choices. `noise`: share of random actions."""


@dataclass(frozen=True)
class PPO(Common):
    """PPO (Schulman et al. 2017), which learns from its latest steps alone, and explores by its own policy.

    `noise`: smallest standard deviation of actions in [-1, 1] at the start of a solve, and the noise that
    ranks equal checkpoints.
    """

    learning_rate: float = 3e-4
    final_learning_rate: float = 3e-4
    batch: int = 500
    copies: int = 50
    checkpoint_every: int = 25_000
    std: float = 1.0
    """First standard deviation of actions in [-1, 1]."""
    steps: int = 50
    """Steps of each copy between bouts of learning."""
    epochs: int = 10
    """Passes through those steps in each bout, at least 1."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation (Schulman et al. 2016), in [0, 1]."""

    @property
    def unit(self) -> int:
        return self.copies * self.steps


SMALL_PPO = PPO(
    copies=32, steps=64, batch=256, learning_rate=1e-3, final_learning_rate=0.0, checkpoint_every=8192
)
"""PPO for tasks that take some ten thousand steps."""
FEW_JOINTS = replace(SMALL_PPO, std=0.5, check_episodes=5)  # PPO for MuJoCo's bodies of few joints

Learner = DDPG | TD3 | SAC | DQN | PPO


def soft(learner: Learner, discrete: bool) -> SAC | DQN:
    """Return soft actor-critic, or DQN for choices, with the settings that it shares with the learner."""
    if isinstance(learner, SAC | DQN):
        return learner
    if discrete:
        return DQN(net=learner.net)
    if isinstance(learner, PPO):
        return SAC(net=learner.net, n_steps=1, checkpoint_every=5000, check_episodes=learner.check_episodes)
    return SAC(**{shared.name: getattr(learner, shared.name) for shared in fields(OffPolicy)})
