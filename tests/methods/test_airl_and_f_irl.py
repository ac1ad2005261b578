"""AIRL and f-IRL find the reward, or its gradient, that their theory says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from envs.gridworld import grid
from envs.models import Model
from methods.airl import Logit, Shaped, as_transitions, described
from methods.base import ABSORBING_STEPS, Array, Episodes
from methods.f_irl import FIRL, trajectory, weigh
from methods.network import mlp
from methods.rewards import NetworkReward
from methods.tabular.airl import reward_and_potential
from methods.tabular.f_irl import forward_divergence
from methods.tabular.model import (
    finite_soft_value_iteration,
    greedy,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)
from tests.methods.worlds import FiniteWorld, demonstrate

pytestmark = pytest.mark.usefixtures("fused_adam")
STATES, ACTIONS, GAMMA, HORIZON = 16, 4, 0.9, 50
REWARD = 3.0 * (np.arange(STATES) == 3)


def leading(seed: int) -> Model:
    """Each action of each state leads to one state, drawn by chance."""
    P = np.eye(STATES)[np.random.default_rng(seed).integers(STATES, size=(STATES, ACTIONS))]
    return Model(P, np.full(STATES, 1 / STATES), np.eye(STATES))


def shown_in(model: Model) -> Array:
    """(S, A): what the soft-optimal policy of the true reward visits."""
    policy = soft_policy(soft_value_iteration(model.P, REWARD, GAMMA)[1])
    return state_visitations(model.P, policy, model.start, HORIZON).mean(axis=0)[:, None] * policy


def regret(model: Model, r: Array) -> float:
    """What the best policy of r misses of the best one's true return, a random one missing 1."""
    best, found = (greedy(value_iteration(model.P, reward, GAMMA)[1]) for reward in (REWARD, r))
    random = np.full((STATES, ACTIONS), 1 / ACTIONS)
    truth = [float(model.start @ policy_value(model.P, REWARD, p, GAMMA)) for p in (best, found, random)]
    return (truth[0] - truth[1]) / (truth[0] - truth[2])


def adversarial(model: Model, actions: bool) -> tuple[Array, Array]:
    """Return g and h of exact demonstrations."""
    return reward_and_potential(shown_in(model), model, GAMMA, HORIZON, actions, steps=700, rate=0.1)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_reward_of_states_is_the_true_one_up_to_a_constant(seed: int) -> None:
    g, _ = adversarial(leading(seed), actions=False)
    assert np.ptp(g[:, 0] - REWARD) < 0.2
    assert regret(leading(seed + 10), np.broadcast_to(g, (STATES, ACTIONS))) < 0.01


def test_one_of_states_and_actions_is_the_advantage_and_is_of_no_use_elsewhere() -> None:
    model, (v, q) = leading(1), soft_value_iteration(leading(1).P, REWARD, GAMMA)
    g, h = adversarial(model, actions=True)
    f = g + GAMMA * model.P @ h - h[:, None]
    assert (shown_in(model) * np.abs(f - (q - v[:, None]))).sum() < 0.01
    assert regret(model, g) < 0.01
    assert regret(leading(11), g) > 0.9


def networks(actions: bool) -> tuple[torch.nn.Module, torch.nn.Module]:
    """g and h of three observed numbers and two of an action."""
    generator = torch.Generator().manual_seed(0)
    return mlp(6 if actions else 4, 8, 1, generator=generator), mlp(4, 8, 1, generator=generator)


@pytest.mark.parametrize("actions", [True, False])
def test_the_agent_is_paid_what_tells_demonstrations_apart_but_for_its_density(actions: bool) -> None:
    g, h = networks(actions)
    mean, std = np.array([0.2, -0.1, 0.0]), np.array([0.5, 1.0, 2.0])
    steps = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    logs = np.linspace(-2, 2, len(steps))
    with torch.no_grad():
        rows = torch.as_tensor(described(steps, logs, mean, std, actions), dtype=torch.float32)
        logit = Logit(g, h, GAMMA)(rows)[:, 0].numpy()
    paid = Shaped(
        NetworkReward.of(g, mean, std, actions=actions), NetworkReward.of(h, mean, std, actions=False), GAMMA
    )
    np.testing.assert_allclose(paid(steps), logit + logs, atol=1e-5)
    # Once there, nothing is gained.
    assert paid(steps)[steps.absorbing] == pytest.approx(paid.g.absorbing)


def test_steps_of_demonstrations_lead_into_the_absorbing_state_where_they_end() -> None:
    dies = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    assert dies.next_absorbing.tolist() == [*[False] * 2, *[True] * (1 + ABSORBING_STEPS)] * 2
    assert dies.absorbing.tolist() == [*[False] * 3, *[True] * ABSORBING_STEPS] * 2
    lives = demonstrate(lambda obs: obs[:, :2], count=2)
    assert not as_transitions(lives).next_absorbing.any()
    with pytest.raises(ValueError, match="every step is shown"):
        as_transitions(lives.every(2, np.random.default_rng(0)))


SIZE, LENGTH = 4, 12
CELLS = SIZE**2


@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_the_gradient_is_that_of_the_divergence(slip: float) -> None:
    model, rng = grid(SIZE, slip).model, np.random.default_rng(0)
    r, shown = rng.normal(size=CELLS), rng.dirichlet(np.ones(CELLS - 1))
    shown = np.append(shown, 0)  # one state is not shown

    def divergence(r: Array) -> float:
        return forward_divergence(model, r, shown, LENGTH, GAMMA)[0]

    steps = 1e-5 * np.eye(CELLS)
    differences = [(divergence(r + step) - divergence(r - step)) / 2e-5 for step in steps]
    gradient = forward_divergence(model, r, shown, LENGTH, GAMMA)[1]
    np.testing.assert_allclose(gradient, differences, atol=1e-8)
    assert np.abs(gradient).max() > 0.05


def test_trajectories_weighed_by_their_ratios_estimate_it() -> None:
    """As theorem 4.1 has it, without chance in the dynamics nor in where they start."""
    model, rng = replace(grid(SIZE, 0.0).model, start=np.eye(CELLS)[0]), np.random.default_rng(0)
    r = rng.normal(size=CELLS)
    _, policies = finite_soft_value_iteration(model.P, r, LENGTH)
    rho = state_visitations(model.P, policies, model.start, LENGTH).mean(axis=0)
    shown = rho * np.exp(rng.uniform(-2, 2, CELLS))
    shown /= shown.sum()
    logit = torch.nn.Linear(CELLS + 1, 1, bias=False)
    with torch.no_grad():
        logit.weight[0] = torch.as_tensor(np.append(np.log(shown / rho.clip(1e-9)), 0))
    counts = np.zeros((10_000, LENGTH, CELLS + 1))
    states = np.zeros(len(counts), int)
    for t in range(LENGTH):
        counts[np.arange(len(counts)), t, states] = 1
        choices = (rng.random((len(counts), 1)) < policies[t][states].cumsum(axis=1)).argmax(axis=1)
        states = model.P[states, choices].argmax(axis=1)
    weighted = weigh([(rows, np.ones(LENGTH)) for rows in counts], logit)
    estimate = (weighted[:, -1:] * weighted[:, :CELLS]).mean(axis=0)
    gradient = forward_divergence(model, r, shown, LENGTH, 1.0)[1]
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
