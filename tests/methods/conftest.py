"""Worlds that answer at once (`tests.methods.worlds`), for what methods compute themselves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from methods.base import Episodes, Policy
from tests.methods.worlds import FakeWorld, FiniteWorld, NoEnvironment


@pytest.fixture
def world() -> FakeWorld:
    return FakeWorld()


@pytest.fixture
def mortal_world() -> FakeWorld:
    """Where every rollout terminates after two of its ten steps."""
    return FakeWorld(lifetime=2)


@pytest.fixture
def no_environment() -> NoEnvironment:
    return NoEnvironment()


@pytest.fixture
def finite_world() -> type[FiniteWorld]:
    """Makes a world whose model is known."""
    return FiniteWorld


@pytest.fixture
def demonstrate() -> Callable[..., Episodes]:
    """Demonstrations of a policy, (B, 3) to (B, 2), on uniform observations."""

    def episodes(policy: Policy, count: int = 20, lifetime: int = 10, seed: int = 0) -> Episodes:
        return FakeWorld(lifetime).rollout(policy, count, np.random.default_rng(seed))

    return episodes
