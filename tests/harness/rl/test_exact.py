"""Finite environments are solved, not learned, and left to chance where a reward says nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from envs.gridworld import WORLD
from envs.models import Tabular
from harness.cell.experts import source_for
from harness.process.environment import CACHE_VARIABLE
from harness.records import Conditions
from harness.registry import SPECS
from harness.rl.exact import ExactSolver, expected_rewards
from methods.base import Array, Policy, Reward
from methods.rewards import Constant
from methods.tabular.model import policy_value, value_iteration

GAMMA = 0.95
BEST = float(WORLD.start @ value_iteration(WORLD.P, WORLD.reward, GAMMA)[0])


class Paid:
    """r (S,) where the action is taken, or where it leads."""

    absorbing = 0.0

    def __init__(self, r: Array, on_arrival: bool = False) -> None:
        self.r, self.on_arrival = r, on_arrival

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.r[WORLD.states(next_obs if self.on_arrival else obs)]


class Listed:
    """100 s + 10 a + s', in states observed as 0 and 1."""

    absorbing = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return 100 * obs[:, 0] + 10 * act.argmax(axis=1) + next_obs[:, 0]


def solve(reward: Reward | None, seed: int = 0, tabular: Tabular = WORLD) -> Policy:
    return ExactSolver(tabular, GAMMA, np.random.default_rng(seed)).solve(reward, 1).policy


def value(policy: Policy) -> float:
    """The true value of starting anywhere."""
    act = policy(WORLD.obs)
    assert set(act.ravel()) == {0.0, 1.0}
    assert (act.sum(axis=1) == 1).all()
    return float(WORLD.start @ policy_value(WORLD.P, WORLD.reward, act, GAMMA))


def test_a_constant_reward_leaves_choices_to_chance() -> None:
    paid = Constant(-3.0, absorbing=-3.0)
    choices = np.stack([solve(paid, seed)(WORLD.obs) for seed in range(20)])
    np.testing.assert_array_equal(choices[3], solve(paid, 3)(WORLD.obs))
    assert len({policy.tobytes() for policy in choices}) == 20
    # Of 2880 choices each has a standard error of 0.0075.
    np.testing.assert_allclose(choices.mean(axis=(0, 1)), 0.2, atol=0.03)


def test_it_maximises_the_reward_it_is_given_whichever_of_equals_it_takes() -> None:
    true = [solve(None, seed) for seed in range(3)]
    # What is paid on arrival is what is paid a step later on departure.
    for policy in (*true, solve(Paid(WORLD.reward)), solve(Paid(WORLD.reward, on_arrival=True))):
        assert value(policy) == pytest.approx(BEST, abs=1e-6)
    acts = [policy(WORLD.obs) for policy in true]
    assert (acts[0] != acts[1]).any()
    np.testing.assert_array_equal(acts[0], solve(Paid(WORLD.reward), 0)(WORLD.obs))
    assert value(solve(Paid(-WORLD.reward))) < value(solve(Constant(0.0, absorbing=0.0))) < BEST
    with pytest.raises(ValueError, match="finite"):
        solve(Paid(np.where(np.arange(len(WORLD.reward)) == 77, np.nan, WORLD.reward)))


def test_a_reward_of_where_it_leads_is_averaged_by_hand() -> None:
    P = np.array([[[0.25, 0.75], [1.0, 0.0]], [[0.0, 1.0], [0.5, 0.5]]])
    two = Tabular(P, np.array([1.0, 0.0]), np.array([[0.0], [1.0]]), np.zeros(2), np.eye(2))
    np.testing.assert_allclose(expected_rewards(two, Listed()), [[0.75, 10.0], [101.0, 110.5]])
    # Action 1 pays more at once, but 0 leads to where every step pays 101.
    np.testing.assert_array_equal(solve(Listed(), tabular=two)(two.obs), [[1, 0], [1, 0]])


def test_the_expert_is_optimal_and_needs_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    expert = source_for("gridworld", 0, Conditions("full", "absorbing", "sb3")).expert
    assert not (tmp_path / "cache").exists()
    assert SPECS["gridworld"].gamma == GAMMA
    assert value(expert.policy) == pytest.approx(BEST, abs=1e-6)
    assert (expert.name, expert.curve, expert.env_steps, expert.check_steps) == ("exact", (), 0, 0)
