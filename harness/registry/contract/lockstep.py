"""Copies in lockstep against environments that are stepped one by one."""

from typing import Any

import numpy as np

from envs import EnvSpec
from envs.copies import Copies, alone
from harness.registry.contract.check import expect

COPIES = 4
GIVEN = ("obs", "reward", "terminated", "truncated")


def assert_together_as_alone(spec: EnvSpec, steps: int) -> set[str]:
    """Return why episodes terminated. Raises ContractError where a batch differs from copies alone.

    Copies are left out in turn, and reset when they end and at times of their own.
    """
    expect(spec.batch is not None, "the task has no batch")
    together, apart = Copies(spec, COPIES), alone(spec, COPIES)
    rng, seeds, endings = np.random.default_rng(0), iter(range(10_000)), set()
    lengths = np.zeros(COPIES, np.int64)

    def reset(place: int) -> None:
        seed, lengths[place] = next(seeds), 0
        _same("after a reset", "obs", [place], [together.reset(place, seed)], [apart.reset(place, seed)])

    for place in range(COPIES):
        reset(place)
    for step in range(steps):
        places = [place for place in reversed(range(COPIES)) if (step + place) % 5]
        act = spec.random_actions(len(places), rng)
        lengths[places] += 1
        *stepped, cut = together.step(places, act)
        *expected, truncated = apart.step(places, act)
        # Time limits are not a batch's to keep.
        ended = cut | (lengths[places] == spec.horizon)
        when = f"at step {step + 1}"
        for name, batched, other in zip(GIVEN, (*stepped, ended), (*expected, truncated), strict=True):
            _same(when, name, places, batched, other)
        for place, terminated, ended in zip(places, stepped[2], truncated, strict=True):
            if terminated:
                endings.add(why := together.why_ended(place))
                _same(when, "why_ended", [place], [why], [apart.why_ended(place)])
            if terminated or ended or (step + 7 * place) % 60 == 59:
                reset(place)
    return endings


def _same(when: str, name: str, places: list[int], batched: Any, alone: Any) -> None:
    """Raise ContractError, with the first copy that differs, unless both are equal."""
    expect(np.shape(batched) == np.shape(alone), f"{when}, {name} of a batch has another shape than alone")
    for place, one, other in zip(places, batched, alone, strict=True):
        expect(
            np.array_equal(one, other), f"{when}, copy {place} of a batch gives {name} {one}, alone {other}"
        )
