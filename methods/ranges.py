"""Types of hyper-parameters: the values that a field may have, and those that `irl-bench tune` searches.

Fields that buy computation, such as steps and iterations, are not searched: more of them is another budget.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

NO_NUMBERS = "It says which values may be asked for."

MOST = 10**6


@dataclass(frozen=True)
class Between:
    """Numbers from `low` to `high` that are searched, on a logarithmic scale."""

    low: float
    high: float


@dataclass(frozen=True)
class OneOf:
    """Values that are searched."""

    values: tuple[object, ...]


Count = Annotated[int, Meta(ge=1, le=MOST)]
CountOrNone = Annotated[int, Meta(ge=0, le=MOST)]
Positive = Annotated[float, Meta(gt=0, le=MOST)]
Weight = Annotated[float, Meta(ge=0, le=MOST)]
Share = Annotated[float, Meta(ge=0, le=1)]
Level = Annotated[float, Meta(ge=-MOST, le=MOST)]
Layers = Annotated[tuple[Count, ...], Meta(max_length=10)]
"""Sizes of hidden layers."""
Hidden = Annotated[Layers, OneOf(((32, 32), (64, 64), (128, 128), (256, 256)))]
"""Sizes of hidden layers that are searched."""
Rate = Annotated[Positive, Between(1e-4, 1e-2)]
"""A learning rate of Adam."""
