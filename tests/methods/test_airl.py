"""AIRL recovers rewards where its theory says so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
import torch

from envs.models import Model, Tabular
from methods.airl import AIRL, Logit, Shaped, as_transitions, described, log_density
from methods.base import ABSORBING_STEPS, Array, Episodes, StochasticPolicy
from methods.network import mlp
from methods.rewards import MeanReward, NetworkReward
from methods.tabular.airl import TabularAIRL
from methods.tabular.model import (
    greedy,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)

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


@pytest.mark.parametrize("seed", [1, 2])
def test_a_reward_of_states_is_the_true_one_up_to_a_constant(seed: int) -> None:
    model = leading(seed)
    g, _ = TabularAIRL(actions=False).reward_and_potential(shown_in(model), model, GAMMA, HORIZON)
    assert np.ptp(g[:, 0] - REWARD) < 0.2
    assert regret(leading(seed + 10), np.broadcast_to(g, (STATES, ACTIONS))) < 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_one_of_states_and_actions_is_the_advantage_and_is_of_no_use_elsewhere(seed: int) -> None:
    model, (v, q) = leading(seed), soft_value_iteration(leading(seed).P, REWARD, GAMMA)
    g, h = TabularAIRL().reward_and_potential(shown_in(model), model, GAMMA, HORIZON)
    f = g + GAMMA * model.P @ h - h[:, None]
    assert (shown_in(model) * np.abs(f - (q - v[:, None]))).sum() < 0.01
    assert regret(model, g) < 0.01
    assert regret(leading(seed + 10), g) > 0.9


def networks(actions: bool) -> tuple[torch.nn.Module, torch.nn.Module]:
    """g and h of three observed numbers and two of an action."""
    generator = torch.Generator().manual_seed(0)
    return mlp(6 if actions else 4, 8, 1, generator=generator), mlp(4, 8, 1, generator=generator)


@pytest.mark.parametrize("actions", [True, False])
def test_the_agent_is_paid_what_tells_demonstrations_apart_but_for_its_density(
    actions: bool, demonstrate: Callable[..., Episodes]
) -> None:
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


def test_steps_of_demonstrations_lead_into_the_absorbing_state_where_they_end(
    demonstrate: Callable[..., Episodes],
) -> None:
    dies = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    assert dies.next_absorbing.tolist() == [*[False] * 2, *[True] * (1 + ABSORBING_STEPS)] * 2
    assert dies.absorbing.tolist() == [*[False] * 3, *[True] * ABSORBING_STEPS] * 2
    lives = demonstrate(lambda obs: obs[:, :2], count=2)
    assert not as_transitions(lives).next_absorbing.any()
    with pytest.raises(ValueError, match="every step is shown"):
        as_transitions(lives.every(2, np.random.default_rng(0)))


def test_densities_count_within_bounds(demonstrate: Callable[..., Episodes]) -> None:
    class Sure:
        """Has a density of e^40 of positive actions, and of e^-40 of others."""

        def log_prob(self, obs: Array, act: Array) -> Array:
            return 40.0 * np.sign(act[:, 0])

    steps = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    logs = log_density(cast(StochasticPolicy, Sure()), steps, uniform=-0.7, most=3.0)
    living = ~steps.absorbing
    np.testing.assert_allclose(logs[living], -0.7 + 3.0 * np.sign(steps.act[living, 0]))
    np.testing.assert_array_equal(logs[~living], -0.7)


def test_it_plays_with_a_soft_agent_and_returns_the_mean(
    world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    demos = demonstrate(lambda obs: obs[:, :2])
    learned = AIRL(iterations=3, reward_steps=20).fit(demos, world, np.random.default_rng(0))
    assert world.given == [{"kind": "stochastic", "entropy": 1.0}]
    payments = [payment for payment, _, _ in world.solves]
    assert [type(payment) for payment in payments] == [Shaped] * 3 + [MeanReward]
    assert learned.reward is payments[-1]
    assert len(payments[-1].rewards) == 3


def test_the_reward_of_a_fit_is_the_true_one_where_the_model_is_known(finite_world: Any) -> None:
    model = leading(1)
    world = finite_world(
        Tabular(model.P, model.start, model.obs, REWARD, features=model.obs), horizon=HORIZON, gamma=GAMMA
    )
    chances, drawn = soft_policy(soft_value_iteration(model.P, REWARD, GAMMA)[1]), np.random.default_rng(4)

    def draw(obs: Array) -> Array:
        likely = chances[model.states(obs)].cumsum(axis=1)
        return np.eye(ACTIONS)[(drawn.random((len(obs), 1)) < likely).argmax(axis=1)]

    demos = world.rollout(draw, 400, np.random.default_rng(1))
    learned = AIRL(actions=False).fit(demos, world, np.random.default_rng(0))
    assert np.corrcoef(learned.reward.values[:, 0], REWARD)[0, 1] > 0.95
    # Of a part of the steps it is the same, for shares are what counts.
    part = AIRL(actions=False).fit(demos.every(5, np.random.default_rng(0)), world, np.random.default_rng(0))
    assert np.corrcoef(part.reward.values[:, 0], REWARD)[0, 1] > 0.95


def test_demonstrated_states_pay_more(world: Any) -> None:
    rng = np.random.default_rng(0)
    obs = tuple(np.abs(rng.uniform(-1, 1, (21, 3))) for _ in range(20))
    demos = Episodes(obs, tuple(np.zeros((20, 2)) for _ in obs), (False,) * 20)
    learned = AIRL(iterations=3, actions=False).fit(demos, world, np.random.default_rng(0))
    there, act = np.full((1, 3), 0.5), np.zeros((1, 2))
    assert learned.reward(there, act, there)[0] > learned.reward(-there, act, there)[0] + 0.3


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


def test_an_end_that_is_shown_pays_more_than_one_that_is_not(
    world: Any, mortal_world: Any, demonstrate: Callable[..., Episodes]
) -> None:
    def absorbing(lifetime: int, where: Any) -> float:
        """What it pays, above a step elsewhere."""
        demos = demonstrate(lambda obs: 0 * obs[:, :2], lifetime=lifetime)
        method = AIRL(iterations=3, actions=False)
        reward = method.fit(demos, where, np.random.default_rng(0)).reward
        at = np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 3))
        return float(reward.absorbing - reward(*at)[0])

    assert absorbing(10, mortal_world) < 0 < absorbing(2, world)
