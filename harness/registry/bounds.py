"""Types that bound what a stranger's directory may hold; `harness.store.codec` checks them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, TypeVar

from msgspec import Meta

Point = TypeVar("Point")

CONTROL_CHARACTERS = r"\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
"""Characters that change how text is shown or cannot be written, as a range of a regular expression."""
MOST_CURVES, MOST_POINTS, MOST_SOLVES, LONGEST_TEXT = 30, 2000, 1000, 1000
"""Limits: curves of a cell, points of a curve, solves of a reward, and characters."""
MOST_SEEDS = 1000
"""All seeds of a run are smaller."""
MOST_EPISODES = 100
"""Largest number of recorded episodes of a policy."""
MOST_DETAILS = 30
"""Largest number of a method's numbers about its fit."""
LARGEST = 1e100
"""Largest usable number: sums and squares up to it are finite. Larger ones count as unknown, as NaN does."""
Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=120)]
"""A method's or environment's name, which is part of files' names."""
Names = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=2000)]
FileName = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=255)]
Seconds = Annotated[float, Meta(ge=0)]
Text = Annotated[str, Meta(pattern=rf"\A[^{CONTROL_CHARACTERS}]*\Z", max_length=LONGEST_TEXT)]
"""One line of text for people."""
LongText = Annotated[str, Meta(pattern=rf"\A[^{CONTROL_CHARACTERS}]*\Z", max_length=100_000)]
Seed = Annotated[int, Meta(ge=0, lt=MOST_SEEDS)]
Count = Annotated[int, Meta(ge=0, le=10**15)]
Endings = Annotated[dict[Text, Count], Meta(max_length=100)]
"""Numbers of episodes, by why they ended."""
Curve = Annotated[list[tuple[float, float]], Meta(max_length=MOST_POINTS)]
# A text with limits in this union crashes msgspec 0.22 when the process ends.
Setting = bool | int | float | str | list[bool | int | float | str]
Settings = dict[Text, Annotated[dict[Text, Setting], Meta(max_length=100)]]
"""Hyper-parameters by name, of 'method', 'learner' and 'budget'."""


def usable(value: float) -> bool:
    """Return whether it is a number of at most `LARGEST`."""
    return abs(value) <= LARGEST


def thinned(points: Sequence[Point], most: int) -> list[Point]:
    """Return `most` of the points at equal distances, with the first and the last, or all if they are
    fewer."""
    count = min(len(points), most)
    return [points[i * (len(points) - 1) // max(1, count - 1)] for i in range(count)]
