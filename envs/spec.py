"""What an environment of this benchmark is: `EnvSpec`; `Tabular`, the whole of one whose model is known;
`Quantity`, what a number is of; and `Shape`, the unit of drawings."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from gymnasium.wrappers.utils import rescale_box
from numpy.typing import NDArray

from envs.learners import DDPG, DQN, PPO, SAC, TD3, Learner

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Array = NDArray[np.float64]

BUDGETS = ("smoke", "quick", "full")
RANDOM_STEPS = 1000
"""Steps of random actions by which a typical size of observations is told."""
LARGEST = 1e100
"""The largest reward that counts as finite: sums of these are."""
INSTANCES = 3
"""Instances of a task of others that are made to see whether they agree."""
UNEVEN = 0.01  # how far rounding may lead an action astray in its own precision, as a share of the bounds
ROUNDING = 1e-9  # how far from 1 probabilities may sum


class Quantity(NamedTuple):
    """What an entry of an observation or an action is."""

    name: str
    unit: str = ""
    """What 1 of it is, e.g. 'm' or '20 m'; '' for a mere number."""

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Shape:
    """One line strip of a drawing.

    points: (P, 2) in metres, x to the right and y up; a closed outline repeats its first point.
    colour: red, green, blue, each 0 to 255.
    """

    points: Array
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class Model:
    """The dynamics of a Markov decision process without terminal states, which a method may know. Its arrays
    are read-only. Raises ValueError where shapes disagree, a distribution is none, observations repeat or
    an environment, which gives them as 32-bit floats, could not give them exactly.
    """

    P: Array
    """(S, A, S): probability of each next state, given state and action."""
    start: Array
    """(S,): distribution of the first state."""
    obs: Array
    """(S, O): what is observed in each state, a row of its own."""

    def __post_init__(self) -> None:
        states = len(self.start)
        if self.P.ndim != 3 or self.P.shape[::2] != (states, states) or self.P.size == 0:
            raise ValueError(f"tabular: P must be (S, A, S) with S = {states}, not {self.P.shape}")
        for name, rows in (("P", self.P), ("start", self.start)):
            if not (rows.min() >= 0 and np.abs(rows.sum(axis=-1) - 1).max() <= ROUNDING):
                raise ValueError(f"tabular: {name} must hold probabilities that sum to 1")
        if self.obs.ndim != 2 or len(self.obs) != states or self.obs.size == 0:
            raise ValueError(f"tabular: obs must be (S, O) with S = {states}, not {self.obs.shape}")
        if len(np.unique(self.obs, axis=0)) < states or not np.array_equal(
            self.obs, self.obs.astype(np.float32)
        ):
            raise ValueError("tabular: obs must be different in each state, and 32-bit floats")
        for array in (self.P, self.start, self.obs):
            array.flags.writeable = False

    def states(self, obs: Array) -> NDArray[np.int64]:
        """(B,): the state whose observation is nearest to each of (B, O)."""
        return np.asarray(self._tree.query(obs)[1], np.int64)

    @cached_property
    def _tree(self) -> KDTree:
        from scipy.spatial import KDTree  # half a second, which the command line does without

        return KDTree(self.obs)


@dataclass(frozen=True)
class Tabular(Model):
    """A model with its true reward, and features for linear ones."""

    reward: Array
    """(S,): paid when an action is taken in the state."""
    features: Array
    """(S, K), within [-1, 1]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        states = len(self.start)
        if self.reward.shape != (states,) or not np.isfinite(self.reward).all():
            raise ValueError(f"tabular: reward must be finite and (S,) with S = {states}")
        if self.features.ndim != 2 or len(self.features) != states or self.features.size == 0:
            raise ValueError(f"tabular: features must be (S, K) with S = {states}, not {self.features.shape}")
        if not np.abs(self.features).max() <= 1:
            raise ValueError("tabular: features must lie in [-1, 1]")
        for array in (self.reward, self.features):
            array.flags.writeable = False

    @property
    def model(self) -> Model:
        """It without its reward."""
        return Model(self.P, self.start, self.obs)


def _budgets(smoke: int, quick: int, full: int) -> dict[str, int]:
    return dict(zip(BUDGETS, (smoke, quick, full), strict=True))


class Batch(Protocol):
    """Copies of an environment that step together, numbered from 0. Each is reset before it is stepped; time
    limits are not theirs to keep."""

    def reset(self, place: int, seed: int) -> Array:
        """(O,): the first observation of the copy's next episode."""

    def step(
        self, places: Sequence[int], act: Array
    ) -> tuple[Array, Array, NDArray[np.bool_]] | tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Steps the copies by actions (B, A): observations (B, O), rewards (B,), whether each terminated and,
        where the task itself truncates episodes, whether it truncated each."""

    def why_ended(self, place: int) -> str:
        """Why the copy's episode just terminated."""


class Shipped(NamedTuple):
    """How experts that are shipped are trained, and what they must reach."""

    steps: int
    """Environment steps of RL."""
    bar: float
    """Mean undiscounted true return, at least."""
    terminated: float | None = None
    """Share of episodes that terminate early, at most; None is any."""
    checkpoint_every: int | None = None
    """Steps between checkpoints, where with RL's usual number none has about half the return."""
    experts: int = 5
    """How many."""
    episodes: int = 1000
    """That a bar is measured by."""
    rl: Learner | None = None
    """What trains them, where that is more than RL is given elsewhere in the task."""


@dataclass(frozen=True)
class EnvSpec:
    """One task: the environment itself and everything about it that a benchmark must know.

    The environment has flat float observations, terminates as its authors meant it to, and truncates at
    `horizon` at the latest. Its actions are in [-1, 1]^A or, in a discrete one, 0 to A-1; everywhere else
    these are (B, A) too, one entry for each, of which the largest acts. Raises ValueError where a field
    contradicts another or the environment.
    """

    name: str
    """What `--envs` calls it."""
    env_id: str
    """Gymnasium id, registered when the spec's module is imported."""
    obs_size: int
    act_size: int
    obs_scale: tuple[float, ...]
    """A typical size of each observation while the task goes well; RL divides by it."""
    horizon: int
    """Steps after which an episode is truncated, unless the task itself truncates it before."""
    obs_names: tuple[Quantity, ...] = ()
    """What each observation is, by a name of its own; default: 'obs 0', 'obs 1', ..."""
    act_names: tuple[Quantity, ...] = ()
    """What each entry of an action is, in the same way; default: 'act 0', 'act 1', ..."""
    public_bounds: tuple[float, float] | None = None
    """Lowest and highest action of the public environment that the task is, where they are not -1 and 1."""
    summary: str = ""
    """One line for `list`."""
    gamma: float = 0.99
    """Discount in (0, 1) for discounted returns and for every RL solve."""
    time_step: float = 1.0
    """Seconds between actions."""
    bar: Callable[[Sequence[int]], float] = lambda seeds: -math.inf
    """Mean undiscounted true return that the expert must reach on the episodes of these seeds."""
    max_terminated: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(BUDGETS, 1.0))
    """Largest share of the expert's episodes that may terminate early, for each of `BUDGETS`."""
    rl_steps: Mapping[str, int] = field(default_factory=lambda: _budgets(600, 20_000, 60_000))
    """Environment steps of one RL solve, for each of `BUDGETS`."""
    eval_episodes: Mapping[str, int] = field(default_factory=lambda: _budgets(5, 50, 100))
    """Evaluation episodes for each policy, for each of `BUDGETS`."""
    demo_episodes: Mapping[str, int] = field(default_factory=lambda: _budgets(5, 100, 100))
    """Demonstration episodes drawn for each seed, for each of `BUDGETS`."""
    phi: Callable[[Array, Array], Array] | None = None
    """Features for linear rewards: (B, O) observations and (B, A) actions to (B, K), within [-1, 1].
    Default: the actions, and observations in units of `obs_scale`, squashed, and their squares."""
    draw: Callable[[gym.Env], dict[str, Shape]] = lambda env: {}
    """The scene as it stands, in metres; the same names throughout an episode."""
    why_ended: Callable[[gym.Env], str] = lambda env: "terminated"
    """Why the episode just terminated, in a few words, e.g. 'pole fell'."""
    wrap: Callable[[gym.Env], gym.Env] = lambda env: env
    """What Gymnasium's environment is wrapped in."""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    """What the environment is made with."""
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """The same task under other dynamics, by name: what the environment and its batch are made with."""
    rl: Learner = field(default_factory=DDPG)
    """What reinforcement learning uses."""
    ddpg: DDPG = field(default_factory=DDPG)
    """What it uses where DDPG is asked for, the thesis's learner."""
    ddpg_steps: Mapping[str, int] = field(default_factory=lambda: _budgets(600, 20_000, 60_000))
    """Environment steps of one solve by that, for each of `BUDGETS`."""
    batch: Callable[..., Batch] | None = None
    """So many copies, where they step faster together and bit for bit as they would alone. Those of a variant
    are given what it names, too."""
    discrete: bool = False
    """Whether an action is a choice among A."""
    shipped: Shipped | None = None
    """How the experts that are shipped are trained; None where an exact solution is the expert."""
    tabular: Tabular | None = None
    """What is known exactly where the environment is finite: it is solved instead of learned."""

    def __post_init__(self) -> None:
        if not 0 < self.gamma < 1:
            raise ValueError(f"{self.name}: gamma must lie in (0, 1), not {self.gamma}")
        if len(self.obs_scale) != self.obs_size or not all(0 < size < math.inf for size in self.obs_scale):
            raise ValueError(
                f"{self.name}: obs_scale must hold a positive, finite number for each observation"
            )
        for kind, given, size in (
            ("obs", self.obs_names, self.obs_size),
            ("act", self.act_names, self.act_size),
        ):
            names = given or tuple(Quantity(f"{kind} {i}") for i in range(size))
            if not len({quantity.name for quantity in names}) == len(names) == size:
                raise ValueError(f"{self.name}: {kind}_names must hold a name of its own for each of {size}")
            object.__setattr__(self, f"{kind}_names", names)
        if self.tabular and self.variants:
            raise ValueError(f"{self.name}: a variant has another model than the one that is known")
        if not isinstance(self.rl, (DQN, PPO) if self.discrete else (DDPG, TD3, SAC, PPO)):
            raise ValueError(f"{self.name}: choices need DQN or PPO, and DQN is for choices alone")
        tables = (self.rl_steps, self.ddpg_steps, self.eval_episodes, self.demo_episodes)
        counts = [self.obs_size, self.act_size, self.horizon, *(t[b] for t in tables for b in BUDGETS)]
        if min(counts) < 1:
            raise ValueError(f"{self.name}: sizes, horizon, steps and episodes must be positive")

    def make(self) -> gym.Env:
        """A new instance, checked against the sizes above."""
        env = self.wrap(gym.make(self.env_id, **self.kwargs))
        if isinstance(env.action_space, spaces.Discrete) and env.action_space.start != 0:
            env = scaled(env)
        obs, act = env.observation_space, env.action_space
        if isinstance(act, spaces.Box) and act.dtype.kind != "f":
            raise ValueError(f"{self.name}: actions must be choices or real numbers, not whole ones, {act}")
        actions = (
            isinstance(act, spaces.Discrete) and act.n == self.act_size
            if self.discrete
            else act == spaces.Box(-1.0, 1.0, (self.act_size,), np.float32)
        )
        if obs.shape != (self.obs_size,) or not actions:
            raise ValueError(f"{self.name}: spaces {obs}, {act} contradict the spec's sizes or bounds")
        if _limit(env) != self.horizon:
            raise ValueError(
                f"{self.name}: the environment is not truncated at the spec's {self.horizon} steps"
            )
        return env

    def variant(self, name: str) -> EnvSpec:
        """One of `variants` as a task of its own, whose experts nothing is known of. Raises ValueError for an
        unknown name."""
        if name not in self.variants:
            known = ", ".join(self.variants) or "none"
            raise ValueError(f"{self.name}: no variant {name!r}; there are: {known}")
        changed = self.variants[name]
        return replace(
            self,
            name=f"{self.name}.{name}",
            kwargs={**self.kwargs, **changed},
            batch=partial(self.batch, **changed) if self.batch else None,
            bar=lambda seeds: -math.inf,
            max_terminated=dict.fromkeys(BUDGETS, 1.0),
            variants={},
            shipped=None,
        )

    def by_ddpg(self) -> EnvSpec:
        """Return the same task, whose reinforcement learning is DDPG. Raises ValueError where actions are
        choices, which DDPG has none of."""
        if self.discrete:
            raise ValueError(f"{self.name}: actions are choices, and DDPG is for real numbers")
        return replace(self, rl=self.ddpg, rl_steps=self.ddpg_steps)

    def features(self, obs: Array, act: Array) -> Array:
        """(B, K): `phi` of (B, O) observations and (B, A) actions."""
        if self.phi is not None:
            return self.phi(obs, act)
        squashed = np.tanh(obs / np.array(self.obs_scale))
        return np.concatenate([squashed, squashed**2, act], axis=1)

    def executed(self, act: Array) -> Array:
        """(B, A): what a policy's actions (B, A) amount to; in a discrete environment 1 for the largest
        entry, the first of equals, and 0 for the others. Raises ValueError for no such actions."""
        if act.ndim != 2 or act.shape[1] != self.act_size:
            raise ValueError(f"actions must have the shape (B, {self.act_size}), not {act.shape}")
        if not (np.isfinite(act).all() if self.discrete else (np.abs(act) <= 1).all()):
            raise ValueError("actions must be finite and, where they are no choices, lie in [-1, 1]")
        return np.eye(self.act_size)[act.argmax(axis=1)] if self.discrete else act

    def native(self, act: Array) -> Any:
        """One action (A,) as the environment's `step` takes it."""
        return np.int64(act.argmax()) if self.discrete else act.astype(np.float32)

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        """(count, A), uniform over all actions."""
        return self.executed(rng.uniform(-1, 1, (count, self.act_size)))


def from_gymnasium(env_id: str, name: str, **fields: Any) -> EnvSpec:
    """The spec of a Gymnasium environment, with what can be told from it: sizes, horizon, whether actions are
    choices, and typical observations, from random actions. Continuous actions are scaled to [-1, 1], and
    Gymnasium's own MuJoCo tasks get a batch. fields: of `EnvSpec`, what is known better.

    Raises ValueError unless observations are flat, actions are choices or bounded real numbers, and what it
    gives is finite. It also does where there is no time limit, or another in each instance.
    """
    from envs.mujoco_batch import MujocoBatch

    made_with = fields.get("kwargs", {})
    env, *others = (gym.make(env_id, **made_with) for _ in range(INSTANCES))
    obs, act, limit = env.observation_space, env.action_space, _limit(env)
    if not isinstance(obs, spaces.Box) or obs.shape is None or len(obs.shape) != 1:
        raise ValueError(f"{env_id}: observations must be a flat box, not {obs}")
    if limit is None:
        raise ValueError(f"{env_id}: it has no time limit")
    if other := [its for its in map(_limit, others) if its != limit]:
        raise ValueError(f"{env_id}: its time limit is {limit} in one instance and {other[0]} in another")
    if isinstance(act, spaces.Discrete):
        found: dict[str, Any] = {"act_size": int(act.n), "discrete": True, "rl": DQN()}
    elif isinstance(act, spaces.Box) and act.dtype.kind != "f":
        raise ValueError(f"{env_id}: actions must be choices or real numbers, not whole ones, {act}")
    elif isinstance(act, spaces.Box) and len(act.shape) == 1 and act.is_bounded():
        found = {"act_size": act.shape[0], "wrap": scaled}
        usual = {TimeLimit, OrderEnforcing, PassiveEnvChecker}  # of `gym.make`
        bare = "wrap" not in fields and {type(wrapper) for wrapper in _wrappers(env)} <= usual
        if bare and _is_gymnasiums_mujoco(env):
            ending = fields.get("why_ended", EnvSpec.why_ended)
            found["batch"] = partial(MujocoBatch, env_id, ending, **made_with)
        env = scaled(env)
    else:
        raise ValueError(f"{env_id}: actions must be choices or a bounded box, not {act}")
    found["obs_size"] = obs.shape[0]
    found["obs_scale"] = _typical(_random_observations(env, env_id))
    found["horizon"] = limit
    found["summary"] = f"Gymnasium's {env_id}"
    return EnvSpec(name, env_id, **(found | fields))


def _is_gymnasiums_mujoco(env: gym.Env[Any, Any]) -> bool:
    """Return whether Gymnasium's own code alone makes and steps a MuJoCo task: a class of others may change
    the model, or keep what a copy would share."""
    entry = env.spec.entry_point if env.spec else None
    module = entry if isinstance(entry, str) else entry.__module__ if isinstance(entry, type) else ""
    own = "gymnasium.envs.mujoco."
    return module.startswith(own) and type(env.unwrapped).__module__.startswith(own)


def _random_observations(env: gym.Env[Any, Any], env_id: str) -> NDArray[Any]:
    """Return observations (N, O) of random actions. Raises ValueError as `check_numbers` does."""
    env.action_space.seed(0)
    seen, length = list[NDArray[Any]](), 0

    def see(obs: Any, *given: object) -> bool:
        """Return whether the episode ended."""
        with named(env_id, [length]):
            reward, *ended = flags(*given)
            seen.append(np.array(real(obs)))  # a copy, for some environments write into the same array again
        rows = np.array(seen[-1:], np.float64)
        check_numbers(env_id, env.observation_space.shape[0], rows, np.array([reward]), [length])  # type: ignore[index]
        return any(ended)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium's, of what is refused here in one line
        see(env.reset(seed=0)[0], 0.0, False, False)
        for _ in range(RANDOM_STEPS):
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            length += 1
            if see(obs, reward, terminated, truncated):
                length = 0
                seen.pop()
                see(env.reset()[0], 0.0, False, False)
    return np.array(seen)


def _typical(obs: NDArray[Any]) -> tuple[float, ...]:
    """Return the root mean square of each column (N, O), its largest size where squares are beyond what its
    type holds, and 1 where all are 0."""
    obs = obs.astype(np.result_type(obs, np.float32), copy=False)
    with np.errstate(over="ignore", under="ignore"):
        roots = np.sqrt(np.square(obs).mean(axis=0))
    usual = (roots > 0) & (roots < np.inf)
    return tuple(float(x) or 1.0 for x in np.where(usual, roots, np.abs(obs).max(axis=0)))


class Misgiven(ValueError):
    """An error for what no task may give. row: number of the copy among those stepped."""

    def __init__(self, value: object, what: str, needed: str) -> None:
        super().__init__(f"it gives {value!r} as {what}, which must be {needed}")
        self.value, self.what, self.needed, self.row = value, what, needed, 0


@contextmanager
def named(task: str, steps: Sequence[int]) -> Iterator[None]:
    """Add the task and the step to what is raised of `Misgiven`. steps: how many each episode has taken."""
    try:
        yield
    except Misgiven as wrong:
        value = " ".join(repr(wrong.value).split())
        told = f"{task} gives {value:.80} as {wrong.what} of step {steps[wrong.row]}"
        raise ValueError(f"{told}, which must be {wrong.needed}") from wrong


def real(value: Any, what: str = "observation", kinds: str = "fiub") -> NDArray[Any]:
    """Return what a task gives, an array of real numbers or of other kinds. Raises `Misgiven` for others, and
    for masked ones."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        array = np.empty(0, object)
    if array.dtype.kind not in kinds or isinstance(value, np.ma.MaskedArray):
        raise Misgiven(value, what, "real numbers without a mask" if "f" in kinds else "true or false")
    return array


def number(reward: Any) -> float:
    """Return a reward that is a number, or an array of one. Raises `Misgiven` for others."""
    if type(reward) is float:
        return reward
    array = real(reward, "reward")
    if array.size != 1:
        raise Misgiven(reward, "reward", "one number")
    return float(array.item())


def flags(reward: Any, terminated: Any, truncated: Any) -> tuple[float, bool, bool]:
    """Return what a step gives besides an observation. Raises `Misgiven` unless these are a number, and true
    or false, or arrays of one such entry."""
    return number(reward), _flag(terminated, "terminated"), _flag(truncated, "truncated")


def _flag(value: Any, what: str) -> bool:
    if type(value) is bool:
        return value
    array = real(value, what, "b")
    if array.size != 1:
        raise Misgiven(value, what, "true or false")
    return bool(array.item())


def check_numbers(task: str, size: int, obs: Array, rewards: Array, steps: Sequence[int]) -> None:
    """Raise ValueError unless observations are (B, size), rewards are (B,), and all are finite. steps: how
    many each episode has taken."""
    if obs.shape[1:] != (size,):
        raise ValueError(f"{task} gives an observation of the shape {obs.shape[1:]}, not ({size},)")
    if rewards.shape != obs.shape[:1]:
        raise ValueError(f"{task} gives rewards of the shape {rewards.shape} for {len(obs)} steps")
    if not np.isfinite(obs).all():
        row, entry = np.argwhere(~np.isfinite(obs))[0]
        raise ValueError(f"{task} gives {obs[row, entry]} as observation {entry} after step {steps[row]}")
    if not (np.abs(rewards) <= LARGEST).all():
        (row,) = np.argwhere(~(np.abs(rewards) <= LARGEST))[0]
        raise ValueError(f"{task} gives {rewards[row]} as reward of step {steps[row]}")


class Scaled(gym.ActionWrapper[Any, Any, Any], RecordConstructorArgs):
    """An environment with actions in [-1, 1], in 32 bits, or choices from 0 on. An action whose two bounds
    are the same has that value, whatever is done."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ActionWrapper.__init__(self, env)
        space = env.action_space
        if isinstance(space, spaces.Discrete):
            first = int(space.start)
            self._native: Callable[[Any], Any] = lambda choice: np.int64(choice + first)
            self.action_space = spaces.Discrete(int(space.n))
            return
        assert isinstance(space, spaces.Box)
        wide, free = np.promote_types(space.dtype, np.float32), space.low < space.high
        low, high = np.where(free, space.low, 0).astype(wide), np.where(free, space.high, 1).astype(wide)
        ends = low.astype(np.float64), high.astype(np.float64)

        def precise(act: Any) -> NDArray[Any]:
            share = (np.asarray(act, np.float64) + 1) / 2
            return np.asarray((1 - share) * ends[0] + share * ends[1])

        with np.errstate(all="ignore"):  # of bounds whose distance 32 bits cannot hold
            _, _, rescaled = rescale_box(
                spaces.Box(low, high, dtype=wide.type), np.float32(-1), np.float32(1)
            )
            points = np.stack([np.full(low.shape, end, np.float32) for end in (-1, 0, 1)])
            width = ends[1] / 2 - ends[0] / 2
            near = np.abs(rescaled(points).astype(np.float64) - precise(points)) <= UNEVEN * width
            even = near.all(axis=0)

        def native(act: Any) -> Any:
            if even.all():
                found = rescaled(act).astype(space.dtype)
            else:
                with np.errstate(all="ignore"):
                    found = np.where(even, rescaled(act), precise(act)).astype(space.dtype)
            # Rounding must not lead out of the bounds, which some environments check.
            return np.clip(found, space.low, space.high)

        self._native = native
        self.action_space = spaces.Box(-1.0, 1.0, space.shape, np.float32)

    def action(self, action: Any) -> Any:
        return self._native(action)


def scaled(env: gym.Env[Any, Any]) -> Scaled:
    """With actions in [-1, 1], in 32 bits, or choices from 0 on."""
    return Scaled(env)


def _limit(env: gym.Env[Any, Any]) -> int | None:
    """Return the steps after which the environment's wrappers truncate an episode, None where none does."""
    limits = [its._max_episode_steps for its in _wrappers(env) if isinstance(its, TimeLimit)]
    return min(limits, default=None)


def _wrappers(env: gym.Env[Any, Any]) -> Iterator[gym.Wrapper[Any, Any, Any, Any]]:
    """From the outermost on."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
