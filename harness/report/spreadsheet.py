"""CSV files that a spreadsheet shows as they are, and that are read back as they were written."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, BinaryIO

import pandas as pd

FORMULA = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""The beginning of a text that a spreadsheet would compute, with any apostrophes before it.
`page.js` has the same."""


def frame_of(items: Iterable[Any], fields: Sequence[str]) -> pd.DataFrame:
    """Return a table of these fields of the items, a line each."""
    return pd.DataFrame(map(attrgetter(*fields), items), columns=list(fields))


def as_csv(table: pd.DataFrame, **options: Any) -> str:
    """Return the table as CSV, its numbers as they are and its texts marked where they look like formulas."""
    marked = _changed(table, _marked)
    text = str(marked.to_csv(index=False, lineterminator="\n", **options))
    if "\r" in text:  # which only quotation marks keep from ending a line
        text = str(marked.to_csv(index=False, lineterminator="\n", quoting=csv.QUOTE_NONNUMERIC, **options))
    return text


def read_csv(file: BinaryIO, texts: Mapping[str, type]) -> pd.DataFrame:
    """Return the table that `as_csv` wrote. texts: `str` for each column of texts, whatever they look like.

    A method may be called null or NA, and only what is empty is nothing.
    """
    table = pd.read_csv(file, keep_default_na=False, na_values=[""], dtype=dict(texts))
    return _changed(table, _unmarked)


def _changed(table: pd.DataFrame, change: Callable[[Any], Any]) -> pd.DataFrame:
    texts = [name for name in table if not pd.api.types.is_numeric_dtype(table[name])]
    return table.assign(**{str(name): table[name].map(change) for name in texts})


def _marked(item: Any) -> Any:
    return f"'{item}" if isinstance(item, str) and FORMULA.match(item) else item


def _unmarked(item: Any) -> Any:
    return item[1:] if isinstance(item, str) and item[:1] == "'" and FORMULA.match(item) else item
