"""The world counts what it is asked for and hides its reward."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable
from types import FunctionType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG, DQN, PPO, SAC, Learner
from envs.models import Tabular
from harness.registry import SPECS, Library
from harness.rl.exact import ExactSolver
from harness.rl.simulator import Simulator, Trajectory
from harness.rl.solving import Agent
from harness.rl.world import TaskWorld, without_rewards
from methods.base import Array, Kind, Transitions
from methods.network import Network
from methods.rewards import Constant
from methods.stochastic import SquashedGaussian
from tests.harness.rewards import Nothing

ZERO = Nothing()


def on_target(obs: Array) -> Array:
    return obs


def off_target(obs: Array) -> Array:
    return -np.sign(obs)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_it_counts_steps_and_solves(steady: EnvSpec, fragile: EnvSpec) -> None:
    short = TaskWorld(fragile, "native", "sb3")
    assert short.rollout(off_target, 4, rng()).terminated == (True,) * 4
    assert short.env_steps == 4
    world = TaskWorld(steady, "absorbing", "sb3")
    world.rollout(on_target, 3, rng())
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30, 0, 0)
    # So short a solve checks one episode of ten steps before it learns and at its end.
    world.solve(ZERO, rng(), 40)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 40, 20, 1)
    agent = world.agent(rng())
    agent.learn(20, ZERO)
    agent.learn(20, ZERO)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 80, 20, 3)
    agent.best(ZERO)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 80, 40, 3)


def test_the_expert_answers_those_who_may_ask_and_is_counted(steady: EnvSpec) -> None:
    world, obs = TaskWorld(steady, "absorbing", "sb3", expert=off_target), np.array([[0.3], [-0.2]])
    np.testing.assert_array_equal(world.ask(obs), [[-1.0], [1.0]])
    world.ask(obs[:1])
    assert (world.answers, world.env_steps) == (3, 0)
    with pytest.raises(ValueError, match="only methods that are marked"):
        TaskWorld(steady, "absorbing", "sb3").ask(obs)


def test_a_solve_starts_anew(steady: EnvSpec) -> None:
    def solve(world: TaskWorld, seed: int) -> Network:
        policy = world.solve(ZERO, rng(seed), 40)
        assert isinstance(policy, Network)
        return policy

    world, obs = TaskWorld(steady, "absorbing", "sb3"), np.linspace(-0.8, 0.8, 9)[:, None]
    first = solve(world, 0)(obs)
    # Under a constant reward learning stands still, and the first actor of a solve is the one returned.
    np.testing.assert_array_equal(solve(world, 0)(obs), first)
    assert (solve(world, 1)(obs) != first).any()
    agent = world.agent(rng(0))
    agent.learn(40, ZERO)
    np.testing.assert_array_equal(agent.best(ZERO)(obs), first)


def test_what_an_agent_has_seen_is_a_copy_without_rewards(fragile: EnvSpec) -> None:
    agent = TaskWorld(fragile, "absorbing", "sb3").agent(rng())
    with pytest.raises(ValueError, match="has seen nothing"):
        agent.replay()
    with pytest.raises(ValueError, match="has no best policy"):
        agent.best(ZERO)
    agent.learn(40, ZERO)
    seen = agent.replay()
    assert len(seen) == 40
    seen.obs[:] = 7.0
    assert np.abs(agent.replay().obs).max() < 1


def test_an_agent_begins_with_what_its_method_gives_it(steady: EnvSpec) -> None:
    spec = dataclasses.replace(steady, rl=SAC(net=()))
    world = TaskWorld(spec, "absorbing", "sb3")
    network = Network(np.zeros(1), np.ones(1), (np.array([[0.5, -0.2]]),), (np.array([0.1, -1.0]),))
    init = SquashedGaussian(network)
    demos = world.rollout(on_target, 3, rng())
    agent = world.agent(rng(), init=init, demonstrations=demos)
    seen: list[Transitions] = []
    agent.learn(40, lambda steps: seen.append(steps) or np.zeros(len(steps)))
    # The demonstrations were paid, and are no steps of the agent's own.
    assert (world.env_steps, world.rl_solves) == (30 + 40, 1)
    (shown,) = (steps for steps in seen if steps.demonstrated.any())
    np.testing.assert_array_equal(shown.obs, demos.pairs()[0])
    assert shown.demonstrated.all()
    still = world.agent(rng(), init=init)
    still.learn(40, Constant(0.0, 0.0))
    obs, act = demos.pairs()
    np.testing.assert_allclose(still.policy(obs), init.mean(obs), atol=1e-6)
    np.testing.assert_allclose(still.behaviour.log_prob(obs, act), init.log_prob(obs, act), atol=1e-4)


def reachable(start: list[Any]) -> list[Any]:
    """All that public names, items and what arrays are views of lead to, the objects of bound methods too."""
    things, waiting = {id(thing): thing for thing in start}, list(start)
    while waiting:
        thing = waiting.pop()
        inside: list[Any] = []
        if isinstance(thing, np.ndarray):
            inside = [thing.base]
        elif isinstance(thing, dict | list | tuple | set):
            inside = [*(thing.values() if isinstance(thing, dict) else thing)]
        elif not isinstance(thing, type | type(math) | FunctionType | str | int | float):
            for name in (name for name in dir(thing) if name[0] != "_"):
                with contextlib.suppress(AttributeError, ValueError):
                    inside.append(getattr(thing, name))
        for one in inside:
            if id(one) not in things:
                things[id(one)] = one
                waiting.append(one)
    return list(things.values())


@pytest.mark.parametrize("env", ["steady", "gridworld"])
def test_no_public_path_leads_a_method_to_the_true_reward(env: str, steady: EnvSpec) -> None:
    spec = steady if env == "steady" else SPECS[env]
    world = TaskWorld(spec, "absorbing", "sb3")
    policy = world.solve(ZERO, rng(), 20)
    agent = world.agent(rng())
    agent.learn(20, ZERO)
    things = reachable([world, policy, agent, agent.best(ZERO), world.rollout(policy, 2, rng())])
    assert len(things) > 20
    forbidden = (EnvSpec, Tabular, gym.Env, Trajectory, Simulator, Agent, ExactSolver)
    assert [type(thing) for thing in things if isinstance(thing, forbidden)] == []
    if spec.tabular:
        rewards = spec.tabular.reward
        assert not any(np.shares_memory(x, rewards) for x in things if isinstance(x, np.ndarray))


def test_where_the_model_is_known_a_solve_takes_no_steps_and_begins_with_nothing() -> None:
    world = TaskWorld(SPECS["gridworld"], "absorbing", "sb3")
    policy = world.solve(ZERO, rng(), 1000)
    agent = world.agent(rng(), kind="soft")
    with pytest.raises(ValueError, match="no policy"):
        agent.policy  # noqa: B018
    agent.learn(1000, ZERO)
    assert agent.policy(SPECS["gridworld"].tabular.obs).shape == (144, 5)  # type: ignore[union-attr]
    assert (world.env_steps, world.check_steps, world.rl_solves) == (0, 0, 2)
    episodes = world.rollout(policy, 3, rng())
    assert world.env_steps == 3 * 50
    np.testing.assert_array_equal(episodes.act[0], policy(episodes.obs[0][:-1]))
    refused: list[Callable[[], object]] = [
        lambda: world.agent(rng(), init=policy),
        lambda: world.agent(rng(), demonstrations=episodes),
        lambda: agent.behaviour,
        agent.replay,
    ]
    for ask in refused:
        with pytest.raises(ValueError, match="where the model is known, nothing is"):
            ask()


def test_what_a_method_sees_of_a_trajectory_is_a_copy() -> None:
    trajectory = Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), np.ones(2), True, "missed")
    episodes = without_rewards([trajectory])
    trajectory.obs[:] = 7.0
    trajectory.act[:] = 7.0
    assert (episodes.obs[0] == 0).all()
    assert (episodes.act[0] == 0).all()
    assert episodes.terminated == (True,)


SOFT = SAC(net=(8,), n_steps=1, checkpoint_every=5000)


@pytest.mark.parametrize(
    ("own", "kind", "library", "expected"),
    [
        (DDPG(net=(8,), tau=0.1, copies=5), "soft", "sb3", SAC(net=(8,), tau=0.1, copies=5)),
        (PPO(net=(8,), check_episodes=3), "soft", "sb3", dataclasses.replace(SOFT, check_episodes=3)),
        (PPO(net=(8,)), "stochastic", "sbx", PPO(net=(8,))),
        # The PPO of Stable-Baselines3 keeps no steps.
        (PPO(net=(8,)), "stochastic", "sb3", SOFT),
        (PPO(net=(8,)), "own", "sb3", PPO(net=(8,))),
    ],
)
def test_an_agents_learner_is_of_the_kind_that_is_asked_for(
    steady: EnvSpec, own: Learner, kind: Kind, library: Library, expected: Learner
) -> None:
    world = TaskWorld(dataclasses.replace(steady, rl=own), "absorbing", library)
    assert world.agent(rng(), kind=kind)._solver.settings == expected


def test_where_actions_are_choices_a_soft_agent_learns_their_values() -> None:
    spec = dataclasses.replace(SPECS["cartpole_discrete"], rl=PPO(net=(8,)))
    assert TaskWorld(spec, "absorbing", "sb3").agent(rng(), kind="soft")._solver.settings == DQN(net=(8,))


def test_a_solve_is_rounded_up_to_what_its_learner_takes(steady: EnvSpec) -> None:
    world = TaskWorld(
        dataclasses.replace(steady, rl=PPO(net=(8,), copies=4, steps=5, batch=10)), "absorbing", "sbx"
    )
    agent = world.agent(rng())
    agent.learn(21, ZERO)
    assert world.env_steps == 40
    with pytest.raises(ValueError, match="one step at least, not 0"):
        agent.learn(0, ZERO)
