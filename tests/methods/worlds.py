"""Worlds that answer at once, one without dynamics and one whose model is known, for tests of methods.

They refuse nothing: the contract of methods is checked in real worlds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from envs.models import Model, Tabular
from harness.rl.exact import expected_rewards
from methods.base import Array, Episodes, Payment, Policy, Reward, Rng, StochasticPolicy, Transitions
from methods.network import Network
from methods.stochastic import SquashedGaussian
from methods.tabular.model import greedy, value_iteration


class _World:
    """What both worlds share: an account of what methods ask for."""

    obs_size: int
    act_size: int
    model: Model | None = None
    solve_steps, budget = 1000, "smoke"

    def __init__(self) -> None:
        self.solves: list[tuple[Reward | Payment, int, bool]] = []
        """Reward, steps, and whether an agent went on from before."""
        self.options: list[dict[str, Any]] = []
        """The options of each agent."""
        self.curves: dict[str, list[float]] = {}

    def log(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.curves.setdefault(name, []).append(value)

    def agent(self, rng: Rng, **options: Any) -> FakeAgent:
        self.options.append(options)
        return FakeAgent(self, rng)

    def solve(self, reward: Reward, rng: Rng, steps: int) -> Policy:
        agent = self.agent(rng)
        agent.learn(steps, reward)
        return agent.best(reward)

    def solved(self, reward: Any, rng: Rng) -> Policy:
        raise NotImplementedError

    def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
        raise NotImplementedError


class FakeWorld(_World):
    """Observations are uniform noise (3,), actions (2,). A solve picks the best of some constant policies.

    Every episode lasts `lifetime` steps, and terminates if that is less than the horizon.
    """

    obs_size, act_size, horizon, gamma, discrete = 3, 2, 10, 0.9, False

    def __init__(self, lifetime: int = 10) -> None:
        super().__init__()
        self.lifetime = lifetime

    def random_actions(self, count: int, rng: Rng) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def phi(self, obs: Array, act: Array) -> Array:
        return np.concatenate([act, np.ones((len(act), 1))], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
        obs = tuple(rng.uniform(-1, 1, (self.lifetime + 1, 3)) for _ in range(episodes))
        return Episodes(obs, tuple(policy(o[:-1]) for o in obs), (self.lifetime < self.horizon,) * episodes)

    def solved(self, reward: Reward | Payment, rng: Rng) -> Policy:
        """Return the best constant action of many, or the first under a payment."""
        obs, choices = rng.uniform(-1, 1, (64, 3)), rng.uniform(-1, 1, (500, 2))
        best = choices[0]
        if isinstance(reward, Reward):
            values = [reward(obs, np.tile(c, (64, 1)), obs).mean() for c in choices]
            best = choices[int(np.argmax(values))]
        return lambda o: np.tile(best, (len(o), 1))


class FakeAgent:
    """An agent of a world that solves rewards at once."""

    def __init__(self, world: Any, rng: Rng) -> None:
        self.world, self.rng = world, rng
        self.reward: Reward | Payment | None = None

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        self.world.solves.append((reward, steps, self.reward is not None))
        self.reward = reward

    @property
    def policy(self) -> Policy:
        return self.best(self.reward)

    def best(self, reward: Any) -> Policy:
        policy: Policy = self.world.solved(reward, self.rng)
        return policy

    @property
    def behaviour(self) -> StochasticPolicy:
        """Normal actions about 0, squashed, whatever is learned."""
        inputs, outputs = self.world.obs_size, 2 * self.world.act_size
        nothing = np.zeros((inputs, outputs)), np.zeros(outputs)
        return SquashedGaussian(Network(np.zeros(inputs), np.ones(inputs), nothing[:1], nothing[1:]))

    def replay(self) -> Transitions:
        """Return some episodes of its policy, and `ABSORBING_STEPS` after each that terminated."""
        return Transitions.of(self.world.rollout(self.policy, 5, self.rng)).absorbed()


class FiniteWorld(_World):
    """A `Tabular` solved exactly by rewards of states and actions, and sampled."""

    discrete = True

    def __init__(self, tabular: Tabular, horizon: int = 10, gamma: float = 0.9) -> None:
        super().__init__()
        self.tabular, self.horizon, self.gamma, self.model = tabular, horizon, gamma, tabular.model
        self.obs_size, self.act_size = tabular.obs.shape[1], tabular.P.shape[1]
        self.solutions: list[Array] = []
        """Policies of all solves, (S, A) each."""

    def random_actions(self, count: int, rng: Rng) -> Array:
        return np.eye(self.act_size)[rng.integers(self.act_size, size=count)]

    def phi(self, obs: Array, act: Array) -> Array:
        return self.tabular.features[self.tabular.states(obs)]

    def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
        model = self.tabular
        reached = model.P.cumsum(axis=2) / model.P.sum(axis=2, keepdims=True)
        states, choices = [rng.choice(len(model.start), episodes, p=model.start)], list[Array]()
        for _ in range(self.horizon):
            choices.append(np.eye(self.act_size)[policy(model.obs[states[-1]]).argmax(axis=1)])
            rows = reached[states[-1], choices[-1].argmax(axis=1)]
            states.append((rng.random((episodes, 1)) < rows).argmax(axis=1))
        obs, act = model.obs[np.stack(states, axis=1)], np.stack(choices, axis=1)
        return Episodes(tuple(obs), tuple(act), (False,) * episodes)

    def solved(self, reward: Reward, rng: Rng) -> Policy:
        q = value_iteration(self.tabular.P, expected_rewards(self.tabular, reward), self.gamma)[1]
        self.solutions.append(greedy(q))
        return self.policy(self.solutions[-1])

    def policy(self, choices: Array) -> Policy:
        """Return the policy of choices (S, A)."""
        return lambda obs: choices[self.tabular.states(obs)]

    def ask(self, obs: Array) -> Array:
        return self.optimal()(obs)

    def optimal(self) -> Policy:
        """Return the best policy under the true reward."""
        model = self.tabular
        return self.policy(greedy(value_iteration(model.P, model.reward, self.gamma)[1]))

    def drawn(self, chances: Array, rng: Rng) -> Policy:
        """Return a policy that draws choices by these chances (S, A)."""

        def draw(obs: Array) -> Array:
            likely = chances[self.tabular.states(obs)].cumsum(axis=1)
            return np.eye(self.act_size)[(rng.random((len(obs), 1)) < likely).argmax(axis=1)]

        return draw


def constant(*action: float) -> Policy:
    """Return the policy of one action."""
    return lambda obs: np.tile(action, (len(obs), 1))


def demonstrate(policy: Policy, count: int = 20, lifetime: int = 10) -> Episodes:
    """Return demonstrations of a policy, (B, 3) to (B, 2), on uniform observations."""
    return FakeWorld(lifetime).rollout(policy, count, np.random.default_rng(0))
