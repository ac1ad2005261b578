"""Adversarial methods where the model is known, whose theory says what they find."""

from __future__ import annotations

import numpy as np
import pytest

from envs.models import Model, Tabular
from methods.base import Array
from methods.gail import GAIL
from methods.tabular.airl import reward_and_potential
from methods.tabular.model import (
    greedy,
    policy_value,
    soft_policy,
    soft_value_iteration,
    state_visitations,
    value_iteration,
)
from tests.methods.worlds import FiniteWorld

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


def acting_in_one_state(seed: int) -> Tabular:
    """Each action leads to one of four states by chance, and one state pays for acting in it."""
    rng = np.random.default_rng(seed)
    P = np.zeros((STATES, ACTIONS, STATES))
    for state in range(STATES):
        for action in range(ACTIONS):
            P[state, action, rng.choice(STATES, 4, replace=False)] = rng.dirichlet(np.ones(4))
    start, obs = np.full(STATES, 1 / STATES), np.eye(STATES)
    return Tabular(P, start, obs, reward=1.0 * (np.arange(STATES) == 3), features=obs)


def play(tabular: Tabular, iterations: int, mean: bool) -> tuple[float, float]:
    """What the best policy under R* misses of the expert's return, a random one missing 1; and by how much R*
    pays it more than the expert, in mean sizes of R*: what is left of the game's duality gap."""
    world = FiniteWorld(tabular, horizon=50, gamma=GAMMA)
    demos = world.rollout(world.optimal(), 20, np.random.default_rng(1))
    game = GAIL(iterations=iterations, reward_steps=20, slope_penalty=0.1, mean=mean)
    learned = game.fit(demos, world, np.random.default_rng(2))
    obs = np.repeat(tabular.obs, ACTIONS, axis=0)
    r = learned.reward(obs, np.tile(np.eye(ACTIONS), (STATES, 1)), obs).reshape(STATES, ACTIONS)
    expert = greedy(value_iteration(tabular.P, tabular.reward, GAMMA)[1])
    best = greedy(value_iteration(tabular.P, r, GAMMA)[1])

    def value(policy: Array, reward: Array) -> float:
        return float(tabular.start @ policy_value(tabular.P, reward, policy, GAMMA))

    truth = [value(p, tabular.reward) for p in (expert, best, np.full((STATES, ACTIONS), 1 / ACTIONS))]
    gap = (1 - GAMMA) * (value(best, r) - value(expert, r)) / np.abs(r).mean()
    return (truth[0] - truth[1]) / (truth[0] - truth[2]), gap


def test_the_mean_reward_makes_the_expert_the_best_and_the_last_may_not() -> None:
    tabulars = [acting_in_one_state(seed) for seed in range(2)]
    short, long, last = (
        np.array([play(tabular, iterations, mean) for tabular in tabulars])
        for iterations, mean in ((3, True), (30, True), (3, False))
    )
    assert long[:, 0].max() < 0.05
    assert long[:, 1].mean() < 0.25 * short[:, 1].mean()
    assert last[:, 0].max() > 0.5


def adversarial(model: Model, actions: bool) -> tuple[Array, Array]:
    """Return g and h of exact demonstrations."""
    return reward_and_potential(shown_in(model), model, GAMMA, HORIZON, actions, steps=1000, rate=0.1)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_reward_of_states_is_the_true_one_up_to_a_constant(seed: int) -> None:
    g, _ = adversarial(leading(seed), actions=False)
    assert np.ptp(g[:, 0] - REWARD) < 0.2
    assert regret(leading(seed + 10), np.broadcast_to(g, (STATES, ACTIONS))) < 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_one_of_states_and_actions_is_the_advantage_and_is_of_no_use_elsewhere(seed: int) -> None:
    model, (v, q) = leading(seed), soft_value_iteration(leading(seed).P, REWARD, GAMMA)
    g, h = adversarial(model, actions=True)
    f = g + GAMMA * model.P @ h - h[:, None]
    assert (shown_in(model) * np.abs(f - (q - v[:, None]))).sum() < 0.01
    assert regret(model, g) < 0.01
    assert regret(leading(seed + 10), g) > 0.9
