"""RL has solved a reward where it earns 95 % of what pi_star earns more than the random policy."""

from __future__ import annotations

import math

import pytest
from harness.judge.solved import is_solved


@pytest.mark.parametrize(
    ("own", "star", "random", "expected"),
    [
        (10.0, 10.0, 0.0, 1),
        (9.5, 10.0, 0.0, 1),
        (9.49, 10.0, 0.0, 0),
        (12.0, 10.0, 0.0, 1),
        (-1.0, 10.0, 0.0, 0),
        (-10.5, -10.0, -20.0, 1),
        (-10.6, -10.0, -20.0, 0),
    ],
)
def test_it_is_a_share_of_what_pi_star_earns_more_than_chance(
    own: float, star: float, random: float, expected: float
) -> None:
    assert is_solved(own, star, random) == expected


@pytest.mark.parametrize(("own", "expected"), [(-5.0, 0), (2.9, 0), (3.0, 1), (7.0, 1)])
@pytest.mark.parametrize("star", [-4.0, 2.9, 3.0])
def test_where_pi_star_is_no_better_than_chance_rl_must_earn_as_much_as_chance(
    own: float, star: float, expected: float
) -> None:
    assert is_solved(own, star, 3.0) == expected


@pytest.mark.parametrize("level", [0.0, 0.1, -1e7])
def test_a_reward_that_pays_all_policies_alike_is_solved_but_for_rounding(level: float) -> None:
    assert is_solved(level, level, level) == 1
    assert is_solved(level, level + 1e-12 * abs(level), level) == 1
    assert is_solved(level - 1e-12 * abs(level), level, level) == 1


@pytest.mark.parametrize("unknown", [math.nan, math.inf, -math.inf, 1e101])
@pytest.mark.parametrize("place", range(3))
def test_what_is_not_known_says_nothing(unknown: float, place: int) -> None:
    returns = [10.0, 10.0, 0.0]
    returns[place] = unknown
    assert math.isnan(is_solved(*returns))
