"""The distance of a reward from the true one, and its ranks of policies, where they are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from envs import EnvSpec
from harness.cell.shipped import shipped_policies
from harness.judge.advantage import (
    POLICIES,
    Comparison,
    compare,
    epic_distance,
    known_comparison,
    policy_advantage,
    ranked,
    replay,
    sampled_comparison,
)
from harness.registry import SPECS
from harness.rl.seeds import rng_for
from harness.rl.simulator import Simulator
from methods.base import Array, Reward
from methods.rewards import Constant
from methods.tabular.model import action_values, greedy, soft_policy, soft_value_iteration, value_iteration
from tests.harness.rewards import Seek

SEEDS = range(40)
GAMMA = 0.9


def best(obs: Array) -> Array:
    """The target tasks' best policy."""
    return obs


def compared(spec: EnvSpec, reward: Reward | None) -> Comparison:
    return sampled_comparison(reward, replay(spec, best, SEEDS, rng_for(0, "advantage")))


@dataclass(frozen=True)
class Pays:
    """A reward that pays what a function says."""

    function: Callable[[Array, Array, Array], Array]
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.function(obs, act, next_obs)


def test_the_true_reward_and_its_equals_have_distance_0_and_its_negative_1(steady: EnvSpec) -> None:
    assert compared(steady, None)[:2] == (0, pytest.approx(1))
    assert compared(steady, Seek())[:2] == (pytest.approx(0, abs=1e-3), pytest.approx(1, abs=1e-3))
    assert compared(steady, Seek(scale=30.0))[:2] == (pytest.approx(0, abs=1e-3), pytest.approx(1, abs=1e-3))
    assert compared(steady, Seek(scale=-1.0))[:2] == (pytest.approx(1, abs=1e-3), pytest.approx(-1, abs=1e-3))
    assert 0.05 < compared(steady, Seek(side=0.0)).distance < 0.9
    shifted = Pays(lambda *step: 3 * Seek()(*step) + 7, absorbing=7.0)
    assert compared(steady, shifted).distance < 1e-3


def test_potential_shaping_changes_nothing_but_what_discounting_leaves_at_the_end(steady: EnvSpec) -> None:
    def shaped(obs: Array, act: Array, next_obs: Array) -> Array:
        return Seek()(obs, act, next_obs) + 0.5 * np.sin(9 * next_obs[:, 0]) - np.sin(9 * obs[:, 0])

    # At this discount ten steps are the whole of it.
    assert compared(dataclasses.replace(steady, gamma=0.5), Pays(shaped)).distance < 0.02


def test_what_an_early_end_costs_counts(fragile: EnvSpec) -> None:
    # Missing by more than 0.5 loses every later reward, which Seek says too, for after the end there is none.
    assert compared(fragile, Seek()).distance < 1e-3
    lasting = compared(fragile, Constant(0.0, absorbing=-1.0))
    assert 0 < lasting.distance < 0.5


def test_a_reward_that_never_varies_has_no_distance(steady: EnvSpec) -> None:
    constant, tabular = Constant(-1.0, absorbing=-1.0), SPECS["gridworld"].tabular
    assert all(map(math.isnan, compared(steady, constant)))
    assert tabular is not None
    known = known_comparison(constant, tabular, 0.95)
    assert all(map(math.isnan, (known.distance, known.rank, known.epic)))


def test_replays_differ_in_one_action_and_what_follows(fragile: EnvSpec) -> None:
    first = [np.zeros((0, 1)), np.array([[0.1]]), np.full((9, 1), 0.2), np.array([[0.1], [2.0]])]
    same = Simulator(fragile).run(best, range(4))
    for lanes, most in ((1, 2), (4, None)):
        left = Simulator(fragile, lanes).run(best, range(4), first, most)
        for episode, before, begun in zip(left, same, first, strict=True):
            expected = before.act.copy()
            expected[: len(begun)] = begun
            np.testing.assert_array_equal(episode.act, expected[: len(episode.act)])
            np.testing.assert_array_equal(episode.obs[0], before.obs[0])
            assert episode.terminated or len(episode.act) == min(10, len(begun) + (most or 10))
    replays = replay(fragile, best, SEEDS, rng_for(0, "advantage"))
    starts = np.cumsum(replays.lengths + 1) - replays.lengths - 1
    assert len(starts) == 2 * len(SEEDS)
    np.testing.assert_array_equal(*np.split(replays.obs[starts], 2))
    assert not np.isclose(*np.split(replays.act[starts - np.arange(len(starts))], 2)).any()


@pytest.mark.parametrize("seed", range(4))
def test_equivalent_rewards_of_random_tasks_have_distance_0_and_the_opposite_1(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, r = rng.dirichlet(np.full(16, 0.3), size=(16, 3)), rng.normal(size=(16, 3))
    q = value_iteration(P, r, GAMMA)[1]
    expert = greedy(q)
    true = policy_advantage(P, r, expert, GAMMA)

    def distance(reward: Array) -> float:
        return compare(policy_advantage(P, reward, expert, GAMMA), true).distance

    potential = rng.normal(size=16)
    soft = soft_value_iteration(P, r, GAMMA)[1]
    same = {
        "affine": 2 * r + 5,
        "shaped by a potential": action_values(P, r, potential, GAMMA) - potential[:, None],
        "the optimal advantage": q - q.max(axis=1, keepdims=True),
        "the soft-optimal policy's logarithm": np.log(soft_policy(soft)),
    }
    for name, reward in same.items():
        assert distance(reward) == pytest.approx(0, abs=1e-6), name
    assert distance(-r) == pytest.approx(1)
    assert 0.3 < distance(rng.normal(size=r.shape)) < 1
    assert math.isnan(distance(np.full(r.shape, 3.0)))
    assert epic_distance(2 * r + 5, r, GAMMA) == pytest.approx(0, abs=1e-6)
    assert epic_distance(-r, r, GAMMA) == pytest.approx(1)
    assert math.isnan(epic_distance(np.ones_like(r), r, GAMMA))
    almost = 1e6 + 1e-6 * np.random.default_rng(0).normal(size=r.shape)
    assert math.isnan(epic_distance(almost, r, GAMMA))
    assert epic_distance(same["the optimal advantage"], r, GAMMA) > 0.25


def test_where_the_model_is_known_so_is_the_distance() -> None:
    spec, same = SPECS["gridworld"], pytest.approx(0, abs=1e-6)
    tabular = spec.tabular
    assert tabular is not None
    value = value_iteration(tabular.P, tabular.reward, spec.gamma)[0]

    def shaped(obs: Array, act: Array, next_obs: Array) -> Array:
        """The true reward shaped by its optimal values."""
        here, there = tabular.states(obs), tabular.states(next_obs)
        return np.asarray(tabular.reward[here] + spec.gamma * value[there] - value[here])

    assert known_comparison(None, tabular, spec.gamma) == (0, pytest.approx(1), 0, same)
    assert known_comparison(Pays(shaped), tabular, spec.gamma)[:3] == (same, pytest.approx(1), 0)


def test_the_floor_is_the_distance_of_a_shaped_copy(steady: EnvSpec, fragile: EnvSpec) -> None:
    assert compared(steady, Seek()).floor == 0  # what is done changes nothing of where it ends
    (expert, *_), rng = shipped_policies("swingup"), np.random.default_rng(0)
    soon, late = (
        sampled_comparison(None, replay(dataclasses.replace(SPECS["swingup"], gamma=g), expert, SEEDS, rng))
        for g in (0.99, 0.9)
    )
    assert 1e-6 < late.floor < 0.02 < soon.floor < 0.5
    # What ends for good leaves nothing to a potential.
    replays = replay(fragile, best, SEEDS, rng_for(0, "advantage"))
    assert replays.terminated.any()
    dead = dataclasses.replace(replays, terminated=np.ones_like(replays.terminated))
    np.testing.assert_array_equal(dead.shaped(replays.advantage), replays.advantage)


def test_the_true_reward_ranks_all_policies_as_they_are_and_its_negative_the_other_way(
    steady: EnvSpec, fragile: EnvSpec
) -> None:
    policies, brief = (
        ranked(spec, [best, lambda obs: 0.5 * obs], range(10), rng_for(0, "ranking"))
        for spec in (steady, fragile)
    )
    assert policies.true.shape == (POLICIES,)
    assert len(policies.lengths) == 10 * POLICIES
    assert policies.ranking(None) == pytest.approx(1)
    assert policies.ranking(Seek()) == pytest.approx(1, abs=0.01)
    assert policies.ranking(Seek(scale=-1.0)) == pytest.approx(-1, abs=0.01)
    # Each begins with the policy as it is, and random actions do it no good.
    assert policies.true[0] > policies.true[POLICIES // 2 - 1]
    assert policies.true[0] > policies.true[POLICIES // 2]
    assert math.isnan(policies.ranking(Constant(1.0, absorbing=0.0)))
    assert math.isnan(brief.ranking(Constant(1.0, absorbing=1.0)))
    # Survival alone ranks where episodes end early.
    assert brief.ranking(Constant(1.0, absorbing=0.0)) > 0.8
