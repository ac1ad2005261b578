"""A task: `EnvSpec`, its `Batch` of copies, and how its experts are trained, `Shipped`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.flat import flat
from envs.learners import DDPG, DQN, PPO, SAC, TD3, Learner
from envs.models import Tabular
from envs.scaled import is_real, scaled, time_limit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Floats = NDArray[np.float32]
BUDGETS = ("smoke", "quick", "full")


class Quantity(NamedTuple):
    """The name and unit of an entry of an observation or an action."""

    name: str
    unit: str = ""
    """Unit, e.g. 'm', or '20 m' where an entry of 1 is 20 m; '' for a mere number."""

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Shape:
    """One line strip of a drawing. `points`: (P, 2) in metres, x to the right and y up. A closed outline
    repeats its first point. `colour`: red, green, blue, each 0 to 255."""

    points: Array
    colour: tuple[int, int, int]


def _budgets(smoke: int, quick: int, full: int) -> dict[str, int]:
    """Return numbers for each of `BUDGETS`."""
    return dict(zip(BUDGETS, (smoke, quick, full), strict=True))


class Batch(Protocol):
    """Copies of an environment that step together, numbered from 0, each reset first. They have no time
    limits."""

    def reset(self, place: int, seed: int) -> Array:
        """Return the first observation of the copy's next episode, (O,)."""

    def step(
        self, places: Sequence[int], act: Array
    ) -> tuple[Array, Array, Flags] | tuple[Array, Array, Flags, Flags]:
        """Step the copies by actions (B, A). Return observations (B, O), rewards (B,), flags of termination
        (B,) and, where the task itself truncates episodes, flags of truncation (B,)."""

    def why_ended(self, place: int) -> str:
        """Return why the copy's episode just terminated."""


class Shipped(NamedTuple):
    """The training of shipped experts, and the bar that they must reach."""

    steps: int
    """Environment steps of RL."""
    bar: float
    """Smallest mean undiscounted true return."""
    terminated: float | None = None
    """Largest share of episodes that terminate early, None for any."""
    checkpoint_every: int | None = None
    """Steps between checkpoints, where RL's usual number yields none with about half the return."""
    experts: int = 5
    """Number of experts."""
    episodes: int = 1000
    """Episodes that measure the return."""
    rl: Learner | None = None
    """Learner that trains them, None for the task's own."""


@dataclass(frozen=True)
class EnvSpec:
    """One task: the environment, and all that the benchmark must know about it.

    The environment terminates as its authors meant it to, and truncates at `horizon` at the latest.
    Observations are made vectors, and whole actions choices. Actions are in [-1, 1]^A or, in a discrete one,
    choices from 0 to A-1. Everywhere
    else choices are (B, A) too, and the largest entry acts. Raises ValueError where a field contradicts
    another or the environment.
    """

    name: str
    """Name for `--envs`."""
    env_id: str
    """Gymnasium id, registered when the spec's module is imported."""
    obs_size: int
    act_size: int
    obs_scale: tuple[float, ...]
    """Typical size of each observation while the task goes well. RL divides by it."""
    horizon: int
    """Steps after which an episode is truncated, unless the task itself truncates it before."""
    obs_names: tuple[Quantity, ...] | None = None
    """Names of observations, None for 'obs 0', 'obs 1', ...; read them as `observations`."""
    act_names: tuple[Quantity, ...] | None = None
    """Names of entries of an action, None for 'act 0', 'act 1', ...; read them as `actions`."""
    public_bounds: tuple[float, float] | None = None
    """Lowest and highest action of the public environment behind the task, None for -1 and 1."""
    summary: str = ""
    """One line for `list`."""
    gamma: float = 0.99
    """Discount in (0, 1) of returns and RL solves."""
    time_step: float = 1.0
    """Seconds between actions."""
    bar: Callable[[Sequence[int]], float] = lambda seeds: -math.inf
    """Mean undiscounted true return that the expert must reach on the episodes of these seeds."""
    max_terminated: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(BUDGETS, 1.0))
    """Largest share of the expert's episodes that may terminate early, for each of `BUDGETS`."""
    rl_steps: Mapping[str, int] = field(default_factory=lambda: _budgets(600, 20_000, 60_000))
    """Environment steps of one RL solve, for each of `BUDGETS`."""
    solves: Mapping[str, int] = field(default_factory=lambda: _budgets(1, 2, 5))
    """Independent solves of a learned reward, for each of `BUDGETS`. The best one counts."""
    eval_episodes: Mapping[str, int] = field(default_factory=lambda: _budgets(5, 50, 100))
    """Evaluation episodes for each policy, for each of `BUDGETS`."""
    demo_episodes: Mapping[str, int] = field(default_factory=lambda: _budgets(5, 100, 100))
    """Demonstration episodes drawn for each seed, for each of `BUDGETS`."""
    phi: Callable[[Array, Array], Array] | None = None
    """Features for linear rewards: observations (B, O) and actions (B, A) to (B, K), in [-1, 1]. Default: the
    actions, and observations in units of `obs_scale`, squashed, and their squares."""
    draw: Callable[[gym.Env], dict[str, Shape]] = lambda env: {}
    """The present scene in metres, with the same names throughout an episode."""
    why_ended: Callable[[gym.Env], str] = lambda env: "terminated"
    """Reason that the episode just terminated, in a few words, e.g. 'pole fell'."""
    wrap: Callable[[gym.Env], gym.Env] = lambda env: env
    """Wrapper of Gymnasium's environment."""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Arguments of the environment and its batch for the same task under other dynamics, by name."""
    rl: Learner = field(default_factory=DDPG)
    """Learner for reinforcement learning."""
    ddpg: DDPG = field(default_factory=DDPG)
    """Learner for runs with `--learner ddpg`, the thesis's."""
    ddpg_steps: Mapping[str, int] = field(default_factory=lambda: _budgets(600, 20_000, 60_000))
    """Environment steps of one solve by DDPG, for each of `BUDGETS`."""
    batch: Callable[..., Batch] | None = None
    """Function of a number of copies, and of a variant's arguments, that returns a batch which steps faster
    than single environments, to the same bits."""
    discrete: bool = False
    """True if an action is a choice among A."""
    shipped: Shipped | None = None
    """Training of the shipped experts, None where an exact solution is the expert."""
    controller: Callable[[Array], Array] | None = None
    """Expert that is not trained: a frozen dataclass, from observations (B, O) to actions (B, A)."""
    encoder: str = ""
    """Encoder of images (`envs.encoders`) in a task that is seen in images, '' in others."""
    expert_task: EnvSpec | None = None
    """Task as its expert sees it, None where the expert sees what methods see. Equal seeds and actions give
    equal episodes."""
    tabular: Tabular | None = None
    """Model and true reward of a finite environment, which is solved instead of learned."""

    def __post_init__(self) -> None:
        if not 0 < self.gamma < 1:
            raise ValueError(f"{self.name}: gamma must lie in (0, 1), not {self.gamma}")
        if len(self.obs_scale) != self.obs_size or not all(0 < size < math.inf for size in self.obs_scale):
            raise ValueError(
                f"{self.name}: obs_scale must hold a positive, finite number for each observation"
            )
        for kind, names, size in (
            ("obs", self.observations, self.obs_size),
            ("act", self.actions, self.act_size),
        ):
            if not len({quantity.name for quantity in names}) == len(names) == size:
                raise ValueError(f"{self.name}: {kind}_names must hold a name of its own for each of {size}")
        if self.tabular and self.variants:
            raise ValueError(f"{self.name}: a variant has another model than the known one")
        if not isinstance(self.rl, (DQN, PPO) if self.discrete else (DDPG, TD3, SAC, PPO)):
            raise ValueError(f"{self.name}: choices need DQN or PPO, and DQN is for choices alone")
        tables = (self.rl_steps, self.ddpg_steps, self.solves, self.eval_episodes, self.demo_episodes)
        counts = [self.obs_size, self.act_size, self.horizon, *(t[b] for t in tables for b in BUDGETS)]
        if min(counts) < 1:
            raise ValueError(f"{self.name}: sizes, horizon, steps, solves and episodes must be positive")

    @property
    def observations(self) -> tuple[Quantity, ...]:
        """The name and unit of each observation."""
        return self.obs_names or tuple(Quantity(f"obs {i}") for i in range(self.obs_size))

    @property
    def actions(self) -> tuple[Quantity, ...]:
        """The name and unit of each entry of an action."""
        return self.act_names or tuple(Quantity(f"act {i}") for i in range(self.act_size))

    def make(self) -> gym.Env:
        """Return a new instance. Raises ValueError where it contradicts the spec."""
        env = self.wrap(gym.make(self.env_id, **self.kwargs))
        try:
            env, act = flat(env), env.action_space
            if not (is_real(act) or (isinstance(act, spaces.Discrete) and act.start == 0)):
                env = scaled(env)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error
        obs, act = env.observation_space, env.action_space
        actions = (
            isinstance(act, spaces.Discrete) and act.n == self.act_size
            if self.discrete
            else act == spaces.Box(-1.0, 1.0, (self.act_size,), np.float32)
        )
        if obs.shape != (self.obs_size,) or not actions:
            raise ValueError(f"{self.name}: spaces {obs}, {act} contradict the spec's sizes or bounds")
        if time_limit(env) != self.horizon:
            raise ValueError(
                f"{self.name}: the environment is not truncated at the spec's {self.horizon} steps"
            )
        return env

    def variant(self, name: str) -> EnvSpec:
        """Return one of `variants` as a task without experts. Raises ValueError for an unknown name."""
        if name not in self.variants:
            known = ", ".join(self.variants) or "none"
            raise ValueError(f"{self.name}: no variant {name!r}; there are: {known}")
        changed, twin = self.variants[name], self.expert_task
        return replace(
            self,
            name=f"{self.name}.{name}",
            kwargs={**self.kwargs, **changed},
            batch=partial(self.batch, **changed) if self.batch else None,
            expert_task=twin.variant(name) if twin and name in twin.variants else twin,
            bar=lambda seeds: -math.inf,
            max_terminated=dict.fromkeys(BUDGETS, 1.0),
            variants={},
            shipped=None,
        )

    @property
    def expert_sees(self) -> EnvSpec:
        """The task as its expert sees it."""
        return self.expert_task or self

    def encoded_by(self, encoder: str) -> EnvSpec:
        """Return the same task seen through another encoder. Raises ValueError where there are no images."""
        if not self.encoder:
            raise ValueError(f"{self.name}: it has no images to encode")
        if self.batch is None:
            wrap: Any = self.wrap
            return replace(self, encoder=encoder, wrap=partial(wrap, encoder=encoder))
        batch, kwargs = partial(self.batch, encoder=encoder), {**self.kwargs, "encoder": encoder}
        return replace(self, encoder=encoder, kwargs=kwargs, batch=batch)

    def by_ddpg(self) -> EnvSpec:
        """Return the same task with DDPG as its learner. Raises ValueError where actions are choices."""
        if self.discrete:
            raise ValueError(f"{self.name}: actions are choices, and DDPG is for real numbers")
        return replace(self, rl=self.ddpg, rl_steps=self.ddpg_steps)

    def features(self, obs: Array, act: Array) -> Array:
        """Return `phi`, or its default, of observations (B, O) and actions (B, A), (B, K)."""
        if self.phi is not None:
            return self.phi(obs, act)
        squashed = np.tanh(obs / np.array(self.obs_scale))
        return np.concatenate([squashed, squashed**2, act], axis=1)

    def executed(self, act: Array) -> Array:
        """Return a policy's actions (B, A) as they are executed, (B, A). A choice is 1 for the largest entry,
        the first of ties, and 0 for others. Raises ValueError for wrong shapes and numbers."""
        if act.ndim != 2 or act.shape[1] != self.act_size:
            raise ValueError(f"actions must have the shape (B, {self.act_size}), not {act.shape}")
        if not (np.isfinite(act).all() if self.discrete else (np.abs(act) <= 1).all()):
            raise ValueError("actions must be finite and, unless they are choices, lie in [-1, 1]")
        return np.eye(self.act_size)[act.argmax(axis=1)] if self.discrete else act

    def native(self, act: Array) -> Any:
        """Return one action (A,) in the form of the environment's `step`."""
        return np.int64(act.argmax()) if self.discrete else act.astype(np.float32)

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        """Return uniform actions, (count, A)."""
        return self.executed(rng.uniform(-1, 1, (count, self.act_size)))


def register(spec: EnvSpec, entry_point: str, **kwargs: Any) -> None:
    """Register a task's environment, 'module:class', and its arguments with Gymnasium."""
    gym.register(
        spec.env_id, entry_point, max_episode_steps=spec.horizon, disable_env_checker=True, kwargs=kwargs
    )
