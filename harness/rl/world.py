"""The world that methods live in: an environment without its reward, which counts how it is used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np

from envs import EnvSpec
from envs.learners import PPO, soft
from harness.registry import Library
from harness.rl.exact import ExactSolver
from harness.rl.seeds import training_seeds
from harness.rl.simulator import Simulator, Trajectory
from harness.rl.solving import Agent, Told
from methods.base import (
    Array,
    Episodes,
    Kind,
    Payment,
    Policy,
    Reward,
    StochasticPolicy,
    Transitions,
    Unsuitable,
)


class Options(TypedDict, total=False):
    """Options of a new agent, as for `methods.base.World.agent`."""

    kind: Kind
    init: Policy | StochasticPolicy | None
    demonstrations: Episodes | None
    entropy: float


@dataclass(frozen=True)
class Features:
    """A task's features for linear rewards: observations (B, O) and actions (B, A) to (B, K)."""

    _spec: EnvSpec

    def __call__(self, obs: Array, act: Array, /) -> Array:
        return self._spec.features(obs, act)


class TaskWorld:
    """A `methods.base.World`. It gives out copies of arrays, so that neither true rewards nor `info` leave
    it.

    `expert`: answers methods that are marked as asking. `told`: called now and then with the environment
    steps so far and new points of curves. `solve_steps`, `budget`: as of a `World`. `answers`: actions that
    the expert gave. `curves`: what methods logged.
    """

    def __init__(
        self,
        spec: EnvSpec,
        protocol: str,
        library: Library,
        expert: Policy | None = None,
        told: Told = lambda done, values: None,
        solve_steps: int = 1000,
        budget: str = "full",
    ) -> None:
        self.obs_size, self.act_size, self.discrete = spec.obs_size, spec.act_size, spec.discrete
        self.horizon, self.gamma, self.phi = spec.horizon, spec.gamma, Features(spec)
        self.solve_steps, self.budget = solve_steps, budget
        self.model = spec.tabular.model if spec.tabular else None
        self.env_steps = self.check_steps = self.rl_solves = self.answers = 0
        self._spec, self._protocol, self._library = spec, protocol, library
        self._expert, self._told = expert, told
        self.curves: dict[str, list[float]] = {}

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return self._spec.random_actions(count, rng)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        rollouts = without_rewards(Simulator(self._spec).run(policy, training_seeds(rng, episodes)))
        self.env_steps += int(rollouts.lengths.sum())
        return rollouts

    def log(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.curves.setdefault(name, []).append(float(value))
        self._told(self.env_steps, values)

    def ask(self, obs: Array) -> Array:
        if self._expert is None:
            raise ValueError("only methods that are marked as asking the expert may ask it")
        if self._spec.expert_task:
            raise Unsuitable("the expert sees states, and there are images here")
        self.answers += len(obs)
        return np.array(self._spec.executed(self._expert(obs.copy())))

    def agent(self, rng: np.random.Generator, **options: Unpack[Options]) -> WorldAgent:
        def told(done: int, values: Mapping[str, float]) -> None:
            self._told(self.env_steps + done, values)

        parts = self._spec, self._protocol, rng, self._library
        return WorldAgent(self, solver_for(*parts, told=told, **options))

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int) -> Policy:
        agent = self.agent(rng)
        agent.learn(steps, reward)
        return agent.best(reward)


class WorldAgent:
    """A `methods.base.Agent` whose use its world counts."""

    def __init__(self, world: TaskWorld, solver: Agent | ExactSolver) -> None:
        self._world, self._solver = world, solver

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        _check_reward(reward)
        if steps < 1:
            raise ValueError(f"a solve takes one step at least, not {steps}")
        before = self._solver.env_steps
        self._solver.learn(self._solver.whole(steps), reward)
        self._world.env_steps += self._solver.env_steps - before
        self._world.rl_solves += 1

    def best(self, reward: Reward) -> Policy:
        _check_reward(reward)
        solution = self._solver.best(reward)
        self._world.check_steps += solution.check_steps
        return solution.policy

    @property
    def policy(self) -> Policy:
        return self._solver.policy

    @property
    def behaviour(self) -> StochasticPolicy:
        return self._solver.behaviour

    def replay(self) -> Transitions:
        seen = self._solver.replay()
        return Transitions(*(column.copy() for column in vars(seen).values()))


def _check_reward(reward: object) -> None:
    """Raise TypeError for None, because a solver takes it for the true reward."""
    if not callable(reward):
        raise TypeError(f"an agent learns under a reward or a payment, not {reward!r:.60}")


def solver_for(
    spec: EnvSpec,
    protocol: str,
    rng: np.random.Generator,
    library: Library,
    *,
    told: Told = lambda done, values: None,
    kind: Kind = "own",
    init: Policy | StochasticPolicy | None = None,
    demonstrations: Episodes | None = None,
    entropy: float = 0.0,
) -> Agent | ExactSolver:
    """Return a solver of an environment: dynamic programming where its model is known, else RL by the
    library.

    `told`: as for `Agent`. The other options: as for `methods.base.World.agent`. Raises ValueError for a
    beginning that the solver cannot have.
    """
    if spec.tabular is None:
        # The PPO of Stable-Baselines3 keeps no steps.
        suits = kind == "own" or (kind == "stochastic" and isinstance(spec.rl, PPO) and library == "sbx")
        settings = spec.rl if suits else soft(spec.rl, spec.discrete)
        return Agent(
            *(spec, protocol, rng, library, settings),
            told=told,
            init=init,
            demonstrations=demonstrations,
            entropy=entropy,
        )
    if init is not None or demonstrations is not None:
        raise ValueError("where the model is known, nothing is learned from a policy or demonstrations")
    return ExactSolver(spec.tabular, spec.gamma, rng)


def without_rewards(trajectories: Sequence[Trajectory]) -> Episodes:
    """Return copies of what a method may see of trajectories."""
    obs, act = ([getattr(t, name).copy() for t in trajectories] for name in ("obs", "act"))
    return Episodes(tuple(obs), tuple(act), tuple(t.terminated for t in trajectories))
