"""Worlds that answer at once, one without dynamics and one whose model is known, for tests of methods.

They refuse nothing: the contract of methods is checked in real worlds.
"""

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
    """An account of what a world is asked for, as `TaskWorld` keeps it."""

    obs_size: int
    act_size: int
    discrete: bool
    model: Model | None
    solve_steps = 1000
    budget = "smoke"

    def __init__(self) -> None:
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
        self.answers += len(obs)
        return self.expert(obs)

    def expert(self, obs: Array) -> Array:
        raise NotImplementedError

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

    def __init__(self, lifetime: int = 10) -> None:
        super().__init__()
        self.lifetime = lifetime

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def phi(self, obs: Array, act: Array) -> Array:
        return np.concatenate([act, np.ones((len(act), 1))], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs = tuple(rng.uniform(-1, 1, (self.lifetime + 1, 3)) for _ in range(episodes))
        act = tuple(policy(o[:-1]) for o in obs)
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

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        if self.world.model is None:
            self.world.env_steps += steps
        self.world.rl_solves += 1
        self.world.solves.append((reward, steps, self.reward is not None))
        self.reward = reward

    @property
    def policy(self) -> Policy:
        chosen: Policy = self.world.solved(self.reward, self.rng)
        return chosen

    def best(self, reward: Reward) -> Policy:
        chosen: Policy = self.world.solved(reward, self.rng)
        return chosen

    @property
    def behaviour(self) -> StochasticPolicy:
        """Normal actions about 0, squashed, whatever is learned."""
        size = self.world.obs_size, 2 * self.world.act_size
        still = Network(np.zeros(size[0]), np.ones(size[0]), (np.zeros(size),), (np.zeros(size[1]),))
        return SquashedGaussian(still)

    def replay(self) -> Transitions:
        """Some episodes of its policy, and `ABSORBING_STEPS` after each that terminated."""
        counted = self.world.env_steps
        episodes = self.world.rollout(self.policy, 5, self.rng)
        self.world.env_steps = counted
        return Transitions.of(episodes).absorbed()


class NoEnvironment:
    """The sizes of a world and its actions, and nothing in it that could be touched."""

    obs_size, act_size, horizon, gamma, discrete, model = 3, 2, 10, 0.9, False, None

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))


class FiniteWorld(_Account):
    """A `Tabular` solved exactly by rewards of states and actions, and sampled."""

    discrete = True

    def __init__(self, tabular: Tabular, horizon: int = 10, gamma: float = 0.9) -> None:
        super().__init__()
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
            choices.append(np.eye(self.act_size)[policy(model.obs[states[-1]]).argmax(axis=1)])
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
