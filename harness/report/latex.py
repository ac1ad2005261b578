"""Tables in LaTeX, with rules of booktabs."""

from __future__ import annotations

import re
from collections.abc import Sequence

from harness.report.tables import Table

SPECIAL = {
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    **{"π*": r"$\pi^*$", "π_R": r"$\pi_R$", "\N{MINUS SIGN}": "$-$", "…": r"\dots{}"},
}
"""Texts that LaTeX would take for something else, and how they are written. `page.js` has the same."""
_ANY = re.compile("|".join(map(re.escape, sorted(SPECIAL, key=len, reverse=True))))


def as_latex(tables: Sequence[Table]) -> str:
    """Return the tables, one below the other, each with its name in a comment."""
    return "% \\usepackage{booktabs}\n" + "\n".join(map(_tabular, tables))


def _tabular(table: Table) -> str:
    kinds = "".join("r" if column.is_number else "l" for column in table.columns)
    lines = "".join(map(_line, table.lines()))
    head = f"% {table.name}\n\\begin{{tabular}}{{{kinds}}}\n\\toprule\n{_line(table.headings)}\\midrule\n"
    return f"{head}{lines}\\bottomrule\n\\end{{tabular}}\n"


def _line(items: Sequence[object]) -> str:
    return " & ".join(_ANY.sub(lambda match: SPECIAL[match[0]], str(item)) for item in items) + " \\\\\n"
