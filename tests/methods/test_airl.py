"""AIRL pays f, and where its theory holds it finds the true reward."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from envs.models import Model
from methods.airl import AIRL, Logit, Shaped, as_transitions, described
from methods.base import ABSORBING_STEPS, Array, Episodes
from methods.network import mlp
from methods.rewards import NetworkReward
from methods.tabular.airl import reward_and_potential
from methods.tabular.model import (
    greedy,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)
from tests.methods.worlds import demonstrate

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


def test_what_the_agent_is_sure_of_tells_less(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """f makes up for its density: of steps that are alike but for how sure the agent is of them, f is higher
    where it is surer."""

    def log_prob(self: object, obs: Array, act: Array) -> Array:
        return np.where(obs[:, 0] > 0, 1.5, -1.5)

    monkeypatch.setattr("methods.stochastic.SquashedGaussian.log_prob", log_prob)
    rng = np.random.default_rng(0)
    obs = tuple(rng.uniform(-1, 1, (21, 3)) for _ in range(20))
    demos = Episodes(obs, tuple(rng.uniform(-1, 1, (20, 2)) for _ in obs), (False,) * 20)
    method = AIRL(iterations=3, actions=False, slope_penalty=0.01, reward_steps=500)
    learned = method.fit(demos, world, np.random.default_rng(0))
    sure, act = np.tile([[0.5, 0.0, 0.0]], (1, 1)), np.zeros((1, 2))
    assert learned.reward(sure, act, sure)[0] > learned.reward(-sure, act, -sure)[0] + 1
