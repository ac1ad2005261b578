"""Problems whose solution is known in closed form: linear-quadratic regulators, and reward shaping."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import spearmanr

from methods.base import Array, Episodes, Learned, Policy
from methods.bc import BehaviourCloning
from methods.shaped import Shaped
from methods.shaped_ml import ShapedML, inverse_lqr


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
