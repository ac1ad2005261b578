"""Copies in lockstep against environments that are stepped one by one."""

import numpy as np

from envs import EnvSpec
from envs.copies import Copies, alone

COPIES = 4


def assert_together_as_alone(spec: EnvSpec, steps: int) -> set[str]:
    """Why episodes terminated. Copies are left out in turn, and reset when they end and at times of their
    own."""
    assert spec.batch is not None
    together, apart = Copies(spec, COPIES), alone(spec, COPIES)
    rng, seeds, endings = np.random.default_rng(0), iter(range(10_000)), set()
    lengths = np.zeros(COPIES, np.int64)

    def reset(place: int) -> None:
        seed, lengths[place] = next(seeds), 0
        assert np.array_equal(together.reset(place, seed), apart.reset(place, seed))

    for place in range(COPIES):
        reset(place)
    for step in range(steps):
        places = [place for place in reversed(range(COPIES)) if (step + place) % 5]
        act = spec.random_actions(len(places), rng)
        lengths[places] += 1
        *found, cut = together.step(places, act)
        *expected, truncated = apart.step(places, act)
        assert all(map(np.array_equal, found, expected))
        # Time limits are not a batch's to keep.
        assert np.array_equal(cut | (lengths[places] == spec.horizon), truncated)
        for place, terminated, ended in zip(places, found[2], truncated, strict=True):
            if terminated:
                endings.add(together.why_ended(place))
                assert together.why_ended(place) == apart.why_ended(place)
            if terminated or ended or (step + 7 * place) % 60 == 59:
                reset(place)
    return endings
