"""Tables: values, columns that read them from items, and what is written of them for people and programs."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any, BinaryIO, Literal

import pandas as pd

from harness.judge.numbers import as_text
from harness.judge.statistics import CONFIDENCE

Kind = Literal["choice", "text", "note", "number", "interval"]
"""Types of columns: few texts to filter by, other texts, long texts, numbers, numbers with an interval."""
LEVEL = f"{100 * CONFIDENCE:.0f} %"
"""The level of intervals."""
FORMULA = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""The beginning of a text that a spreadsheet would compute, with any apostrophes before it.
`page.js` has the same."""
LATEX = {
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    **{"π*": r"$\pi^*$", "π_R": r"$\pi_R$", "\N{MINUS SIGN}": "$-$", "…": r"\dots{}"},
}
"""Texts that LaTeX would take for something else, and how they are written."""


@dataclass(frozen=True)
class Value:
    """A number, its text, and the ends of its interval; what is not known is NaN."""

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
        return f"{self.title} [{LEVEL}]" if self.kind == "interval" else self.title

    @property
    def is_number(self) -> bool:
        """True for a column of numbers."""
        return self.kind in ("number", "interval")


@dataclass(frozen=True)
class Table:
    """A table. `name`: the beginning of the names of its files. `items`: one for each line."""

    name: str
    columns: Sequence[Column]
    items: Sequence[Any]

    def lines(self) -> list[list[str | Value]]:
        """Return the items' values in the order of the columns."""
        return [[column.read(item) for column in self.columns] for item in self.items]

    def as_markdown(self) -> str:
        """Return it in Markdown; an empty text where it has no line."""
        if not self.items:
            return ""
        texts = [[escaped(str(value)) for value in line] for line in self.lines()]
        lines = [[column.heading for column in self.columns], ["---"] * len(self.columns), *texts]
        return "".join("| " + " | ".join(line) + " |\n" for line in lines)

    def as_latex(self) -> str:
        """Return it in LaTeX, with rules of booktabs, and its name in a comment."""
        special = re.compile("|".join(map(re.escape, sorted(LATEX, key=len, reverse=True))))

        def line(items: Sequence[object]) -> str:
            texts = (special.sub(lambda match: LATEX[match[0]], str(item)) for item in items)
            return " & ".join(texts) + " \\\\\n"

        kinds = "".join("r" if column.is_number else "l" for column in self.columns)
        head = f"% {self.name}\n\\begin{{tabular}}{{{kinds}}}\n\\toprule\n"
        titles = line([column.heading for column in self.columns])
        body = "".join(map(line, self.lines()))
        return f"{head}{titles}\\midrule\n{body}\\bottomrule\n\\end{{tabular}}\n"


def at(place: int, key: str, title: str, meaning: str, kind: Kind = "number") -> Column:
    """Return a column of items that are sequences of values. `place`: the value that it shows."""
    return Column(key, title, meaning, itemgetter(place), kind)


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


def escaped(text: str) -> str:
    """Return the text for Markdown, where it is neither table nor HTML nor link nor emphasis."""
    return re.sub(r"([\\|<>&`*]|(?<=\])\()", r"\\\1", text)


def frame_of(items: Iterable[Any], fields: Sequence[str]) -> pd.DataFrame:
    """Return a table of these fields of the items, a line each."""
    return pd.DataFrame(map(attrgetter(*fields), items), columns=list(fields))


def as_csv(table: pd.DataFrame, **options: Any) -> str:
    """Return the table as CSV that a spreadsheet shows as it is: texts that look like formulas are marked."""
    marked = _changed(table, lambda text: f"'{text}" if FORMULA.match(text) else text)
    text = str(marked.to_csv(index=False, lineterminator="\n", **options))
    if "\r" in text:  # which only quotation marks keep from ending a line
        text = str(marked.to_csv(index=False, lineterminator="\n", quoting=csv.QUOTE_NONNUMERIC, **options))
    return text


def read_csv(file: BinaryIO, texts: Mapping[str, type]) -> pd.DataFrame:
    """Return the table that `as_csv` wrote. texts: `str` for each column of texts, whatever they look like.

    A method may be called null or NA, and only what is empty is nothing.
    """
    table = pd.read_csv(file, keep_default_na=False, na_values=[""], dtype=dict(texts))
    return _changed(table, lambda text: text[1:] if text[:1] == "'" and FORMULA.match(text) else text)


def _changed(table: pd.DataFrame, change: Callable[[str], str]) -> pd.DataFrame:
    names = [name for name in table if not pd.api.types.is_numeric_dtype(table[name])]
    return table.assign(
        **{
            str(name): table[name].map(lambda item: change(item) if isinstance(item, str) else item)
            for name in names
        }
    )
