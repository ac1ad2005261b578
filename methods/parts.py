"""Fits of two parts. Several methods share the first."""

from __future__ import annotations

from methods.base import Episodes, Learned, Rng, World

BEGINS_WITH = {"gail_mean": "gail", "shaped_ml": "shaped", "shaped_ranked": "shaped"}
"""Methods, and the method whose fit is the first part of theirs."""


class TwoParts:
    """A method whose fit begins with another one's, or is the beginning of another one's."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Do both parts. Random numbers of the second do not depend on how many the first has drawn."""
        (second,) = rng.spawn(1)
        return self.go_on(self.first(demos, world, rng), demos, world, second)

    def first(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Return the result of the first part."""
        raise NotImplementedError

    def go_on(self, first: Learned, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Return the result of both parts, by default that of the first."""
        return first
