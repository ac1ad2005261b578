"""T-REX finds the reward that preferences come from, beyond what is shown."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import spearmanr

from methods.base import Episodes, Unsuitable
from methods.trex import TREX

pytestmark = pytest.mark.usefixtures("fused_adam")


def shown(count: int = 30) -> Episodes:
    """Return episodes without actions, ever higher in the first number observed, up to 0."""
    rng, levels = np.random.default_rng(0), np.linspace(-1, 0, count)
    obs = tuple(
        np.column_stack([rng.normal(level, 0.3, 21), rng.uniform(-1, 1, (21, 2))]) for level in levels
    )
    return Episodes(obs, tuple(np.zeros((20, 0)) for _ in obs), (False,) * count)


def test_a_reward_that_sums_to_more_over_the_better_goes_on_above_all_of_them(world: Any) -> None:
    demos, rng = shown(), np.random.default_rng(1)
    numbers = rng.integers(len(demos), size=(400, 2))
    pairs = np.sort(numbers[numbers[:, 0] != numbers[:, 1]])
    reward = TREX(networks=1).fit(replace(demos, preferences=pairs), world, np.random.default_rng(0)).reward
    assert reward is not None
    obs = np.column_stack([rng.uniform(-1, 1, 500), rng.uniform(-1, 1, (500, 2))])
    paid = reward(obs, np.zeros((500, 2)), obs)
    assert spearmanr(paid, obs[:, 0]).statistic > 0.8
    assert paid[obs[:, 0] > 0.5].mean() > paid[np.abs(obs[:, 0]) < 0.2].mean()
    again = TREX(networks=1).fit(replace(demos, preferences=pairs[:, ::-1]), world, np.random.default_rng(0))
    opposite = again.reward
    assert opposite is not None
    assert spearmanr(opposite(obs, np.zeros((500, 2)), obs), obs[:, 0]).statistic < -0.8


@pytest.mark.parametrize("preferences", [None, np.zeros((0, 2), np.int64)])
def test_without_preferences_it_learns_nothing(world: Any, preferences: Any) -> None:
    with pytest.raises(Unsuitable, match="ranks, returns or preferences"):
        TREX(networks=1).fit(replace(shown(), preferences=preferences), world, np.random.default_rng(0))
