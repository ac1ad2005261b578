"""Tables: values, columns that read them from items, and where each column is visible."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Literal

from harness.judge.numbers import as_text

Kind = Literal["choice", "text", "note", "number", "interval"]
"""Types of columns: few texts to filter by, other texts, long texts, numbers, numbers with an interval."""


@dataclass(frozen=True)
class Value:
    """A number, its text, and the ends of its 95 % interval; what is not known is NaN."""

    text: str
    number: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Column:
    """A column of a table.

    `key`: its name for programs. `title`, `meaning`: words for readers.
    `read`: the function from an item to its text or number.
    `places`: where it is visible. 'first' is the page before all columns are asked for.
    'scores', 'rewards' and 'costs' are tables in Markdown and LaTeX.
    """

    key: str
    title: str
    meaning: str
    read: Callable[[Any], str | Value]
    kind: Kind = "number"
    places: str = ""

    @property
    def heading(self) -> str:
        """The title as tables show it."""
        return f"{self.title} [95 %]" if self.kind == "interval" else self.title

    @property
    def is_number(self) -> bool:
        """True for a column of numbers."""
        return self.kind in ("number", "interval")

    def at(self, place: int) -> Column:
        """Return the column for items that are sequences of values. `place`: the value that it shows."""
        return dataclasses.replace(self, read=itemgetter(place))


@dataclass(frozen=True)
class Table:
    """A table. `name`: the beginning of the names of its files. `items`: one for each line."""

    name: str
    columns: Sequence[Column]
    items: Sequence[Any]

    @property
    def headings(self) -> list[str]:
        """The columns' titles."""
        return [column.heading for column in self.columns]

    def lines(self) -> list[list[str | Value]]:
        """Return the items' values in the order of the columns."""
        return [[column.read(item) for column in self.columns] for item in self.items]


def number(value: float, spec: str) -> Value:
    """Return the number in the format `spec`."""
    return Value(as_text(value, spec), value)


def interval(mean: float, low: float, high: float, spec: str = "z.2f") -> Value:
    """Return a mean with its interval, where it has one."""
    if not math.isfinite(low):
        return number(mean, spec)
    return Value(f"{as_text(mean, spec)} [{as_text(low, spec)}, {as_text(high, spec)}]", mean, low, high)


def without_interval(text: str) -> str:
    """Return the text of a value without its interval."""
    return re.sub(r" \[[^]]*\]", "", text)
