"""The world counts what it is asked for and hides its reward."""

from __future__ import annotations

import contextlib
import dataclasses
import math
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
from harness.rl.world import TaskWorld
from methods.base import Array, Kind
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
    agent.learn(1000, ZERO)
    assert agent.policy(SPECS["gridworld"].tabular.obs).shape == (144, 5)  # type: ignore[union-attr]
    assert (world.env_steps, world.check_steps, world.rl_solves) == (0, 0, 2)
    episodes = world.rollout(policy, 3, rng())
    assert world.env_steps == 3 * 50
    np.testing.assert_array_equal(episodes.act[0], policy(episodes.obs[0][:-1]))
    with pytest.raises(ValueError, match="where the model is known, nothing is"):
        world.agent(rng(), demonstrations=episodes)


def test_an_agents_learner_is_of_the_kind_that_is_asked_for_and_takes_whole_bouts(steady: EnvSpec) -> None:
    ppo = PPO(net=(8,))
    soft = SAC(net=(8,), n_steps=1, checkpoint_every=5000)
    ddpg, choices = DDPG(net=(8,), tau=0.1, copies=5), SPECS["cartpole_discrete"]
    asked: list[tuple[EnvSpec, Learner, Kind, Library, Learner]] = [
        (steady, ddpg, "soft", "sb3", SAC(net=(8,), tau=0.1, copies=5)),
        (steady, ppo, "stochastic", "sbx", ppo),
        # The PPO of Stable-Baselines3 keeps no steps.
        (steady, ppo, "stochastic", "sb3", soft),
        (steady, ppo, "own", "sb3", ppo),
        (choices, ppo, "soft", "sb3", DQN(net=(8,))),
    ]
    for spec, own, kind, library, expected in asked:
        world = TaskWorld(dataclasses.replace(spec, rl=own), "absorbing", library)
        assert world.agent(rng(), kind=kind)._solver.settings == expected
    world = TaskWorld(dataclasses.replace(steady, rl=PPO(copies=4, steps=5, batch=10)), "absorbing", "sbx")
    world.agent(rng()).learn(21, ZERO)
    assert world.env_steps == 40
