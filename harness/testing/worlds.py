"""Worlds that answer at once, one without dynamics and one whose model is known: for what methods compute
themselves. Where `harness.learn.world.TaskWorld` raises, they do."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.models import Model, Tabular
from methods.base import (
    Array,
    Episodes,
    Kind,
    Payment,
    Policy,
    Reward,
    StochasticPolicy,
    Transitions,
)
from methods.network import Network
from methods.stochastic import SquashedGaussian
from methods.tabular.model import greedy, value_iteration


class _Account:
    """An account of what a world is asked for, as `TaskWorld` keeps it. asked: whether the expert may be
    asked. unit: steps that a solve is a multiple of."""

    obs_size: int
    act_size: int
    discrete: bool
    model: Model | None
    solve_steps = 1000

    def __init__(self, asked: bool, unit: int) -> None:
        self.asked, self.unit = asked, unit
        self.env_steps = self.check_steps = self.rl_solves = self.answers = 0
        self.solves: list[tuple[Reward | Payment, int, bool]] = []
        """Reward, steps, and whether an agent went on from before."""
        self.given: list[dict[str, Any]] = []
        """The options of each agent, in their order."""

    def agent(self, rng: np.random.Generator, **given: Any) -> FakeAgent:
        self.given.append(given)
        return FakeAgent(self, rng, **given)

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int) -> Policy:
        agent = self.agent(rng)
        agent.learn(steps, reward)
        return agent.best(reward)

    def ask(self, obs: Array) -> Array:
        if not self.asked:
            raise ValueError("only methods that are marked as asking the expert may ask it")
        self.answers += len(obs)
        return self.expert(obs)

    def expert(self, obs: Array) -> Array:
        raise NotImplementedError

    def executed(self, act: Array, count: int) -> Array:
        """Return a policy's actions for that many observations. Raises ValueError for no such actions."""
        if act.shape != (count, self.act_size):
            raise ValueError(f"actions must have the shape ({count}, {self.act_size}), not {act.shape}")
        if not (np.isfinite(act).all() if self.discrete else (np.abs(act) <= 1).all()):
            raise ValueError("actions must be finite and, unless they are choices, lie in [-1, 1]")
        return np.eye(self.act_size)[act.argmax(axis=1)] if self.discrete else act

    def solved(self, reward: Any, rng: np.random.Generator) -> Policy:
        raise NotImplementedError

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        raise NotImplementedError


class FakeWorld(_Account):
    """Observations are uniform noise (3,), actions (2,); `solve` picks the best of some constant policies.

    Every episode lasts `lifetime` steps, and terminates if that is less than the horizon.
    """

    obs_size, act_size, horizon, gamma, discrete = 3, 2, 10, 0.9, False
    model: Model | None = None

    def __init__(self, lifetime: int = 10, asked: bool = True, unit: int = 1) -> None:
        super().__init__(asked, unit)
        self.lifetime = lifetime

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def phi(self, obs: Array, act: Array) -> Array:
        return np.concatenate([act, np.ones((len(act), 1))], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs = tuple(rng.uniform(-1, 1, (self.lifetime + 1, 3)) for _ in range(episodes))
        act = tuple(self.executed(policy(o[:-1]), self.lifetime) for o in obs)
        self.env_steps += episodes * self.lifetime
        return Episodes(obs, act, (self.lifetime < self.horizon,) * episodes)

    def expert(self, obs: Array) -> Array:
        return np.clip(obs[:, :2], -1, 1)

    def solved(self, reward: Reward | Payment, rng: np.random.Generator) -> Policy:
        """The best constant action of many; under a payment the first."""
        obs = rng.uniform(-1, 1, (64, 3))
        choices = rng.uniform(-1, 1, (500, 2))
        if not isinstance(reward, Reward):
            return lambda o: np.tile(choices[0], (len(o), 1))
        values = [reward(obs, np.tile(c, (64, 1)), obs).mean() for c in choices]
        best = choices[int(np.argmax(values))]
        return lambda o: np.tile(best, (len(o), 1))


class FakeAgent:
    """An agent of a world that says what is best."""

    def __init__(
        self,
        world: Any,
        rng: np.random.Generator,
        *,
        kind: Kind = "own",
        init: Policy | StochasticPolicy | None = None,
        demonstrations: Episodes | None = None,
        entropy: float = 0.0,
    ) -> None:
        self.world, self.rng, self.kind, self.demonstrations = world, rng, kind, demonstrations
        self.reward: Reward | Payment | None = None
        if world.model is not None and (init is not None or demonstrations is not None):
            raise ValueError("where the model is known, nothing is learned from a policy or demonstrations")
        if init is not None:
            self._check_init(init)

    def _check_init(self, init: Policy | StochasticPolicy) -> None:
        """Raise ValueError unless an actor could be that policy, whatever its hidden layers."""
        soft = self.kind == "soft"
        stochastic = soft and isinstance(init, SquashedGaussian)
        net = init.network if isinstance(init, SquashedGaussian) and soft else init
        if not isinstance(net, Network):
            raise ValueError(f"an agent cannot begin with a {type(init).__name__}")
        sizes = len(net.weights[0]), len(net.biases[-1])
        if sizes != (self.world.obs_size, self.world.act_size * (1 + stochastic)) or net.tanh == stochastic:
            raise ValueError("an agent cannot begin with a policy of other sizes, or another end")

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        _check_told(reward)
        if steps < 1:
            raise ValueError(f"a solve takes one step at least, not {steps}")
        if self.world.model is not None:
            if not isinstance(reward, Reward):
                raise ValueError("where the model is known, an agent learns under rewards alone")
        else:
            steps = -(-steps // self.world.unit) * self.world.unit
            if self.demonstrations is not None and not self.demonstrations.whole:
                raise ValueError("an agent learns from demonstrations only where every step is shown")
            self._check_paid(reward)
            self.world.env_steps += steps
        self.world.rl_solves += 1
        self.world.solves.append((reward, steps, self.reward is not None))
        self.reward = reward

    def _check_paid(self, reward: Reward | Payment) -> None:
        """Raise FloatingPointError unless the reward gives one finite number for each step."""
        obs = np.random.default_rng(0).uniform(-1, 1, (5, self.world.obs_size))
        act, living = np.zeros((5, self.world.act_size)), np.zeros(5, bool)
        if isinstance(reward, Reward):
            paid = reward(obs, act, obs) - reward.absorbing
        else:
            paid = reward(Transitions.own(obs, act, obs, living, living))
        if np.shape(paid) != (5,) or not np.isfinite(paid).all():
            raise FloatingPointError("the reward must give one finite number for each step")

    @property
    def policy(self) -> Policy:
        self._check_learned()
        found: Policy = self.world.solved(self.reward, self.rng)
        return found

    def best(self, reward: Reward) -> Policy:
        _check_told(reward)
        if self.world.model is None:
            self._check_learned()
            self._check_paid(reward)
        found: Policy = self.world.solved(reward, self.rng)
        return found

    @property
    def behaviour(self) -> StochasticPolicy:
        """Normal actions about 0, squashed, whatever is learned."""
        self._check_learned()
        if self.world.model is not None or self.kind == "own":
            raise ValueError("only an agent whose policy is by chance explores by it")
        size = self.world.obs_size, 2 * self.world.act_size
        still = Network(np.zeros(size[0]), np.ones(size[0]), (np.zeros(size),), (np.zeros(size[1]),))
        return SquashedGaussian(still)

    def replay(self) -> Transitions:
        """Some episodes of its policy, and `ABSORBING_STEPS` after each that terminated."""
        self._check_learned()
        if self.world.model is not None:
            raise ValueError("where the model is known, nothing is seen")
        counted = self.world.env_steps
        episodes = self.world.rollout(self.policy, 5, self.rng)
        self.world.env_steps = counted
        return Transitions.of(episodes).absorbed()

    def _check_learned(self) -> None:
        if self.reward is None:
            raise ValueError("an agent that has not learned yet has seen nothing and has no policy")


def _check_told(reward: object) -> None:
    if not callable(reward):
        raise TypeError(f"an agent learns under a reward or a payment, not {reward!r:.60}")


class NoEnvironment:
    """The sizes of a world and its actions, and nothing in it that could be touched."""

    obs_size, act_size, horizon, gamma, discrete, model = 3, 2, 10, 0.9, False, None

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))


class FiniteWorld(_Account):
    """A `Tabular` solved exactly by rewards of states and actions, and sampled."""

    discrete = True

    def __init__(self, tabular: Tabular, horizon: int = 10, gamma: float = 0.9, asked: bool = True) -> None:
        super().__init__(asked, unit=1)
        self.tabular, self.horizon, self.gamma = tabular, horizon, gamma
        self.model: Model | None = tabular.model
        self.obs_size, self.act_size = tabular.obs.shape[1], tabular.P.shape[1]
        self.found: list[Array] = []
        """What was solved, as (S, A)."""

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return np.eye(self.act_size)[rng.integers(self.act_size, size=count)]

    def phi(self, obs: Array, act: Array) -> Array:
        return self.tabular.features[self.tabular.states(obs)]

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        model = self.tabular
        reached = model.P.cumsum(axis=2) / model.P.sum(axis=2, keepdims=True)
        states, choices = [rng.choice(len(model.start), episodes, p=model.start)], list[Array]()
        for _ in range(self.horizon):
            choices.append(self.executed(policy(model.obs[states[-1]]), episodes))
            rows = reached[states[-1], choices[-1].argmax(axis=1)]
            states.append((rng.random((episodes, 1)) < rows).argmax(axis=1))
        obs, act = model.obs[np.stack(states, axis=1)], np.stack(choices, axis=1)
        self.env_steps += episodes * self.horizon
        return Episodes(tuple(obs), tuple(act), (False,) * episodes)

    def expert(self, obs: Array) -> Array:
        return self.optimal()(obs)

    def solved(self, reward: Reward, rng: np.random.Generator) -> Policy:
        obs = np.repeat(self.tabular.obs, self.act_size, axis=0)
        r = reward(obs, np.tile(np.eye(self.act_size), (len(self.tabular.obs), 1)), obs)
        self.found.append(
            greedy(value_iteration(self.tabular.P, r.reshape(-1, self.act_size), self.gamma)[1])
        )
        return self.policy(self.found[-1])

    def policy(self, choices: Array) -> Policy:
        """From (S, A)."""
        return lambda obs: choices[self.tabular.states(obs)]

    def optimal(self) -> Policy:
        """Under the true reward."""
        model = self.tabular
        return self.policy(greedy(value_iteration(model.P, model.reward, self.gamma)[1]))
