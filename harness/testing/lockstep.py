"""Copies in lockstep against environments that are stepped one by one."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from envs import EnvSpec
from envs.copies import Copies, alone
from harness.testing.contract import expect

COPIES = 4
GIVEN = ("obs", "reward", "terminated", "truncated")


def assert_together_as_alone(spec: EnvSpec, steps: int) -> set[str]:
    """Return why episodes terminated. Raises ContractError where a batch gives something else than copies
    alone. They are left out in turn, and reset when they end and at times of their own."""
    expect(spec.batch is not None, "the task has no batch")
    together, apart = Copies(spec, COPIES), alone(spec, COPIES)
    rng, seeds, endings = np.random.default_rng(0), iter(range(10_000)), set()
    lengths = np.zeros(COPIES, np.int64)

    def reset(place: int) -> None:
        seed, lengths[place] = next(seeds), 0
        _same(
            "after a reset",
            "obs",
            [together.reset(place, seed)],
            [apart.reset(place, seed)],
            [place],
        )

    for place in range(COPIES):
        reset(place)
    for step in range(steps):
        places = [place for place in reversed(range(COPIES)) if (step + place) % 5]
        act = spec.random_actions(len(places), rng)
        lengths[places] += 1
        *found, cut = together.step(places, act)
        *expected, truncated = apart.step(places, act)
        # Time limits are not a batch's to keep.
        ended = cut | (lengths[places] == spec.horizon)
        for name, its, other in zip(GIVEN, (*found, ended), (*expected, truncated), strict=True):
            _same(f"at step {step + 1}", name, its, other, places)
        for place, terminated, ended in zip(places, found[2], truncated, strict=True):
            if terminated:
                endings.add(together.why_ended(place))
                said, told = together.why_ended(place), apart.why_ended(place)
                expect(
                    said == told,
                    f"at step {step + 1}, copy {place} of a batch ended for {said!r}, alone for {told!r}",
                )
            if terminated or ended or (step + 7 * place) % 60 == 59:
                reset(place)
    return endings


def _same(when: str, name: str, found: Any, expected: Any, places: Sequence[int]) -> None:
    found, expected = np.asarray(found), np.asarray(expected)
    expect(
        found.shape == expected.shape,
        f"{when}, {name} of a batch has the shape {found.shape}, not {expected.shape}",
    )
    for place in np.argwhere(found != expected)[:1].tolist():
        its, other = found[tuple(place)], expected[tuple(place)]
        entry = f"{name} {place[1]}" if len(place) > 1 else name
        expect(False, f"{when}, copy {places[place[0]]} of a batch gives {its} as {entry}, alone {other}")
