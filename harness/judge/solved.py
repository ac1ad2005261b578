"""The verdict on RL: did it find what a reward asks for?"""

from __future__ import annotations

import math

from harness.judge.results import usable

SHARE = 0.95
"""Part of what pi_star earns more than the random policy that RL must earn."""
ROUNDING = 1e-9
"""The largest difference, as a share, of sums that are equal but for rounding."""


def is_solved(own: float, star: float, random: float) -> float:
    """Return 1 where RL solved R*, 0 where it did not, and NaN where one of the returns is not known.

    own, star, random: mean returns under R* of RL's policy, of pi_star, and of the random policy. Where
    pi_star earns no more than the random policy, RL must earn as much as the random policy.
    """
    if not all(map(usable, (own, star, random))):
        return math.nan
    least = random + SHARE * max(0.0, star - random)
    return float(own >= least or math.isclose(own, least, rel_tol=ROUNDING, abs_tol=ROUNDING))
