"""The interface between methods and the benchmark: demonstrations and a `World` in, `Learned` out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from envs.models import Model

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rng = np.random.Generator
Phi = Callable[[Array, Array], Array]  # features (B, K) of observations (B, O) and actions (B, A)
ABSORBING_STEPS = 5  # steps that an agent stays in the absorbing state before its episode is truncated
RandomActions = Callable[[int, Rng], Array]
"""A function of a count that returns as many uniform actions, (count, A)."""


class Unsuitable(ValueError):
    """An error that a method raises for tasks or demonstrations that it cannot learn from. Its cell is then
    skipped, with the error's text as the reason."""


class Policy(Protocol):
    """A deterministic policy: observations (B, O) to actions (B, A) in [-1, 1]. Where an action is a choice
    among A, the largest entry acts."""

    def __call__(self, obs: Array, /) -> Array: ...


class StochasticPolicy(Protocol):
    """A policy that draws actions in [-1, 1]^A from a density, or choices from probabilities."""

    def sample(self, obs: Array, rng: Rng) -> Array:
        """Return an action for each observation (B, O), (B, A)."""

    def log_prob(self, obs: Array, act: Array) -> Array:
        """Return the log density, or log probability, of actions (B, A) at observations (B, O), (B,)."""

    @property
    def mean(self) -> Policy:
        """The deterministic policy at its centre."""


@runtime_checkable
class Reward(Protocol):
    """A learned reward: observations (B, O), actions (B, A) and next observations (B, O) to rewards (B,).

    `absorbing` is the reward of one step in the absorbing state, which terminated episodes enter. Only
    differences from it count (docs/termination.md).
    """

    @property
    def absorbing(self) -> float: ...

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array: ...


@dataclass(frozen=True)
class Transitions:
    """N steps: `obs` and `next_obs` (N, O), `act` (N, A), and three flags for each step, (N,).

    `absorbing`: it starts in the absorbing state, where observations mean nothing. `next_absorbing`: it ends
    there. `demonstrated`: it is part of a demonstration.
    """

    obs: Array
    act: Array
    next_obs: Array
    absorbing: Flags
    next_absorbing: Flags
    demonstrated: Flags

    def __len__(self) -> int:
        return len(self.act)

    def last(self, count: int) -> Transitions:
        """Return the last `count` steps, or all where there are fewer."""
        return Transitions(*(column[-count:] for column in vars(self).values()))

    def absorbed(self) -> Transitions:
        """Return living steps, with `ABSORBING_STEPS` in the absorbing state after each that terminates."""
        rows = np.repeat(np.arange(len(self)), 1 + ABSORBING_STEPS * self.next_absorbing)
        obs, act, next_obs, _, ended, demonstrated = (column[rows] for column in vars(self).values())
        return Transitions(obs, act, next_obs, np.diff(rows, prepend=-1) == 0, ended, demonstrated)

    @classmethod
    def own(
        cls, obs: Array, act: Array, next_obs: Array, absorbing: Flags, next_absorbing: Flags
    ) -> Transitions:
        """Return an agent's own steps, all not demonstrated."""
        return cls(obs, act, next_obs, absorbing, next_absorbing, np.zeros(len(act), bool))

    @classmethod
    def of(cls, episodes: Episodes) -> Transitions:
        """Return every step of whole episodes, without any in the absorbing state."""
        obs, act, after = episodes.transitions()
        ended = np.zeros(len(act), bool)
        ended[episodes.lengths.cumsum() - 1] = episodes.terminated
        return cls.own(obs, act, after, np.zeros(len(act), bool), ended)


Payment = Callable[[Transitions], Array]
"""A function of N steps that returns the reward of each, (N,). Unlike a `Reward` it sees steps in the
absorbing state and into it, and which ones are demonstrated."""


@dataclass(frozen=True)
class Episodes:
    """Episodes without rewards: demonstrations, or rollouts in a `World`. Arrays are read-only.

    `obs`: (T+1, O) for each episode, the last row being where it ended. `act`: (T, A) for each episode, in
    [-1, 1]; a choice is 1 and the others are 0; (T, 0) where actions are not known. `terminated`: the
    episodes that were not truncated. `times`: None if every step is shown. Otherwise the N times of the steps
    shown, from 0, ascending, for each episode; then `obs` is (N, O) and `act` (N, A). `steps`: T of each
    episode, None if every step is shown. `preferences`: (P, 2) numbers of two episodes, the better one last.
    Raises ValueError for no episode, no step, wrong shapes, NaN, and actions out of range.
    """

    obs: tuple[Array, ...]
    act: tuple[Array, ...]
    terminated: tuple[bool, ...]
    times: tuple[NDArray[np.int64], ...] | None = None
    steps: tuple[int, ...] | None = None
    preferences: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if not len(self.obs) == len(self.act) == len(self.terminated) > 0:
            raise ValueError("episodes: obs, act and terminated must list the same episodes, at least one")
        last, rows = (1, "T+1") if self.whole else (0, "N")
        for i, (obs, act, steps) in enumerate(zip(self.obs, self.act, self.lengths, strict=True)):
            if obs.ndim != 2 or act.ndim != 2 or len(obs) != len(act) + last or len(act) == 0:
                raise ValueError(f"episode {i}: needs obs ({rows}, O) and act, has {obs.shape}, {act.shape}")
            times = np.arange(len(act)) if self.times is None else self.times[i]
            within = times.shape == (len(act),) and times[0] >= 0 and times[-1] < steps
            if not (within and (np.diff(times) > 0).all()):
                raise ValueError(f"episode {i}: its times must ascend within its {steps} steps")
            if obs.shape[1] != self.obs[0].shape[1] or act.shape[1] != self.act[0].shape[1]:
                raise ValueError(f"episode {i}: its sizes differ from those of episode 0")
            if not (np.isfinite(obs).all() and np.isfinite(act).all()):
                raise ValueError(f"episode {i}: obs and act must be finite")
            if np.abs(act).max(initial=0) > 1:
                raise ValueError(f"episode {i}: actions must lie in [-1, 1]")
            obs.flags.writeable = act.flags.writeable = False

    def __len__(self) -> int:
        return len(self.act)

    @property
    def whole(self) -> bool:
        """True if every step is shown."""
        return self.times is None

    @property
    def has_actions(self) -> bool:
        """True if actions are known."""
        return self.act[0].shape[1:] != (0,)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Steps of each episode, shown or not."""
        return np.array([len(act) for act in self.act] if self.steps is None else self.steps)

    def pairs(self) -> tuple[Array, Array]:
        """Return every observation and action that is shown, (N, O) and (N, A)."""
        obs = [obs[: len(act)] for obs, act in zip(self.obs, self.act, strict=True)]
        return np.concatenate(obs), np.concatenate(self.act)

    def transitions(self) -> tuple[Array, Array, Array]:
        """Return steps with their next observations, where both are shown: (N, O), (N, A) and (N, O)."""
        steps = []
        for i, (obs, act) in enumerate(zip(self.obs, self.act, strict=True)):
            times = np.arange(len(obs)) if self.times is None else self.times[i]
            followed = np.flatnonzero(np.diff(times) == 1)
            steps.append((obs[followed], act[followed], obs[followed + 1]))
        before, actions, after = map(np.concatenate, zip(*steps, strict=True))
        return before, actions, after

    def every(self, count: int, rng: Rng) -> Episodes:
        """Return every `count`-th step of each episode, from a random one of its first `count`. A shorter
        episode keeps one step."""
        lengths = tuple(self.lengths.tolist())
        times = tuple(np.arange(int(rng.integers(min(count, T))), T, count) for T in lengths)
        obs, act = (
            tuple(rows[at].copy() for rows, at in zip(column, times, strict=True))
            for column in (self.obs, self.act)
        )
        return replace(self, obs=obs, act=act, times=times, steps=lengths)


Kind = Literal["own", "stochastic", "soft"]
"""The learner of an agent. `own` is the task's. `soft` is soft actor-critic, or DQN where actions are
choices. `stochastic` is the task's if that is PPO, whose policy is stochastic, else as `soft`."""


class Agent(Protocol):
    """A reinforcement learner, which continues from its present policy under each new reward. Where the model
    is known it solves for the policy, without a step."""

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        """Learn for `steps` environment steps, at least 1, rounded up to whole bouts of its learner. Its
        replay buffer is paid anew by this reward."""

    def best(self, reward: Reward) -> Policy:
        """Return the checkpoint of the last `learn` that scores best under the reward."""

    @property
    def policy(self) -> Policy:
        """The present policy, without exploration."""

    @property
    def behaviour(self) -> StochasticPolicy:
        """The exploring policy. Raises ValueError before `learn`, and for learners with a deterministic
        one."""

    def replay(self) -> Transitions:
        """Return its replay buffer, oldest first. Raises ValueError before `learn`, and in known models."""


class World(Protocol):
    """The environment without its reward: all that a method may touch. It counts steps and RL solves."""

    obs_size: int
    act_size: int
    horizon: int
    gamma: float
    solve_steps: int
    """Environment steps that a solve takes here from scratch, at the run's budget."""
    budget: str
    """The run's budget: 'smoke', 'quick' or 'full'."""
    discrete: bool
    """True if actions are choices."""
    model: Model | None
    """The dynamics, None where they are not known."""

    def random_actions(self, count: int, rng: Rng) -> Array:
        """Return uniform actions, (count, A)."""

    def phi(self, obs: Array, act: Array) -> Array:
        """Return the task's features for linear rewards, (B, K), in [-1, 1]."""

    def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
        """Return new episodes of the policy."""

    def log(self, values: Mapping[str, float]) -> None:
        """Add a point to each of these curves, such as of losses."""

    def ask(self, obs: Array) -> Array:
        """Return the expert's actions (B, A) at observations (B, O). Raises ValueError for methods that are
        not registered as asking the expert."""

    def agent(
        self,
        rng: Rng,
        *,
        kind: Kind = "own",
        init: Policy | StochasticPolicy | None = None,
        demonstrations: Episodes | None = None,
        entropy: float = 0.0,
    ) -> Agent:
        """Return an untrained agent.

        `init`: its first policy, a `Network` of its actor's shape or, for soft actor-critic, a
        `SquashedGaussian` of one. `demonstrations`: half of each batch, paid like its own steps. `entropy`:
        reward of a nat of its policy's entropy, relative to uniform actions, for PPO. Soft actor-critic tunes
        its own weight, and other learners have none. Raises ValueError for another `init`, and for `init` or
        `demonstrations` where the model is known.
        """

    def solve(self, reward: Reward, rng: Rng, steps: int) -> Policy:
        """Return the best checkpoint of a new agent that learns for `steps` environment steps."""


@dataclass(frozen=True)
class Learned:
    """A policy pi*, and a reward R*, None if the method learns none. By name: `curves` besides those logged,
    `details` (numbers about the fit), and `others` (rewards of methods that begin with the same fit)."""

    policy: Policy
    reward: Reward | None
    curves: Mapping[str, Sequence[float]] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    others: Mapping[str, Reward] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return a line without arrays."""
        reward = None if self.reward is None else type(self.reward).__name__
        shown = f"curves={[*self.curves]}, details={dict(self.details)}"
        return f"Learned(policy={type(self.policy).__name__}, reward={reward}, {shown})"


class Method(Protocol):
    """A frozen dataclass whose fields are hyper-parameters, `needs_actions = False` in one of states."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Learn from demonstrations in a world without its reward."""
