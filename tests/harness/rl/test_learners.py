"""Every learner finds an optimum that is known, and begins with the policy that it is given."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces

from envs import EnvSpec
from envs.learners import DDPG, DQN, PPO, SAC, TD3, Learner
from harness.registry import LIBRARIES, SPECS, Library
from harness.rl.solving import Agent
from methods.base import Array
from methods.network import Network
from methods.rewards import Constant
from methods.stochastic import SquashedGaussian
from tests.harness.rewards import Seek

pytestmark = pytest.mark.usefixtures("fused_adam")
NOTHING = Constant(0.0, 0.0)
OBS = np.linspace(-0.6, 0.6, 13)[:, None]

both_libraries = pytest.mark.parametrize("library", LIBRARIES)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


ON_POLICY = PPO(copies=10, steps=10, batch=50, learning_rate=3e-3, checkpoint_every=1000)


@both_libraries
@pytest.mark.parametrize(
    ("settings", "steps"),
    [(DDPG(), 1500), (TD3(), 1500), (SAC(), 1500), (ON_POLICY, 8000)],
    ids=["DDPG", "TD3", "SAC", "PPO"],
)
def test_it_learns_the_task_and_another_after_it(
    steady: EnvSpec, settings: Learner, steps: int, library: Library
) -> None:
    agent = Agent(dataclasses.replace(steady, rl=settings), "absorbing", rng(), library)
    for side in (1.0, -1.0):
        solution = agent.solve(Seek(side), steps)
        assert np.abs(solution.policy(OBS) - side * OBS).mean() < 0.15
        returns = [value for _, value in solution.curve]
        assert max(returns) > 8.5 > 7 > returns[0]
        assert solution.env_steps == steps


@both_libraries
def test_by_choices_it_learns_the_task_and_goes_on_under_another_reward(library: Library) -> None:
    agent = Agent(SPECS["cartpole_discrete"], "absorbing", rng(), library)
    solution = agent.solve(None, 40_960)
    assert max(value for _, value in solution.curve) > 300
    agent.learn(4096, NOTHING)


@dataclasses.dataclass(frozen=True)
class Miss:
    """Pays minus the squared distance to the observation."""

    absorbing = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return -np.square(act - obs)[:, 0]


@pytest.mark.parametrize(("library", "worth"), [("sb3", 0.01), ("sbx", 0.01), ("sbx", None)])
def test_soft_actor_critic_finds_the_soft_optimum_for_entropy_that_is_told_or_learned(
    steady: EnvSpec, library: Library, worth: float | None
) -> None:
    # Nothing that is done matters later, so pi is exp(reward / entropy), up to a factor: a Gaussian.
    given: dict[str, Any] = {"entropy": worth} if worth else {}
    settings = SAC(n_steps=1, learning_rate=3e-3, final_learning_rate=3e-4, **given)
    agent = Agent(dataclasses.replace(steady, gamma=0.1, rl=settings), "absorbing", rng(), library)
    agent.learn(2000 if worth else 4000, Miss())
    obs = np.repeat(OBS, 2000, axis=0)
    drawn = agent.behaviour.sample(obs, rng())
    if worth:
        act = drawn.reshape(len(OBS), 2000)
        np.testing.assert_allclose(act.mean(axis=1, keepdims=True), OBS, atol=0.1)
        deviation = np.sqrt(agent._env._size * worth / 2)
        assert act.std(axis=1).mean() == pytest.approx(deviation, rel=0.1)
    else:
        entropy = -float(agent.behaviour.log_prob(obs, drawn).mean())
        assert entropy == pytest.approx(-1, abs=0.1)  # nats, one action


class Noise(gym.Env):
    """Observes standard normal numbers (3,) whatever the actions (2,) are."""

    observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        return self.np_random.normal(size=3).astype(np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        return self.np_random.normal(size=3).astype(np.float32), 0.0, False, False, {}


def noise(settings: Learner) -> EnvSpec:
    name = "irl_bench_tests/Noise-v0"
    if name not in gym.registry:
        gym.register(name, Noise, max_episode_steps=10, disable_env_checker=True)
    return EnvSpec("Noise", name, 3, 2, (0.5, 2.0, 7.0), 10, rl=settings)


def network(*sizes: int, tanh: bool = True) -> Network:
    """A random one that standardises its inputs."""
    generator = rng(5)
    pairs = list(pairwise(sizes))
    return Network(
        generator.normal(size=sizes[0]),
        generator.uniform(0.5, 2, sizes[0]),
        tuple(generator.normal(size=pair) / np.sqrt(pair[0]) for pair in pairs),
        tuple(0.3 * generator.normal(size=size) for _, size in pairs),
        tanh,
    )


SHOWN = rng(6).normal(size=(200, 3))


INIT = network(3, 16, 8, 2)
SQUASHED = SquashedGaussian(network(3, 16, 8, 4, tanh=False))


def seen_by(agent: Agent) -> np.ndarray:
    return agent._env.seen(SHOWN, np.zeros(len(SHOWN), bool))


@both_libraries
@pytest.mark.parametrize(
    ("settings", "init"),
    [(DDPG, INIT), (TD3, INIT), (SAC, INIT), (SAC, SQUASHED)],
    ids=["DDPG", "TD3", "SAC", "stochastic"],
)
def test_an_agent_begins_with_the_policy_that_it_is_given(settings: Any, init: Any, library: Library) -> None:
    agent = Agent(noise(settings(net=(16, 8))), "absorbing", rng(), library, init=init)
    agent.learn(20, NOTHING)
    act = init.mean(SHOWN) if init is SQUASHED else init(SHOWN)
    np.testing.assert_allclose(agent.policy(SHOWN), act, atol=1e-5)
    model: Any = agent._model
    # The library's own view of it, and the target's where there is one.
    np.testing.assert_allclose(model.predict(seen_by(agent), deterministic=True)[0], act, atol=1e-5)
    if init is SQUASHED:
        np.testing.assert_allclose(agent.behaviour.network(SHOWN), init.network(SHOWN), atol=1e-5)
    elif settings is SAC:
        np.testing.assert_array_equal(agent.behaviour._parameters(SHOWN)[1], 0)
    elif library == "sbx":
        state = model.policy.actor_state
        np.testing.assert_allclose(state.apply_fn(state.target_params, seen_by(agent)), act, atol=1e-5)
    else:
        target = model.actor_target(torch.as_tensor(seen_by(agent)))
        np.testing.assert_allclose(target.detach(), act, atol=1e-5)
    best: Any = agent.best(NOTHING).policy
    np.testing.assert_array_equal(best(SHOWN), agent.policy(SHOWN))


def test_q_learning_explores_with_a_share_of_random_choices() -> None:
    agent = Agent(SPECS["cartpole_discrete"], "absorbing", rng(), "sb3", DQN())
    agent.learn(200, NOTHING)
    obs = np.zeros((2, 4))
    greedy = np.eye(2)[agent.policy(obs).argmax(axis=1)]
    chances = [np.exp(agent.behaviour.log_prob(obs, act)) for act in (greedy, 1 - greedy)]
    share = agent.settings.noise
    np.testing.assert_allclose(chances, [[1 - share / 2] * 2, [share / 2] * 2])
