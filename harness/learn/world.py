"""The world that methods live in: an environment without its reward, and an account of its use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from envs import EnvSpec
from envs.learners import PPO, soft
from harness.learn.exact import ExactSolver
from harness.learn.rl import Agent
from harness.learn.seeds import training_seeds
from harness.learn.simulator import Simulator, Trajectory
from harness.registry import Library
from methods.base import Array, Episodes, Kind, Payment, Policy, Reward, StochasticPolicy, Transitions


@dataclass(frozen=True)
class Features:
    """A task's features for linear rewards, (B, K) of observations (B, O) and actions (B, A)."""

    _spec: EnvSpec

    def __call__(self, obs: Array, act: Array, /) -> Array:
        return self._spec.features(obs, act)


class TaskWorld:
    """A `methods.base.World`. Arrays are copied out of it, so neither true rewards nor `info` leave.

    expert: whom a method that is marked so may ask. told: called now and then with how many environment
    steps were taken. solve_steps, budget: as of a `World`.
    answers: actions that the expert told.
    """

    def __init__(
        self,
        spec: EnvSpec,
        protocol: str,
        library: Library,
        expert: Policy | None = None,
        told: Callable[[int], None] = lambda done: None,
        solve_steps: int = 1000,
        budget: str = "full",
    ) -> None:
        self.solve_steps = solve_steps
        self.budget = budget
        self.obs_size = spec.obs_size
        self.act_size = spec.act_size
        self.horizon = spec.horizon
        self.gamma = spec.gamma
        self.discrete = spec.discrete
        self.phi = Features(spec)
        self.env_steps = 0
        self.check_steps = 0
        self.rl_solves = 0
        self.answers = 0
        self.model = spec.tabular.model if spec.tabular else None
        self._spec = spec
        self._protocol = protocol
        self._library = library
        self._expert = expert
        self._told = told

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return self._spec.random_actions(count, rng)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        rollouts = without_rewards(Simulator(self._spec).run(policy, training_seeds(rng, episodes)))
        self.env_steps += int(rollouts.lengths.sum())
        return rollouts

    def ask(self, obs: Array) -> Array:
        if self._expert is None:
            raise ValueError("only methods that are marked as asking the expert may ask it")
        self.answers += len(obs)
        return np.array(self._spec.executed(self._expert(obs.copy())))

    def agent(
        self,
        rng: np.random.Generator,
        *,
        kind: Kind = "own",
        init: Policy | StochasticPolicy | None = None,
        demonstrations: Episodes | None = None,
        entropy: float = 0.0,
    ) -> WorldAgent:
        solver = solver_for(
            *(self._spec, self._protocol, rng, self._library),
            kind=kind,
            init=init,
            demonstrations=demonstrations,
            entropy=entropy,
            told=lambda done: self._told(self.env_steps + done),
        )
        return WorldAgent(self, solver)

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int) -> Policy:
        agent = self.agent(rng)
        agent.learn(steps, reward)
        return agent.best(reward)


class WorldAgent:
    """A `methods.base.Agent`, which its world keeps an account of."""

    def __init__(self, world: TaskWorld, solver: Agent | ExactSolver) -> None:
        self._world, self._solver = world, solver

    def learn(self, steps: int, reward: Reward | Payment) -> None:
        _check_told(reward)
        if steps < 1:
            raise ValueError(f"a solve takes one step at least, not {steps}")
        before = self._solver.env_steps
        self._solver.learn(self._solver.whole(steps), reward)
        self._world.env_steps += self._solver.env_steps - before
        self._world.rl_solves += 1

    def best(self, reward: Reward) -> Policy:
        _check_told(reward)
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


def _check_told(reward: object) -> None:
    """Raise TypeError for None, which stands for the true reward where solvers are used without a world."""
    if not callable(reward):
        raise TypeError(f"an agent learns under a reward or a payment, not {reward!r:.60}")


def solver_for(
    spec: EnvSpec,
    protocol: str,
    rng: np.random.Generator,
    library: Library,
    *,
    kind: Kind = "own",
    init: Policy | StochasticPolicy | None = None,
    demonstrations: Episodes | None = None,
    entropy: float = 0.0,
    told: Callable[[int], None] = lambda done: None,
) -> Agent | ExactSolver:
    """What solves an environment: dynamic programming where its model is known, else RL by that library. The
    rest as of `methods.base.World.agent`, and `Agent`."""
    if spec.tabular is None:
        # The PPO of Stable-Baselines3 does not tell what it has seen.
        suits = kind == "own" or (kind == "stochastic" and isinstance(spec.rl, PPO) and library == "sbx")
        settings = spec.rl if suits else soft(spec.rl, spec.discrete)
        return Agent(
            *(spec, protocol, rng, library, settings),
            init=init,
            demonstrations=demonstrations,
            entropy=entropy,
            told=told,
        )
    if init is not None or demonstrations is not None:
        raise ValueError("where the model is known, nothing is learned from a policy or demonstrations")
    return ExactSolver(spec.tabular, spec.gamma, rng)


def without_rewards(trajectories: Sequence[Trajectory]) -> Episodes:
    """What a method may see of trajectories."""
    return Episodes(
        tuple(t.obs.copy() for t in trajectories),
        tuple(t.act.copy() for t in trajectories),
        tuple(t.terminated for t in trajectories),
    )
