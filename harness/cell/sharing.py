"""Dependencies of cells: what they share with others of their task and seed, and the cell before them."""

from __future__ import annotations

import dataclasses

from harness.records import ALL_SHOWN, CONTROLS, NOMINAL, REFERENCE, UNSHOWN, Cell, Shown
from methods.parts import BEGINS_WITH


def takes_one_solve(cell: Cell) -> bool:
    """Return whether RL solves its reward at most once, however many solves are asked for."""
    return cell.method in (REFERENCE, *CONTROLS) or cell.dynamics != NOMINAL


def before(cell: Cell) -> Cell | None:
    """Return the cell whose artifact saves this one a fit, if there is one."""
    if cell.method == "control_clone":
        return dataclasses.replace(cell, method="bc", dynamics=NOMINAL)
    if cell.dynamics == NOMINAL:
        first = BEGINS_WITH.get(cell.method)
        return dataclasses.replace(cell, method=first) if first else None
    return None if cell.method in UNSHOWN else dataclasses.replace(cell, dynamics=NOMINAL)


def name_of(shown: Shown) -> str:
    """Return the name of shown demonstrations among the inputs that cells share."""
    return f"demonstrations {shown}"


def needs(cell: Cell, name: str) -> bool:
    """Return whether the cell uses the shared input of this name, such as the demonstrations it is shown."""
    is_shown = name.startswith(name_of(ALL_SHOWN))
    return not is_shown or (cell.method not in UNSHOWN and name == name_of(cell.shown))
