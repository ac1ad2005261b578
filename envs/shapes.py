"""Small types that all tasks share: arrays, quantities with units, and the shapes that drawings are made
of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Quantity(NamedTuple):
    """The name and unit of an entry of an observation or an action."""

    name: str
    unit: str = ""
    """Unit, e.g. 'm', or '20 m' where an entry of 1 is 20 m; '' for a mere number."""

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Shape:
    """One line strip of a drawing. `points`: (P, 2) in metres, x to the right and y up. A closed outline
    repeats its first point. `colour`: red, green, blue, each 0 to 255."""

    points: Array
    colour: tuple[int, int, int]
