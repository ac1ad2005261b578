"""Copies in lockstep against environments that are stepped one by one."""

import numpy as np

from envs import EnvSpec

COPIES = 4


def assert_together_as_alone(spec: EnvSpec, steps: int) -> set[str]:
    """Why episodes terminated. Copies are left out in turn, and reset when they end and at times of their
    own."""
    assert spec.batch is not None
    together, alone = spec.batch(COPIES), [spec.make() for _ in range(COPIES)]
    rng, seeds, endings = np.random.default_rng(0), iter(range(10_000)), set()

    def reset(place: int) -> None:
        seed = next(seeds)
        assert np.array_equal(together.reset(place, seed), alone[place].reset(seed=seed)[0])

    for place in range(COPIES):
        reset(place)
    for step in range(steps):
        places = [place for place in reversed(range(COPIES)) if (step + place) % 5]
        act = spec.random_actions(len(places), rng)
        obs, rewards, terminated = together.step(places, act)
        assert obs.dtype == rewards.dtype == np.float64
        for row, place in enumerate(places):
            expected = alone[place].step(spec.native(act[row]))
            assert np.array_equal(obs[row], expected[0])
            assert (rewards[row], terminated[row]) == expected[1:3]
            if terminated[row]:
                endings.add(together.why_ended(place))
                assert together.why_ended(place) == spec.why_ended(alone[place])
            if terminated[row] or expected[3] or (step + 7 * place) % 60 == 59:
                reset(place)
    return endings
