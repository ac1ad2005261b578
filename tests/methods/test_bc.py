"""Behaviour cloning finds a linear expert, and no reward."""

from collections.abc import Callable
from typing import Any

import numpy as np

from methods.base import Array, Episodes
from methods.bc import BehaviourCloning

GAIN = np.array([[0.6, 0.0], [-0.3, 0.5], [0.1, -0.4]])


def expert(obs: Array) -> Array:
    return obs @ GAIN


def test_it_recovers_a_linear_expert_without_an_environment(
    no_environment: Any, demonstrate: Callable[..., Episodes]
) -> None:
    learned = BehaviourCloning(steps=600).fit(
        demonstrate(expert, count=60), no_environment, np.random.default_rng(0)
    )
    obs = np.random.default_rng(9).uniform(-0.9, 0.9, (500, 3))
    error = np.abs(learned.policy(obs) - expert(obs))
    assert error.mean() < 0.02
    assert error.max() < 0.15
    assert learned.reward is None
    assert learned.curves["loss"][-1] < 1e-3 < learned.curves["loss"][0]


def test_the_units_of_observations_do_not_matter(
    no_environment: Any, demonstrate: Callable[..., Episodes]
) -> None:
    demos = demonstrate(expert)
    units = np.array([1e-3, 1.0, 1e3])
    others = Episodes(tuple(obs * units + 5 * units for obs in demos.obs), demos.act, demos.terminated)
    one, other = (
        BehaviourCloning(steps=100).fit(d, no_environment, np.random.default_rng(0)).policy
        for d in (demos, others)
    )
    obs = demos.pairs()[0]
    np.testing.assert_allclose(other(obs * units + 5 * units), one(obs), atol=1e-2)
