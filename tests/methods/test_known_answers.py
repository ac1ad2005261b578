"""Cloning and shaped rewards: regulators whose solution is known, equation 4.3, and rankings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.stats import spearmanr

from methods.base import Array, Episodes, Learned, Policy
from methods.bc import BehaviourCloning
from methods.network import Network, mlp
from methods.shaped import Shaped, ShapedReward, shaped_reward
from methods.shaped_ml import ShapedML, inverse_lqr
from methods.shaped_ranked import ShapedRanked
from tests.methods.worlds import FakeWorld, constant, demonstrate


class Regulator:
    """x' = A x + B u, which costs x^T Q x + u^T R u; without noise, discount or end. Starts are uniform."""

    obs_size, act_size, horizon, gamma, model = 3, 2, 5, 0.99, None
    A = np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.2], [0.1, 0.0, 0.9]])
    B = np.array([[0.1, 0.0], [0.5, 0.1], [0.2, 0.4]])

    def __init__(self, Q: Array, R: Array) -> None:
        self.Q, self.R = Q, R
        self.P = solve_discrete_are(self.A, self.B, Q, R)
        self.M = R + self.B.T @ self.P @ self.B
        self.K = np.linalg.solve(self.M, self.B.T @ self.P @ self.A)

    def expert(self, x: Array) -> Array:
        return -x @ self.K.T

    def step(self, x: Array, u: Array) -> Array:
        return x @ self.A.T + u @ self.B.T

    def advantage(self, x: Array, u: Array) -> Array:
        return -quadratic(u - self.expert(x), self.M)

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs, act = [rng.uniform(-0.3, 0.3, (episodes, 3))], []
        for _ in range(self.horizon):
            act.append(policy(obs[-1]))
            obs.append(self.step(obs[-1], act[-1]))
        return Episodes(tuple(np.stack(obs, axis=1)), tuple(np.stack(act, axis=1)), (False,) * episodes)

    def demonstrations(self, seed: int) -> Episodes:
        return self.rollout(self.expert, 400, np.random.default_rng(seed))


def quadratic(x: Array, matrix: Array) -> Array:
    value: Array = np.einsum("bi,ij,bj->b", x, matrix, x)
    return value


REGULATOR = Regulator(np.eye(3), np.diag([4.0, 0.3]))
WORLD: Any = REGULATOR
HELD_OUT = REGULATOR.demonstrations(seed=1).pairs()[0]
UNIFORM = np.random.default_rng(2).uniform(-1, 1, (len(HELD_OUT), 2))


def correlation(learned: Learned, regulator: Regulator = REGULATOR) -> float:
    """Spearman's, of R* and the true advantage at held-out demonstrated states and uniform actions."""
    obs = regulator.demonstrations(seed=1).pairs()[0]
    assert learned.reward is not None
    found = learned.reward(obs, UNIFORM, obs)
    return float(spearmanr(found, regulator.advantage(obs, UNIFORM)).statistic)


def test_cloning_recovers_the_regulators_feedback() -> None:
    demos = REGULATOR.demonstrations(seed=0)
    learned = BehaviourCloning(steps=1000).fit(demos, WORLD, np.random.default_rng(0))
    error = np.abs(learned.policy(HELD_OUT) - REGULATOR.expert(HELD_OUT))
    assert error.mean() < 1e-3
    assert error.max() < 0.05


@pytest.fixture(scope="module")
def shaped() -> Learned:
    method = Shaped(steps=600)
    return method.fit(REGULATOR.demonstrations(seed=0), WORLD, np.random.default_rng(0))


@pytest.mark.parametrize("method", [BehaviourCloning(steps=800), Shaped(steps=800)])
def test_an_expert_that_hardly_moves_is_cloned_as_well(method: Any) -> None:
    centre, size = 0.5, 1e-4
    demos = REGULATOR.demonstrations(seed=0)
    small = replace(demos, act=tuple(centre + size * act for act in demos.act))
    learned = method.fit(small, WORLD, np.random.default_rng(0))
    error = np.abs(learned.policy(HELD_OUT) - centre - size * REGULATOR.expert(HELD_OUT))
    assert error.mean() < 1e-2 * size


def test_shaped_recovers_the_regulators_feedback_and_pays_it_0(shaped: Learned) -> None:
    best = REGULATOR.expert(HELD_OUT)
    error = np.abs(shaped.policy(HELD_OUT) - best)
    assert error.mean() < 2e-3
    assert error.max() < 0.05
    assert shaped.reward is not None
    paid = shaped.reward(HELD_OUT, best, HELD_OUT)
    assert -5e-3 < paid.min() <= paid.max() <= 0
    assert (shaped.reward(HELD_OUT, UNIFORM, HELD_OUT) < paid).all()


@pytest.mark.parametrize("seed", range(3))
def test_an_inverse_regulator_finds_the_hessian_of_a_cost_of_squares(seed: int) -> None:
    """From the feedback and the dynamics alone, up to scale: six equations for five costs."""
    rng = np.random.default_rng(seed)
    cost = np.exp(1.5 * rng.normal(size=5))
    truth = Regulator(np.diag(cost[:3]), np.diag(cost[3:]))
    x = rng.normal(size=(50, 3))
    found = inverse_lqr(truth.A, truth.B, truth.K, x, gamma=1.0, prior=1e-10)
    np.testing.assert_allclose(found / np.trace(found), truth.M / np.trace(truth.M), atol=1e-4)


def test_likelihood_finds_the_advantage_of_demonstrations_without_noise(
    shaped: Learned,
) -> None:
    demos = REGULATOR.demonstrations(seed=0)
    shaped_ml = ShapedML(steps=600).fit(demos, WORLD, np.random.default_rng(0))
    assert correlation(shaped_ml) > 0.98 > 0.9 > correlation(shaped)
    np.testing.assert_array_equal(shaped_ml.policy(HELD_OUT), shaped.policy(HELD_OUT))


SIZES = st.integers(1, 4)
SEEDS = st.integers(0, 2**31)


def random_reward(obs_size: int, act_size: int, seed: int, scale: float = 3.0) -> ShapedReward:
    generator = torch.Generator().manual_seed(seed)
    f = mlp(obs_size, 7, act_size, generator=generator)
    chol = mlp(obs_size, 6, act_size**2, generator=generator)
    with torch.no_grad():
        for parameter in [*f.parameters(), *chol.parameters()]:
            parameter.mul_(scale)
    mean, std = np.full(obs_size, 0.2), np.full(obs_size, 0.5)
    return ShapedReward(Network.from_torch(f, mean, std, tanh=True), Network.from_torch(chol, mean, std))


@given(SIZES, SIZES, SEEDS)
@settings(deadline=None, max_examples=25)
def test_it_is_equation_4_3_in_numpy_and_in_torch(obs_size: int, act_size: int, seed: int) -> None:
    reward = random_reward(obs_size, act_size, seed)
    rng = np.random.default_rng(seed)
    obs, act = rng.normal(size=(6, obs_size)), rng.uniform(-1, 1, (6, act_size))
    expected = []
    for s, a in zip(obs, act, strict=True):
        chol = reward.chol(s[None])[0].reshape(act_size, act_size)
        matrix = chol @ chol.T + np.eye(act_size)
        assert np.linalg.eigvalsh(matrix).min() >= 1 - 1e-9
        d = a - reward.f(s[None])[0]
        expected.append(-d @ matrix @ d)
    np.testing.assert_allclose(reward(obs, act, obs), expected, rtol=1e-9)
    tensors = (torch.as_tensor(x) for x in (act, reward.f(obs), reward.chol(obs)))
    np.testing.assert_allclose(shaped_reward(*tensors).numpy(), expected, rtol=1e-9)
    np.testing.assert_array_equal(reward(obs, reward.f(obs), obs), 0)


def test_the_reward_far_from_the_demonstrations_is_no_cliff() -> None:
    demos = demonstrate(lambda obs: 0.5 * obs[:, :2], count=20)
    narrow = Episodes(tuple(1e-2 * obs for obs in demos.obs), demos.act, demos.terminated)
    reward = Shaped(steps=300).fit(narrow, FakeWorld(), np.random.default_rng(0)).reward
    assert isinstance(reward, ShapedReward)
    # Even a hundred of the demonstrations' spreads away L is smaller than the identity beside it.
    assert np.abs(reward.chol(100 * narrow.pairs()[0])).max() < 1


FITS: dict[str, Any] = {"steps": 300}
METHOD = ShapedRanked(**FITS, levels=(0.0, 0.5, 1.0), rollouts=10, reward_steps=200)


class Line:
    """A world whose observation (3,) begins with the last action's first entry."""

    obs_size, act_size, horizon, gamma, solve_steps, model = 3, 2, 10, 0.9, 30, None

    def __init__(self, mortal: bool = False) -> None:
        self.mortal = mortal
        """Whether a negative first entry of an action ends the episode."""
        self.learned: list[int] = []

    def agent(self, rng: np.random.Generator) -> Any:
        """Return an agent that always ends in the action 1."""
        policy = constant(1.0, 0.0)
        return SimpleNamespace(learn=lambda steps, reward: self.learned.append(steps), policy=policy)

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 2))

    def rollout(self, policy: Callable[[Array], Array], episodes: int, rng: np.random.Generator) -> Episodes:
        obs, act = [], []
        for _ in range(episodes):
            seen, done = [rng.normal(0, 0.1, 3)], list[Array]()
            while len(done) < self.horizon and not (self.mortal and done and done[-1][0] < 0):
                done.append(policy(seen[-1][None])[0])
                seen.append(np.append(done[-1][0], rng.normal(0, 0.1, 2)))
            obs.append(np.array(seen))
            act.append(np.array(done))
        died = tuple(self.mortal and bool(its[-1, 0] < 0) for its in act)
        return Episodes(tuple(obs), tuple(act), died)


LINE: Any = Line()
DEMOS = LINE.rollout(constant(0.7, 0.0), 5, np.random.default_rng(0))


def at(x: float) -> tuple[Array, Array, Array]:
    obs = np.tile([x, 0.0, 0.0], (1, 1))
    return obs, np.zeros((1, 2)), obs


@pytest.fixture(scope="module")
def ranked() -> Learned:
    return METHOD.fit(DEMOS, LINE, np.random.default_rng(2))


def test_its_reward_prefers_demonstrated_states_whatever_the_action(ranked: Any) -> None:
    reward = ranked.reward
    values = [reward(*at(x))[0] for x in (0.7, 0.0, -0.7)]
    assert values[0] > values[1] + 0.2
    assert values[0] > values[2] + 0.5
    obs, act, after = at(0.7)
    assert reward(obs, act + 0.9, after) == reward(obs, act, after)
    assert -1 <= min(values) <= max(values) <= 1


def test_what_reinforcement_learning_finds_pays_less(ranked: Any) -> None:
    LINE.learned.clear()
    after: Any = replace(METHOD, rl_rounds=2).fit(DEMOS, LINE, np.random.default_rng(2)).reward
    assert LINE.learned == [30, 30]
    assert ranked.reward(*at(1.0)) > ranked.reward(*at(0.0))
    assert after(*at(1.0)) < after(*at(0.7)) - 0.5


@pytest.mark.parametrize("every", [1, 4])
def test_where_noise_kills_death_pays_less(every: int) -> None:
    world: Any = Line(mortal=True)
    demos = world.rollout(constant(0.7, 0.0), 5, np.random.default_rng(0)).every(
        every, np.random.default_rng(3)
    )
    reward: Any = METHOD.fit(demos, world, np.random.default_rng(2)).reward
    assert reward.absorbing < reward(*at(0.7))[0] - 0.2
