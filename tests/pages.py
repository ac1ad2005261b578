"""Files below results/ and what pages say of them, as tests read them."""

import csv
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
REFERENCE = ROOT / "results/reference"
BOARD = REFERENCE / "board"


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def marked(page: str, name: str) -> str:
    """Return the text between a page's marks of this name."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (found,) = re.findall(rf"<!-- {name} -->\n(.*?)<!-- end", text, re.DOTALL)
    return str(found)


def cells_of(table: str) -> list[list[str]]:
    """Return the cells of each line of a table, but for its rule."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def leaderboard(run: str) -> dict[tuple[str, str, str], dict[str, str]]:
    """Return the lines of a run of the board, by dynamics, method and policy."""
    rows = rows_of(BOARD / run / "leaderboard.csv")
    return {(row["dynamics"], row["method"], row["policy"]): row for row in rows}
