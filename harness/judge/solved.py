"""The verdict on RL: did it find a policy that the reward asks for?"""

from __future__ import annotations

import math

from harness.registry.bounds import usable

SHARE = 0.95
"""Share of pi_star's gain over the random policy that RL must reach."""
ROUNDING = 1e-9
"""The largest relative difference of sums that are equal up to rounding."""


def is_solved(own: float, star: float, random: float) -> float:
    """Return 1 where RL solved R*, 0 where it did not, and NaN where one of the returns is not known.

    `own`, `star`, `random`: mean returns under R* of RL's policy, of pi_star, and of the random policy. Where
    pi_star earns no more than the random policy, RL must earn as much as the random policy.
    """
    if not all(map(usable, (own, star, random))):
        return math.nan
    least = random + SHARE * max(0.0, star - random)
    return float(own >= least or math.isclose(own, least, rel_tol=ROUNDING, abs_tol=ROUNDING))
