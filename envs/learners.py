"""What reinforcement learning uses in a task: the learner and its hyper-parameters, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace


@dataclass(frozen=True)
class Common:
    """Of every learner: the same for the expert, inner loops and pi_R in one task."""

    net: tuple[int, ...] = (64, 64)
    """Units of each hidden layer, of actor and critics alike."""
    learning_rate: float = 1e-3
    """Of Adam, above 0; of actor and critics alike."""
    final_learning_rate: float = 1e-3
    """Reached linearly at the end of each solve."""
    batch: int = 128
    """Steps that a gradient is the mean of."""
    noise: float = 0.3
    """How much it explores, and how much equal checkpoints are disturbed."""
    copies: int = 10
    """Environments that an agent acts in side by side."""
    checkpoint_every: int = 500
    """Steps between checkpoints; a multiple of `unit`."""
    check_episodes: int = 20
    """Episodes that a checkpoint is judged by, at most."""

    @property
    def unit(self) -> int:
        """Solves take a multiple of so many steps, and twice as many at least."""
        return self.copies


@dataclass(frozen=True)
class OffPolicy(Common):
    """Of every learner with a replay buffer."""

    tau: float = 0.02
    """Share, in (0, 1], by which target networks move towards their own with each gradient step."""
    n_steps: int = 3
    """Rewards summed before a critic is asked, at least 1."""
    gradient_steps: int = 10
    """Gradient steps after each step of all copies."""
    buffer: int = 100_000
    """Latest steps that it keeps."""


@dataclass(frozen=True)
class DDPG(OffPolicy):
    """Lillicrap et al. 2015. noise: scale of its Ornstein-Uhlenbeck noise, of actions in [-1, 1]; it
    drifts over hundreds of steps."""

    critics: int = 1
    """Of several, the smallest value counts (Fujimoto et al. 2018, TD3)."""


@dataclass(frozen=True)
class TD3(OffPolicy):
    """Fujimoto et al. 2018. noise: standard deviation of its white noise, of actions in [-1, 1]."""

    critics: int = 2
    """At least 1; the smallest value counts."""
    policy_delay: int = 2
    """Gradient steps of the critics, at least 1, for each of the actor."""
    target_noise: float = 0.2
    """Standard deviation of the noise on actions that target critics are asked about, in [-1, 1]."""
    target_noise_clip: float = 0.5
    """The largest such noise, above 0."""


@dataclass(frozen=True)
class SAC(OffPolicy):
    """Haarnoja et al. 2018. It explores by its own policy; noise: standard deviation, of actions in [-1, 1],
    by which equal checkpoints are disturbed."""

    critics: int = 2
    """At least 1; the smallest value counts."""
    entropy: float | None = None
    """What a nat of an action's entropy is worth, above 0, where rewards have a mean size of 0.1. None: it is
    learned, so that the entropy is -A nats on average."""


@dataclass(frozen=True)
class DQN(OffPolicy):
    """Mnih et al. 2013, where actions are choices. noise: share of random actions."""


@dataclass(frozen=True)
class PPO(Common):
    """Schulman et al. 2017: it learns from its latest steps alone, and takes many. It explores by its own
    policy; noise: the standard deviation, of actions in [-1, 1], that each solve begins with at least, and by
    which equal checkpoints are disturbed."""

    learning_rate: float = 3e-4
    final_learning_rate: float = 3e-4
    batch: int = 500
    copies: int = 50
    checkpoint_every: int = 25_000
    std: float = 1.0
    """First standard deviation, of actions in [-1, 1]."""
    steps: int = 50
    """Of each copy, between bouts of learning."""
    epochs: int = 10
    """How often each bout goes through those steps, at least 1."""
    gae_lambda: float = 0.95
    """Of generalised advantage estimation (Schulman et al. 2016), in [0, 1]."""

    @property
    def unit(self) -> int:
        return self.copies * self.steps


SMALL_PPO = PPO(
    copies=32,
    steps=64,
    batch=256,
    epochs=10,
    learning_rate=1e-3,
    final_learning_rate=0.0,
    checkpoint_every=8192,
)
"""PPO where some ten thousand steps are enough."""
FEW_JOINTS = replace(SMALL_PPO, std=0.5, check_episodes=5)
"""The same for MuJoCo's bodies of few joints."""

Learner = DDPG | TD3 | SAC | DQN | PPO


def soft(learner: Learner, discrete: bool) -> SAC | DQN:
    """Return soft actor-critic for a task whose learner is another, with what it shares with that; where
    actions are choices, DQN."""
    if isinstance(learner, SAC | DQN):
        return learner
    if discrete:
        return DQN(net=learner.net)
    if isinstance(learner, PPO):
        return SAC(net=learner.net, n_steps=1, checkpoint_every=5000, check_episodes=learner.check_episodes)
    return SAC(**{shared.name: getattr(learner, shared.name) for shared in fields(OffPolicy)})
