"""Worlds that answer at once (`tests.methods.worlds`), for what methods compute themselves."""

import pytest

from tests.methods.worlds import FakeWorld


@pytest.fixture
def world() -> FakeWorld:
    return FakeWorld()


@pytest.fixture
def mortal_world() -> FakeWorld:
    """Return a world where every rollout terminates after two of its ten steps."""
    return FakeWorld(lifetime=2)
