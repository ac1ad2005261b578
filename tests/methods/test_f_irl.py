"""f-IRL descends the divergence between what is visited and what is shown."""

from __future__ import annotations

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
from tests.methods.worlds import FiniteWorld

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
    counts = np.zeros((10_000, HORIZON, STATES + 1))
    states = np.zeros(len(counts), int)
    for t in range(HORIZON):
        counts[np.arange(len(counts)), t, states] = 1
        choices = (rng.random((len(counts), 1)) < policies[t][states].cumsum(axis=1)).argmax(axis=1)
        states = model.P[states, choices].argmax(axis=1)
    weighted = weigh([(rows, np.ones(HORIZON)) for rows in counts], logit)
    estimate = (weighted[:, -1:] * weighted[:, :STATES]).mean(axis=0)
    gradient = forward_divergence(model, r, shown, HORIZON, 1.0)[1]
    assert np.corrcoef(estimate, -gradient)[0, 1] > 0.98


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


def test_where_the_model_is_known_it_visits_what_is_shown() -> None:
    tabular = grid(SIZE, 0.3)
    world = FiniteWorld(tabular, horizon=30, gamma=GAMMA)
    soft = soft_policy(8 * value_iteration(tabular.P, tabular.reward, GAMMA)[1])
    demos = world.rollout(world.drawn(soft, np.random.default_rng(4)), 200, np.random.default_rng(1))
    learned: Any = FIRL().fit(demos, world, np.random.default_rng(0))
    divergences = learned.curves["divergence"]
    assert divergences[-1] < 0.02 < 0.3 < divergences[0]
    best, found = (
        greedy(value_iteration(tabular.P, r, GAMMA)[1]) for r in (tabular.reward, learned.reward.values)
    )
    truth = [tabular.start @ policy_value(tabular.P, tabular.reward, p, GAMMA) for p in (best, found)]
    assert truth[1] > 0.98 * truth[0]
