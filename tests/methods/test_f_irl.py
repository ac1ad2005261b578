"""f-IRL descends the divergence between what is visited and what is shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from envs.gridworld import grid
from methods.base import ABSORBING_STEPS, Array, Episodes
from methods.f_irl import FIRL, trajectory, weigh
from methods.tabular.f_irl import forward_divergence
from methods.tabular.model import (
    finite_soft_value_iteration,
    greedy,
    policy_value,
    soft_policy,
    state_visitations,
    value_iteration,
)

pytestmark = pytest.mark.usefixtures("fused_adam")
SIZE, HORIZON, GAMMA = 4, 12, 0.9
STATES = SIZE**2


@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_the_gradient_is_that_of_the_divergence(slip: float) -> None:
    model, rng = grid(SIZE, slip).model, np.random.default_rng(0)
    r, shown = rng.normal(size=STATES), rng.dirichlet(np.ones(STATES - 1))
    shown = np.append(shown, 0)  # one state is not shown

    def divergence(r: Array) -> float:
        return forward_divergence(model, r, shown, HORIZON, GAMMA)[0]

    steps = 1e-5 * np.eye(STATES)
    differences = [(divergence(r + step) - divergence(r - step)) / 2e-5 for step in steps]
    gradient = forward_divergence(model, r, shown, HORIZON, GAMMA)[1]
    np.testing.assert_allclose(gradient, differences, atol=1e-8)
    assert np.abs(gradient).max() > 0.05


def test_trajectories_weighed_by_their_ratios_estimate_it() -> None:
    """As theorem 4.1 has it, without chance in the dynamics nor in where they start."""
    model, rng = replace(grid(SIZE, 0.0).model, start=np.eye(STATES)[0]), np.random.default_rng(0)
    r = rng.normal(size=STATES)
    _, policies = finite_soft_value_iteration(model.P, r, HORIZON)
    rho = state_visitations(model.P, policies, model.start, HORIZON).mean(axis=0)
    shown = rho * np.exp(rng.uniform(-2, 2, STATES))
    shown /= shown.sum()
    logit = torch.nn.Linear(STATES + 1, 1, bias=False)
    with torch.no_grad():
        logit.weight[0] = torch.as_tensor(np.append(np.log(shown / rho.clip(1e-9)), 0))
    counts = np.zeros((20_000, HORIZON, STATES + 1))
    states = np.zeros(len(counts), int)
    for t in range(HORIZON):
        counts[np.arange(len(counts)), t, states] = 1
        choices = (rng.random((len(counts), 1)) < policies[t][states].cumsum(axis=1)).argmax(axis=1)
        states = model.P[states, choices].argmax(axis=1)
    weighted = weigh([(rows, np.ones(HORIZON)) for rows in counts], logit)
    estimate = (weighted[:, -1:] * weighted[:, :STATES]).mean(axis=0)
    gradient = forward_divergence(model, r, shown, HORIZON, 1.0)[1]
    assert np.corrcoef(estimate, -gradient)[0, 1] > 0.98


def first_entry() -> torch.nn.Module:
    """A logit of two entries that is the first."""
    logit = torch.nn.Linear(2, 1, bias=False)
    with torch.no_grad():
        logit.weight[0] = torch.tensor([1.0, 0.0])
    return logit


def test_long_trajectories_count_as_short_ones_and_steps_by_their_number() -> None:
    likely, unlikely = np.array([[1.0, 0]] * 6), np.array([[-1.0, 0]] * 2)
    weighted = weigh([(likely, np.ones(6)), (unlikely, np.ones(2))], first_entry())
    assert weighted[:6, -1].sum() == pytest.approx(-weighted[6:, -1].sum())
    assert weighted[0, -1] > 0 > weighted[-1, -1]
    weighted = weigh([(likely[:2], np.array([1.0, 3.0])), (unlikely, np.ones(2))], first_entry())
    assert weighted[1, -1] == pytest.approx(3 * weighted[0, -1])


@pytest.mark.parametrize("every", [1, 4])
def test_an_end_counts_beside_all_steps_whether_they_are_shown_or_not(every: int) -> None:
    obs, act = np.random.default_rng(0).normal(size=(41, 3)), np.zeros((40, 2))
    ended = Episodes((obs,), (act,), (True,))
    shown = ended if every == 1 else ended.every(every, np.random.default_rng(0))
    rows, counts = trajectory(shown, np.zeros(3), np.ones(3))
    np.testing.assert_array_equal(rows[-1], [0, 0, 0, 1])
    assert counts[-1] / counts[:-1].sum() == pytest.approx(ABSORBING_STEPS / 40)
    lives = Episodes((obs,), (act,), (False,))
    assert trajectory(lives, np.zeros(3), np.ones(3))[0][:, -1].max() == 0


def test_where_the_model_is_known_it_visits_what_is_shown(finite_world: Any) -> None:
    tabular = grid(SIZE, 0.3)
    world = finite_world(tabular, horizon=30, gamma=GAMMA)
    soft = soft_policy(8 * value_iteration(tabular.P, tabular.reward, GAMMA)[1])
    drawn = np.random.default_rng(4)

    def draw(obs: Array) -> Array:
        chances = soft[tabular.states(obs)].cumsum(axis=1)
        return np.eye(5)[(drawn.random((len(obs), 1)) < chances).argmax(axis=1)]

    demos = world.rollout(draw, 200, np.random.default_rng(1))
    learned = FIRL().fit(demos, world, np.random.default_rng(0))
    divergences = learned.curves["divergence"]
    assert divergences[-1] < 0.02 < 0.3 < divergences[0]
    best, found = (
        greedy(value_iteration(tabular.P, r, GAMMA)[1]) for r in (tabular.reward, learned.reward.values)
    )
    truth = [tabular.start @ policy_value(tabular.P, tabular.reward, p, GAMMA) for p in (best, found)]
    assert truth[1] > 0.98 * truth[0]


def test_a_penalty_on_its_slope_makes_the_reward_flat(
    world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    def spread(slope_penalty: float) -> float:
        method = FIRL(iterations=2, slope_penalty=slope_penalty)
        reward = method.fit(demonstrate(lambda o: o[:, :2]), world, np.random.default_rng(0)).reward
        obs = np.random.default_rng(1).uniform(-1, 1, (100, 3))
        return float(np.ptp(reward(obs, obs[:, :2], obs)))

    assert spread(100.0) < 0.2 * spread(0.0)


def test_its_trajectories_are_of_what_the_agent_explores_with(
    world: Any, demonstrate: Callable[..., Episodes], monkeypatch: pytest.MonkeyPatch
) -> None:
    sampled: list[int] = []

    def draw(self: object, obs: Array, rng: np.random.Generator) -> Array:
        sampled.append(len(obs))
        return np.zeros((len(obs), 2))

    monkeypatch.setattr("methods.stochastic.SquashedGaussian.sample", draw)
    method = FIRL(iterations=2, rollouts=3, reward_steps=5)
    method.fit(demonstrate(lambda obs: obs[:, :2]), world, np.random.default_rng(0))
    assert len(sampled) == 2 * 3  # of each iteration, each episode


def test_demonstrated_states_pay_more(world: Any) -> None:
    rng = np.random.default_rng(0)
    obs = tuple(np.abs(rng.uniform(-1, 1, (21, 3))) for _ in range(5))
    demos = Episodes(obs, tuple(np.zeros((20, 2)) for _ in obs), (False,) * 5)
    method = FIRL(iterations=3, reward_steps=100)
    learned = method.fit(demos, world, np.random.default_rng(0))
    assert world.given == [{"kind": "stochastic"}]
    there, act = np.full((1, 3), 0.5), np.zeros((1, 2))
    assert learned.reward(there, act, there)[0] > learned.reward(-there, act, there)[0] + 0.3
    assert learned.reward(there, act, there) == learned.reward(there, act + 0.7, there)


def test_an_end_that_is_shown_pays_more_than_one_that_is_not(
    world: Any, mortal_world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    def absorbing(lifetime: int, where: Any) -> float:
        """What it pays, above a step elsewhere."""
        demos = demonstrate(lambda obs: 0 * obs[:, :2], lifetime=lifetime)
        reward = FIRL(iterations=3).fit(demos, where, np.random.default_rng(0)).reward
        at = np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 3))
        return float(reward.absorbing - reward(*at)[0])

    assert absorbing(10, mortal_world) < 0 < absorbing(2, world)
