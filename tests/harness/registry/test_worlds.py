"""The doubles that methods are tested in behave as the real world does, wherever that raises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from envs import EnvSpec
from envs.learners import DDPG
from harness.learn.world import TaskWorld
from harness.registry.contract import ContractError, check_method
from harness.registry.contract.methods import known_task
from methods.base import Array, Episodes, Learned, Transitions, World
from methods.network import Network
from methods.rewards import Constant
from methods.stochastic import SquashedGaussian
from tests.methods.worlds import FakeWorld, FiniteWorld

UNIT = DDPG().unit


class Noise(gym.Env):
    """What `FakeWorld` is of."""

    observation_space, action_space = spaces.Box(-1, 1, (3,)), spaces.Box(-1, 1, (2,))

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        return self.np_random.uniform(-1, 1, 3).astype(np.float32), {}

    def step(self, action: Array) -> tuple:
        return self.np_random.uniform(-1, 1, 3).astype(np.float32), 0.0, False, False, {}


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@dataclass(frozen=True)
class Pays:
    value: Any = 1.0
    absorbing: float = 0.0
    size: int = 1

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.repeat(act[:, 0] * 0 + self.value, self.size)


def still(world: Any, width: int = 0, value: float = 0.0, rows: int = 0) -> Callable[[Array], Array]:
    return lambda obs: np.full((len(obs) + rows, world.act_size + width), value)


def learned(world: Any, reward: Any = None, steps: int = 2 * UNIT, **given: Any) -> Any:
    agent = world.agent(rng(), **given)
    agent.learn(steps, reward or Pays())
    return agent


def network(world: Any, more: int = 0, tanh: bool = True) -> Network:
    sizes = (world.obs_size + more, 8, world.act_size)
    weights, biases = tuple(map(np.zeros, pairwise(sizes))), tuple(map(np.zeros, sizes[1:]))
    return Network(np.zeros(sizes[0]), np.ones(sizes[0]), weights, biases, tanh=tanh)


def episodes(world: Any) -> Episodes:
    return world.rollout(still(world), 2, rng())


CALLS: dict[str, Callable[[Any], Any]] = {
    "random actions": lambda w: w.random_actions(4, rng()),
    "features": lambda w: len(w.phi(episodes(w).obs[0][:4], episodes(w).act[0][:4])),
    "a rollout": episodes,
    "a rollout of nothing": lambda w: w.rollout(still(w), 0, rng()),
    "actions too wide": lambda w: w.rollout(still(w, width=1), 2, rng()),
    "actions too narrow": lambda w: w.rollout(still(w, width=-1), 2, rng()),
    "actions too far": lambda w: w.rollout(still(w, value=1.5), 2, rng()),
    "actions of NaN": lambda w: w.rollout(still(w, value=np.nan), 2, rng()),
    "too many actions": lambda w: w.rollout(still(w, rows=1), 2, rng()),
    "a question": lambda w: w.ask(np.zeros((2, w.obs_size))),
    "an unknown wish": lambda w: w.agent(rng(), hard=True),
    "a wish without its name": lambda w: w.agent(rng(), True),
    "policy before": lambda w: w.agent(rng()).policy,
    "replay before": lambda w: w.agent(rng()).replay(),
    "behaviour before": lambda w: w.agent(rng(), kind="soft").behaviour,
    "best before": lambda w: w.agent(rng()).best(Pays()),
    "policy": lambda w: learned(w).policy,
    "best": lambda w: learned(w).best(Pays()),
    "replay": lambda w: learned(w).replay(),
    "behaviour": lambda w: learned(w).behaviour,
    "soft behaviour": lambda w: learned(w, kind="soft").behaviour.sample(np.zeros((2, w.obs_size)), rng()),
    "a solve": lambda w: w.solve(Pays(), rng(), 2 * UNIT),
    "few steps": lambda w: learned(w, steps=UNIT) and None,
    "no multiple": lambda w: learned(w, steps=3 * UNIT + 1) and None,
    "no steps": lambda w: learned(w, steps=0) and None,
    "no reward": lambda w: w.agent(rng()).learn(2 * UNIT, None),
    "best of none": lambda w: learned(w).best(None),
    "best of NaN": lambda w: learned(w).best(Pays(np.nan)),
    "a reward of NaN": lambda w: learned(w, Pays(np.nan)) and None,
    "an infinite reward": lambda w: learned(w, Pays(np.inf)) and None,
    "two numbers a step": lambda w: learned(w, Pays(size=2)) and None,
    "a payment": lambda w: learned(w, lambda steps: np.zeros(len(steps))) and None,
    "a payment of NaN": lambda w: learned(w, lambda steps: np.full(len(steps), np.nan)) and None,
    "a payment of one": lambda w: learned(w, lambda steps: np.zeros(1)) and None,
    "a reward without absorbing": lambda w: learned(w, lambda obs, act, after: obs[:, 0]) and None,
    "a beginning": lambda w: learned(w, init=network(w)).policy,
    "a soft beginning": lambda w: learned(w, init=network(w), kind="soft").policy,
    "a beginning that sees more": lambda w: w.agent(rng(), init=network(w, more=1)),
    "a beginning without an end": lambda w: w.agent(rng(), init=network(w, tanh=False)),
    "half a distribution": lambda w: w.agent(
        rng(), kind="soft", init=SquashedGaussian(network(w, tanh=False))
    ),
    "a distribution that is not asked for": lambda w: w.agent(rng(), init=SquashedGaussian(network(w))),
    "a beginning that is no network": lambda w: w.agent(rng(), init=still(w)),
    "demonstrations": lambda w: learned(w, demonstrations=episodes(w), kind="soft").policy,
    "some steps of demonstrations": lambda w: (
        learned(w, demonstrations=episodes(w).every(2, rng()), kind="soft") and None
    ),
}


def described(value: Any, world: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.kind
    if isinstance(value, Episodes):
        return [described(array, world) for array in (*value.obs, *value.act)], value.terminated
    if isinstance(value, Transitions):
        columns = vars(value).items()
        return {name: (column.shape[1:], column.dtype.kind) for name, column in columns}
    if callable(value):
        return described(value(np.zeros((4, world.obs_size))), world)
    return value


def outcome(call: Callable[[Any], Any], world: Any) -> Any:
    try:
        return described(call(world), world)
    except Exception as error:
        return type(error)


@pytest.fixture(scope="module")
def pairs() -> dict[str, tuple[Callable[[], Any], Callable[[], Any]]]:
    """Real worlds and their doubles, where the model is known and where not."""
    env_id = "irl_bench_tests/Noise-v0"
    gym.register(env_id, entry_point=Noise, max_episode_steps=10, disable_env_checker=True)
    rl = DDPG(net=(8,), batch=16, gradient_steps=1)
    noise, known = EnvSpec("noise", env_id, 3, 2, (1.0,) * 3, 10, gamma=0.9, rl=rl), known_task()
    assert known.tabular is not None
    tabular = known.tabular
    return {
        "learned": (
            lambda: TaskWorld(noise, "absorbing", "sb3"),
            lambda: FakeWorld(asked=False, unit=UNIT),
        ),
        "known": (lambda: TaskWorld(known, "absorbing", "sb3"), lambda: FiniteWorld(tabular, asked=False)),
    }


@pytest.mark.parametrize("kind", ["learned", "known"])
def test_a_double_does_what_the_world_does(kind: str, pairs: dict[str, Any]) -> None:
    real, double = pairs[kind]
    told = {name: (outcome(call, double()), outcome(call, real())) for name, call in CALLS.items()}
    assert {name: both for name, both in told.items() if both[0] != both[1]} == {}
    raised = {name for name, (_, its) in told.items() if isinstance(its, type)}
    assert {"a question", "policy before", "no reward"} <= raised < CALLS.keys()
    assert ("replay" in raised) == ("behaviour" in raised and kind == "known")


@pytest.mark.parametrize("kind", ["learned", "known"])
def test_a_double_counts_as_the_world_does(kind: str, pairs: dict[str, Any]) -> None:
    real, double = (make() for make in pairs[kind])
    for world in (real, double):
        episodes(world)
        learned(world).policy  # noqa: B018
    public = {name: value for name, value in vars(real).items() if name[0] != "_"}
    assert all(hasattr(double, name) for name in public)
    for name in ("obs_size", "act_size", "horizon", "gamma", "discrete", "env_steps", "rl_solves", "answers"):
        assert getattr(double, name) == public[name], name


class Presumes:
    """Methods that presume what the world does not give."""

    @dataclass(frozen=True)
    class Replay:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            agent = world.agent(rng)
            agent.learn(320, Constant(0.0, 0.0))
            agent.replay()
            return Learned(agent.policy, None)

    @dataclass(frozen=True)
    class Begins:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            agent = world.agent(rng, demonstrations=demos if demos.whole else None)
            agent.learn(320, Constant(0.0, 0.0))
            return Learned(agent.policy, None)

    @dataclass(frozen=True)
    class Asks:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            world.ask(demos.pairs()[0])
            return Learned(lambda obs: np.zeros((len(obs), world.act_size)), None)

    @dataclass(frozen=True)
    class Steals:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            return Learned(world.agent(rng).policy, None)

    @dataclass(frozen=True)
    class Idle:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            return Learned(world.solve(Constant(0.0, 0.0), rng, 0), None)


@pytest.mark.parametrize(
    ("method", "why"),
    [
        (Presumes.Replay(), "model is known: .*nothing is seen"),
        (Presumes.Begins(), "model is known: .*nothing is learned from"),
        (Presumes.Asks(), "policy and a reward: .*marked as asking"),
        (Presumes.Steals(), "policy and a reward: .*not learned yet"),
        (Presumes.Idle(), "a policy and a reward: .*one step at least"),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else "",
)
def test_a_method_that_presumes_too_much_fails_its_check(method: Any, why: str) -> None:
    with pytest.raises(ContractError, match=why):
        check_method(method)


def test_no_agent_of_a_known_model_acts_before_it_has_learned() -> None:
    """Its policy would be the expert's."""
    world = TaskWorld(replace(known_task(), name="small"), "absorbing", "sb3")
    with pytest.raises(ValueError, match="not learned yet"):
        world.agent(rng()).policy  # noqa: B018
