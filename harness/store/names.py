"""Names of the files of a run's cells."""

from __future__ import annotations

from harness.records import LEARNED, RECORDED, Cell, PolicyName, policies_of

COMPARE = "compare"
"""The end of the name of a recording of all methods on one episode."""


def files_of(cell: Cell) -> set[str]:
    """Return the names that a cell's files may have, as of `CellResult.files`."""
    if cell.seed:
        return {LEARNED}
    names = {recording_of(cell, policy, which) for policy in policies_of(cell) for which in RECORDED}
    return {*(f"recordings/{name}" for name in names), LEARNED}


def recording_of(cell: Cell, policy: PolicyName, which: str) -> str:
    """Return the name of a recording. `which`: of `RECORDED`."""
    return f"{cell.name}__{policy}{which and '.'}{which}.rrd"


def compared_in(env: str) -> str:
    """Return the name of the recording of all methods on one episode."""
    return f"{env}__{COMPARE}.rrd"
