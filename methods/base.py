"""The one interface between methods and the benchmark: what a method is given and what it returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from envs.spec import Model

Array = NDArray[np.float64]
ABSORBING_STEPS = 5
"""Steps that an agent stays in the absorbing state before its episode is cut."""
RandomActions = Callable[[int, np.random.Generator], Array]
"""(count, A), uniform over all actions."""


class Unsuitable(ValueError):
    """What a method raises where it is not made for the task, or for what it is shown. Its cell is skipped
    then, and says why."""


class Policy(Protocol):
    """A deterministic policy: observations (B, O) to actions (B, A) within [-1, 1]; where an action is a
    choice among A, the largest entry acts."""

    def __call__(self, obs: Array, /) -> Array: ...


class StochasticPolicy(Protocol):
    """A policy that draws its actions, within [-1, 1]^A, by a density; or, where actions are choices, by
    probabilities."""

    def sample(self, obs: Array, rng: np.random.Generator) -> Array:
        """(B, A): an action for each observation (B, O)."""

    def log_prob(self, obs: Array, act: Array) -> Array:
        """(B,): logarithm of the density, or probability, of actions (B, A) at observations (B, O)."""

    @property
    def mean(self) -> Policy:
        """What it does without chance."""


@runtime_checkable
class Reward(Protocol):
    """A learned reward: (B, O) observations, (B, A) actions, (B, O) next observations to (B,) rewards.

    `absorbing` is what one step in the absorbing state pays, where episodes go when they terminate.
    Only differences from it count (docs/termination.md).
    """

    @property
    def absorbing(self) -> float: ...

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array: ...


@dataclass(frozen=True)
class Transitions:
    """N steps. obs, next_obs (N, O); act (N, A); absorbing, next_absorbing (N,): whether each was taken in
    the absorbing state, and whether it led there. In the absorbing state observations mean nothing.
    demonstrated (N,): whether each is of demonstrations; by default none is."""

    obs: Array
    act: Array
    next_obs: Array
    absorbing: NDArray[np.bool_]
    next_absorbing: NDArray[np.bool_]
    demonstrated: NDArray[np.bool_] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.demonstrated is None:
            object.__setattr__(self, "demonstrated", np.zeros(len(self), bool))

    def __len__(self) -> int:
        return len(self.act)

    def last(self, count: int) -> Transitions:
        """The last so many, or all where there are fewer."""
        return Transitions(*(column[-count:] for column in vars(self).values()))

    def absorbed(self) -> Transitions:
        """Return the steps, each that ends an episode followed by `ABSORBING_STEPS` in the absorbing state.
        None of those given may be there."""
        rows = np.repeat(np.arange(len(self)), 1 + ABSORBING_STEPS * self.next_absorbing)
        obs, act, next_obs, _, ended, demonstrated = (column[rows] for column in vars(self).values())
        return Transitions(obs, act, next_obs, np.diff(rows, prepend=-1) == 0, ended, demonstrated)

    @classmethod
    def of(cls, episodes: Episodes) -> Transitions:
        """Return every step of whole episodes, without any in the absorbing state."""
        obs, act = episodes.pairs()
        ended = np.zeros(len(act), bool)
        ended[episodes.lengths.cumsum() - 1] = episodes.terminated
        return cls(
            obs, act, np.concatenate([seen[1:] for seen in episodes.obs]), np.zeros(len(act), bool), ended
        )


Payment = Callable[[Transitions], Array]
"""What an agent is paid for each step, (N,), those in the absorbing state and into it included, own and
demonstrated ones: for methods that need to say more than a `Reward` can."""


@dataclass(frozen=True)
class Episodes:
    """Episodes without rewards: demonstrations, or rollouts in a `World`. Its arrays are read-only.

    obs: for each episode (T+1, O), the last row being where it ended.
    act: for each episode (T, A), in [-1, 1]; 1 for a choice and 0 for the others where actions are choices.
    terminated: for each episode whether it terminated (and was not cut at the horizon).
    times: where only some steps are shown, for each episode the N numbers of those, from 0, ascending; obs is
    then (N, O) and act (N, A). None where all are.
    steps: for each episode T; by default those that are shown.
    Raises ValueError for anything else: no episode, no step, wrong shapes, NaN, actions out of range.
    """

    obs: tuple[Array, ...]
    act: tuple[Array, ...]
    terminated: tuple[bool, ...]
    times: tuple[NDArray[np.int64], ...] | None = None
    steps: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not len(self.obs) == len(self.act) == len(self.terminated) > 0:
            raise ValueError("episodes: obs, act and terminated must list the same episodes, at least one")
        if not self.steps:
            object.__setattr__(self, "steps", tuple(map(len, self.act)))
        last, rows = (1, "T+1") if self.whole else (0, "N")
        for i, (obs, act) in enumerate(zip(self.obs, self.act, strict=True)):
            if obs.ndim != 2 or act.ndim != 2 or len(obs) != len(act) + last or len(act) == 0:
                raise ValueError(f"episode {i}: needs obs ({rows}, O) and act, has {obs.shape}, {act.shape}")
            times = np.arange(len(act)) if self.times is None else self.times[i]
            within = times.shape == (len(act),) and times[0] >= 0 and times[-1] < self.steps[i]
            if not (within and (np.diff(times) > 0).all()):
                raise ValueError(f"episode {i}: its times must ascend within its {self.steps[i]} steps")
            if obs.shape[1] != self.obs[0].shape[1] or act.shape[1] != self.act[0].shape[1]:
                raise ValueError(f"episode {i}: its sizes differ from those of episode 0")
            if not (np.isfinite(obs).all() and np.isfinite(act).all()):
                raise ValueError(f"episode {i}: obs and act must be finite")
            if np.abs(act).max() > 1:
                raise ValueError(f"episode {i}: actions must lie in [-1, 1]")
            obs.flags.writeable = act.flags.writeable = False

    def __len__(self) -> int:
        return len(self.act)

    @property
    def whole(self) -> bool:
        """Whether every step is shown."""
        return self.times is None

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Steps of each episode, shown or not."""
        return np.array(self.steps)

    def pairs(self) -> tuple[Array, Array]:
        """Every (observation, action) that is shown, in one batch: (N, O) and (N, A)."""
        obs = [obs[: len(act)] for obs, act in zip(self.obs, self.act, strict=True)]
        return np.concatenate(obs), np.concatenate(self.act)

    def transitions(self) -> tuple[Array, Array, Array]:
        """Every step that is shown with what was observed after it: (N, O), (N, A) and (N, O)."""
        obs, act, after = [], [], []
        for i, (seen, done) in enumerate(zip(self.obs, self.act, strict=True)):
            times = np.arange(len(seen)) if self.times is None else self.times[i]
            followed = np.flatnonzero(np.diff(times) == 1)
            obs.append(seen[followed])
            act.append(done[followed])
            after.append(seen[followed + 1])
        return np.concatenate(obs), np.concatenate(act), np.concatenate(after)

    def every(self, count: int, rng: np.random.Generator) -> Episodes:
        """Every `count`-th step of each episode, from one of the first, which chance decides; of a shorter
        episode one step."""
        starts = [int(rng.integers(min(count, steps))) for steps in self.steps]
        times = tuple(np.arange(start, T, count) for start, T in zip(starts, self.steps, strict=True))
        obs, act = (
            tuple(rows[at].copy() for rows, at in zip(column, times, strict=True))
            for column in (self.obs, self.act)
        )
        return Episodes(obs, act, self.terminated, times, self.steps)


Kind = Literal["own", "stochastic", "soft"]
"""An agent that learns by the task's own learner; by that where its policy is by chance, and else as the
third; by soft actor-critic or, where actions are choices, by one for these."""


class Agent(Protocol):
    """Learns by reinforcement, and goes on from where it is under whatever reward comes next. Where the model
    is known it knows at once, without a step."""

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        """Learn for so many environment steps, at least 1, and for a few more where its learner takes steps
        in bouts. All that it remembers is paid by this reward alone."""

    def best(self, reward: Reward) -> Policy:
        """The checkpoint of what was learned last that does best under the reward."""

    @property
    def policy(self) -> Policy:
        """What it would do now."""

    @property
    def behaviour(self) -> StochasticPolicy:
        """What it explores with. Raises ValueError where nothing was learned yet, and where its policy is not
        by chance."""

    def replay(self) -> Transitions:
        """The latest steps that it has seen, the oldest first: all that it remembers. Raises ValueError where
        the model is known, and where nothing was learned yet."""


class World(Protocol):
    """The environment without its reward: all that a method may touch. It counts what it is asked for."""

    obs_size: int
    act_size: int
    horizon: int
    gamma: float
    solve_steps: int
    """Environment steps that a solve takes here from scratch, at the run's budget."""
    budget: str
    """The run's budget: 'smoke', 'quick' or 'full'."""
    discrete: bool
    """Whether actions are choices."""
    model: Model | None
    """The dynamics, where they are known."""

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        """(count, A), uniform over all actions."""

    def phi(self, obs: Array, act: Array) -> Array:
        """The environment's features for linear rewards, (B, K), within [-1, 1]."""

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        """Fresh episodes of the policy."""

    def ask(self, obs: Array) -> Array:
        """What the expert does, (B, A), at observations (B, O). Raises ValueError for methods that are not
        marked as asking it."""

    def agent(
        self,
        rng: np.random.Generator,
        *,
        kind: Kind = "own",
        init: Policy | StochasticPolicy | None = None,
        demonstrations: Episodes | None = None,
        entropy: float = 0.0,
    ) -> Agent:
        """One that has not learned yet.

        init: what it begins with, a `Network` of its actor's shape or, for soft actor-critic, a
        `SquashedGaussian` of it.
        demonstrations: half of what it learns from at each gradient step, paid as its own steps are.
        entropy: what a nat of its policy's entropy is worth, uniform actions having 0, where it learns from
        its latest steps alone (PPO). Soft actor-critic weighs entropy by itself, and others have none.
        Raises ValueError for another `init`, and for either of the first two where the model is known.
        """

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int) -> Policy:
        """What an agent of its own learns in `steps` environment steps under the reward, at its best."""


@dataclass(frozen=True)
class Learned:
    """What a method found: the apprentice policy pi*, the reward R* (None: it learns none), curves of its
    training by name, such as losses, one value an iteration, and numbers about the fit by name."""

    policy: Policy
    reward: Reward | None
    curves: Mapping[str, Sequence[float]] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return a line without arrays."""
        parts = [f"policy={type(self.policy).__name__}"]
        parts.append(f"reward={type(self.reward).__name__ if self.reward is not None else None}")
        curves = ", ".join(f"{name} ({len(values)} values)" for name, values in self.curves.items())
        details = ", ".join(f"{name} {value:g}" for name, value in self.details.items())
        parts += [f"{name}: {text}" for name, text in (("curves", curves), ("details", details)) if text]
        return f"Learned({'; '.join(parts)})"


class Method(Protocol):
    """A method: a frozen dataclass whose fields are its hyper-parameters."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Learn from the demonstrations alone, in a world without its reward."""


def roughened(
    policy: Policy, share: float, random_actions: RandomActions, rng: np.random.Generator
) -> Policy:
    """The policy with this share of its actions replaced by random ones."""

    def act(obs: Array) -> Array:
        replaced = rng.random((len(obs), 1)) < share
        return np.where(replaced, random_actions(len(obs), rng), policy(obs))

    return act


def seen_by_both(demos: Episodes, rollouts: Episodes, rng: np.random.Generator) -> Array:
    """(2N, O): what was observed in N steps of rollouts, and as much of demonstrations. By its spread inputs
    are standardised: where an expert hardly moves, its own would make outliers of all states but its own."""
    visited = rollouts.pairs()[0]
    return np.concatenate([rng.choice(demos.pairs()[0], len(visited)), visited])


def default_absorbing(
    reward: Reward, demos: Episodes, random_actions: RandomActions, rng: np.random.Generator
) -> float:
    """What absorption pays under a reward learned from expert pairs only: its mean over the demonstrated
    states with uniform actions; over the demonstrated pairs where the demonstrations themselves terminate.

    So an uninformed agent gains nothing from staying alive, nor from dying.
    """
    obs, act = demos.pairs()
    if not all(demos.terminated):
        act = random_actions(len(act), rng)
    return float(reward(obs, act, obs).mean())
