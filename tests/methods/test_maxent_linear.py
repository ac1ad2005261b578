"""Linear maximum-entropy IRL climbs to the likelihood's top, or solves for what gradient steps approach."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from envs.gridworld import objectworld
from methods.base import Array, Episodes, Policy, Reward
from methods.maxent import MaxEnt
from methods.maxent_linear import MaxEntLinear, moments
from methods.tabular.maxent import log_likelihood
from methods.tabular.model import demonstrated, finite_soft_value_iteration
from tests.methods.worlds import FiniteWorld, constant

HORIZON, GAMMA = 12, 0.9
TABULAR = objectworld(6, 5, 2, 0.2, np.random.default_rng(3))
MODEL = TABULAR.model
WEIGHTS = np.array([1.0, -0.5, 2.0, -1.0, -2.0, 1.5])


def soft_demonstrations(count: int) -> Episodes:
    """Of the policy that is optimal in return plus entropy under w^T obs."""
    rng = np.random.default_rng(0)
    _, policies = finite_soft_value_iteration(MODEL.P, MODEL.obs @ WEIGHTS, HORIZON, GAMMA)
    obs, act = np.empty((count, HORIZON + 1, 6)), np.zeros((count, HORIZON, 5))
    for i in range(count):
        state = rng.choice(len(MODEL.start), p=MODEL.start)
        obs[i, 0] = MODEL.obs[state]
        for t in range(HORIZON):
            action = rng.choice(5, p=policies[t, state])
            act[i, t, action] = 1
            state = rng.choice(len(MODEL.start), p=MODEL.P[state, action])
            obs[i, t + 1] = MODEL.obs[state]
    return Episodes(tuple(obs), tuple(act), (False,) * count)


@pytest.fixture(scope="module")
def demos() -> Episodes:
    return soft_demonstrations(1000)


def on_states(reward: Reward) -> Array:
    return reward(MODEL.obs, np.zeros((len(MODEL.obs), 5)), MODEL.obs)


def test_a_network_without_hidden_layers_climbs_to_the_same_likelihood_and_policy(demos: Episodes) -> None:
    world: Any = FiniteWorld(replace(TABULAR, features=TABULAR.obs), HORIZON, GAMMA)
    linear = MaxEntLinear(weight_prior=0.0).fit(demos, world, np.random.default_rng(0))
    deep = MaxEnt(layers=(), iterations=600, learning_rate=1e-1).fit(demos, world, np.random.default_rng(0))
    mu_demo = demonstrated(demos, MODEL)
    best, other = (log_likelihood(MODEL, on_states(fit.reward), mu_demo, GAMMA)[0] for fit in (linear, deep))
    truth = log_likelihood(MODEL, MODEL.obs @ WEIGHTS, mu_demo, GAMMA)[0]
    start = log_likelihood(MODEL, np.zeros(len(MODEL.start)), mu_demo, GAMMA)[0]
    assert start < truth - 0.1 < truth <= best
    assert best - 1e-6 < other <= best + 1e-6
    np.testing.assert_array_equal(linear.policy(MODEL.obs), deep.policy(MODEL.obs))


def test_it_finds_the_weights_that_demonstrated(demos: Episodes) -> None:
    world: Any = FiniteWorld(replace(TABULAR, features=TABULAR.obs), HORIZON, GAMMA)
    reward: Any = MaxEntLinear(weight_prior=0.0).fit(demos, world, np.random.default_rng(0)).reward
    np.testing.assert_allclose(reward.w[:-1], WEIGHTS, atol=0.4)
    assert reward.absorbing == 0
    shrunk: Any = MaxEntLinear(weight_prior=1.0).fit(demos, world, np.random.default_rng(0)).reward
    assert np.linalg.norm(shrunk.w) < 0.5 * np.linalg.norm(WEIGHTS)


class Bandit:
    """Observations say nothing; features are the action and its square; `solve` tries a grid of actions."""

    obs_size, act_size, horizon, gamma, solve_steps, model = 1, 1, 10, 0.9, 1000, None

    def __init__(self, lifetime: int = 10) -> None:
        self.lifetime = lifetime
        self.solves: list[tuple[Reward, int, bool, Policy]] = []

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 1))

    def phi(self, obs: Array, act: Array) -> Array:
        return np.concatenate([act, act**2], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs = tuple(np.zeros((self.lifetime + 1, 1)) for _ in range(episodes))
        return Episodes(obs, tuple(policy(o[:-1]) for o in obs), (self.lifetime < self.horizon,) * episodes)

    def agent(self, rng: np.random.Generator, *, init: Any = None, demonstrations: Any = None) -> Any:
        return self

    def learn(self, steps: int, reward: Reward) -> None:
        actions = np.linspace(-1, 1, 41)[:, None]
        best = actions[reward(np.zeros_like(actions), actions, np.zeros_like(actions)).argmax()]
        self.solves.append((reward, steps, bool(self.solves), constant(*best)))

    def best(self, reward: Reward) -> Policy:
        assert reward is self.solves[-1][0]
        return self.solves[-1][3]


@pytest.mark.parametrize("action", [-0.6, 0.85])
def test_on_average_its_policies_match_the_demonstrated_features(action: float) -> None:
    world: Any = Bandit()
    demos = world.rollout(constant(action), 5, np.random.default_rng(0))
    learned = MaxEntLinear(iterations=30, rl_share=0.007).fit(demos, world, np.random.default_rng(0))
    chosen = np.concatenate([policy(np.zeros((1, 1))) for *_, policy in world.solves])
    np.testing.assert_allclose(world.phi(chosen, chosen).mean(axis=0), [action, action**2], atol=0.1)
    (gaps,) = learned.curves.values()
    assert gaps[-1] < 0.1 * gaps[0]
    assert [solve[1:3] for solve in world.solves] == [(7, False), *[(7, True)] * 29]
    assert learned.reward is world.solves[-1][0]
    assert learned.policy is world.solves[-1][3]


@pytest.mark.parametrize(("lifetime", "sign"), [(2, 1), (10, -1)])
def test_what_absorption_pays_is_learned(lifetime: int, sign: int) -> None:
    """Demonstrations terminate after two steps where rollouts live, and the reverse."""
    dies, lives = Bandit(lifetime=2), Bandit()
    demonstrated_in, world = (dies, lives) if lifetime == 2 else (lives, dies)
    demos = demonstrated_in.rollout(constant(0.5), 5, np.random.default_rng(0))
    reward: Any = MaxEntLinear().fit(demos, world, np.random.default_rng(0)).reward
    assert np.sign(reward.absorbing) == sign


def test_moments_count_absorbing_steps_up_to_the_horizon() -> None:
    world: Any = Bandit(lifetime=4)
    mean, second = moments(world.rollout(constant(0.5), 3, np.random.default_rng(0)), world)
    np.testing.assert_allclose(mean, [0.4 * 0.5, 0.4 * 0.25, 0.6])
    np.testing.assert_allclose(
        second, [[0.4 * 0.25, 0.4 * 0.125, 0], [0.4 * 0.125, 0.4 * 0.0625, 0], [0, 0, 0.6]]
    )
