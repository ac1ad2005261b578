"""Games of a discriminator against an agent, and what all of them promise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from envs.models import Tabular
from harness.rl.exact import expected_rewards
from methods.adversarial import Game
from methods.airl import AIRL
from methods.base import Array, Episodes, Transitions
from methods.f_irl import FIRL
from methods.gaifo import GAIfO
from methods.gail import GAIL
from methods.maxent import MaxEnt
from methods.maxent_linear import MaxEntLinear
from methods.maxmargin import MaxMargin
from methods.network import mlp
from methods.tabular.model import (
    greedy,
    policy_value,
    value_iteration,
)
from tests.methods.worlds import FakeAgent, FiniteWorld, constant, demonstrate

pytestmark = pytest.mark.usefixtures("fused_adam")


def test_the_logit_is_the_logarithm_of_the_densities_ratio(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)

    def acts(count: int, rising: float) -> Array:
        """First entries rise in density by that share from one half of their range to the other."""
        size = np.where(rng.random(count) < 0.5 + rising / 2, 1, -1) * rng.random(count)
        return np.column_stack([size, rng.uniform(-1, 1, count)])

    own, alive = acts(20_000, -0.6), np.zeros(20_000, bool)
    places = rng.uniform(-1, 1, (20_000, 3))
    seen = Transitions.own(places, own, places, alive, alive)
    monkeypatch.setattr(FakeAgent, "replay", lambda self: seen)
    shown = Episodes((rng.uniform(-1, 1, (20_001, 3)),), (acts(20_000, 0.6),), (False,))
    method = GAIL(iterations=4, reward_steps=500, latest=20_000, slope_penalty=0.0)
    reward = method.fit(shown, world, rng).reward
    obs = rng.uniform(-0.8, 0.8, (400, 3))
    for side in (1, -1):
        paid = reward(obs, np.column_stack([side * rng.uniform(0.2, 0.9, 400), 0 * obs[:, :1]]), obs)
        assert paid.mean() == pytest.approx(side * np.log(0.8 / 0.2), abs=0.15)


def test_gaifos_logit_is_the_logarithm_of_the_ratio_of_steps_and_sees_no_action(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The agent leaves the states that are demonstrated for others. Only where it goes tells them apart."""
    rng, count = np.random.default_rng(0), 20_000

    def places(positive: float) -> Array:
        """First entries are positive by that share."""
        sign = np.where(rng.random(count + 1) < positive, 1, -1)
        return np.column_stack([sign * rng.random(count + 1), rng.uniform(-1, 1, (count + 1, 2))])

    alive, act = np.zeros(count, bool), rng.uniform(-1, 1, (count, 2))
    seen = Transitions.own(places(0.8)[1:], act, places(0.2)[1:], alive, alive)
    monkeypatch.setattr(FakeAgent, "replay", lambda self: seen)
    shown = Episodes((places(0.8),), (act[:, :0],), (False,))
    method = GAIfO(iterations=6, reward_steps=500, latest=count, slope_penalty=0.0)
    reward = method.fit(shown, world, rng).reward
    obs, after = (rng.uniform(-0.8, 0.8, (400, 3)) for _ in range(2))
    for side in (1, -1):
        after[:, 0] = side * rng.uniform(0.2, 0.9, 400)
        paid = reward(obs, act[:400], after)
        assert paid.mean() == pytest.approx(side * np.log(0.8 / 0.2), abs=0.2)
        np.testing.assert_array_equal(paid, reward(obs, -act[:400], after))


def test_an_end_pays_less_than_a_fall() -> None:
    """Demonstrations stay about the mean of observations, where the absorbing state's zeros are as well;
    what falls leaves it, and ends."""
    rng, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    falling = rng.normal(0, 0.1, (500, 3)) + rng.uniform(0, 3, (500, 1))
    ends = np.tile([0.0, 0.0, 0.0, 1.0], (500, 1))
    shown, own = (np.pad(rows, ((0, 0), (0, 1))) for rows in (rng.normal(0, 0.1, (1000, 3)), falling))
    game = Game(reward_steps=400)
    discriminator = game.discriminator(mlp(4, *game.layers, 1, generator=generator), generator)
    discriminator.learn(shown, np.concatenate([own, ends]), rng)
    with torch.no_grad():
        logits = discriminator.logit(torch.as_tensor(np.vstack([own, ends[:1]]), dtype=torch.float32))[:, 0]
    assert logits[-1] < logits[:-1].mean()


GAMES = [GAIL(iterations=3), GAIfO(iterations=3), AIRL(iterations=3), FIRL(iterations=3)]
OTHERS = [
    *(MaxMargin(iterations=1), MaxEntLinear()),
    MaxEnt(iterations=2, reward_steps=200, rollouts=20, averaged=1),
]


@pytest.mark.parametrize("method", [*GAMES, *OTHERS], ids=lambda method: type(method).__name__)
def test_an_end_that_is_shown_pays_more_than_one_that_is_not(
    world: Any, mortal_world: Any, method: Any
) -> None:
    def absorbing(lifetime: int, where: Any) -> float:
        """Return what it pays, above a step elsewhere."""
        demos = demonstrate(constant(0.0, 0.0), lifetime=lifetime)
        reward = method.fit(demos, where, np.random.default_rng(0)).reward
        return float(reward.absorbing - reward(np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 3)))[0])

    assert absorbing(10, mortal_world) < 0 < absorbing(2, world)


@pytest.mark.parametrize("method", [GAIL, AIRL, FIRL])
def test_demonstrated_states_pay_more_and_a_reward_of_states_does_not_see_actions(
    world: Any, method: Any
) -> None:
    rng = np.random.default_rng(0)
    obs = tuple(np.abs(rng.uniform(-1, 1, (21, 3))) for _ in range(20))
    demos = Episodes(obs, tuple(np.zeros((20, 2)) for _ in obs), (False,) * 20)
    options = {} if method is FIRL else {"actions": False}
    reward = method(iterations=3, **options).fit(demos, world, np.random.default_rng(0)).reward
    there, act = np.full((1, 3), 0.5), np.zeros((1, 2))
    assert reward(there, act, there)[0] > reward(-there, act, there)[0] + 0.3
    assert reward(there, act, there) == reward(there, act + 0.7, there)


STATES, ACTIONS, GAMMA = 16, 4, 0.9


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
    tabulars = [acting_in_one_state(seed) for seed in range(3)]
    short, long, last = (
        np.array([play(tabular, iterations, mean) for tabular in tabulars])
        for iterations, mean in ((3, True), (30, True), (3, False))
    )
    assert long[:, 0].max() < 0.05
    assert long[:, 1].mean() < 0.25 * short[:, 1].mean()
    assert last[:, 0].max() > 0.5


def test_gaifos_reward_makes_the_expert_the_best_where_each_action_leads_elsewhere() -> None:
    """Without a demonstrated action."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        P = np.zeros((STATES, ACTIONS, STATES))
        for state in range(STATES):
            P[state, np.arange(ACTIONS), rng.choice(STATES, ACTIONS, replace=False)] = 1
        start, obs = np.full(STATES, 1 / STATES), np.eye(STATES)
        tabular = Tabular(P, start, obs, reward=1.0 * (np.arange(STATES) == 3), features=obs)
        world = FiniteWorld(tabular, horizon=50, gamma=GAMMA)
        demos = world.rollout(world.optimal(), 20, np.random.default_rng(1))
        unacted = replace(demos, act=tuple(act[:, :0] for act in demos.act))
        game = GAIfO(iterations=30, reward_steps=20, slope_penalty=0.1)
        reward = game.fit(unacted, world, np.random.default_rng(2)).reward
        assert reward is not None
        q = value_iteration(P, expected_rewards(tabular, reward), GAMMA)[1]
        chances = (
            *map(greedy, (value_iteration(P, tabular.reward, GAMMA)[1], q)),
            np.full(P.shape[:2], 1 / ACTIONS),
        )
        truth = [float(start @ policy_value(P, tabular.reward, policy, GAMMA)) for policy in chances]
        assert truth[0] - truth[1] < 0.05 * (truth[0] - truth[2])
