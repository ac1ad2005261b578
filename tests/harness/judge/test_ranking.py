"""Whether rewards rank policies."""

import math

import numpy as np
import pytest
from harness.judge.ranking import POLICIES, Ranked, ranked

from envs import EnvSpec
from harness.cell.shipped import shipped_policies
from harness.registry import SPECS
from harness.rl.seeds import rng_for
from methods.base import Array
from methods.rewards import Constant
from tests.harness.rewards import Seek


def best(obs: Array) -> Array:
    """The target tasks' best policy."""
    return obs


def worse(obs: Array) -> Array:
    return 0.5 * obs


def of(spec: EnvSpec) -> Ranked:
    return ranked(spec, [best, worse], range(10), rng_for(0, "ranking"))


def test_the_true_reward_ranks_all_policies_as_they_are_and_its_negative_the_other_way(
    steady: EnvSpec,
) -> None:
    policies = of(steady)
    assert policies.true.shape == (POLICIES,)
    assert len(policies.lengths) == 10 * POLICIES
    assert policies.ranking(None) == pytest.approx(1)
    assert policies.ranking(Seek()) == pytest.approx(1, abs=0.01)
    assert policies.ranking(Seek(scale=-1.0)) == pytest.approx(-1, abs=0.01)
    # Each begins with the policy as it is, and random actions do it no good.
    assert policies.true[0] > policies.true[POLICIES // 2 - 1]
    assert policies.true[0] > policies.true[POLICIES // 2]


def test_a_reward_that_says_the_same_of_all_ranks_none(steady: EnvSpec, fragile: EnvSpec) -> None:
    assert math.isnan(of(steady).ranking(Constant(1.0, absorbing=0.0)))
    assert math.isnan(of(fragile).ranking(Constant(1.0, absorbing=1.0)))
    # Survival alone ranks where episodes end early.
    assert of(fragile).ranking(Constant(1.0, absorbing=0.0)) > 0.8


def test_shipped_policies_are_bad_and_good_ones() -> None:
    spec = SPECS["swingup"]
    policies = ranked(spec, shipped_policies("swingup"), range(3), np.random.default_rng(0))
    assert len(policies.true) == POLICIES
    assert np.ptp(policies.true) > 300
