"""Names of the files of a run's cells, and the list of those that a report left."""

from __future__ import annotations

import dataclasses

from harness.records import LEARNED, RECORDED, Cell, PolicyName, policies_of
from harness.store.files import as_lines

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


@dataclasses.dataclass(frozen=True)
class Report:
    """The last report.

    `key`: of its cells and of the program (`report_key`). `digest`: of its cells alone.
    `files`: the SHA-256 of each table and recording, by its path in the directory.
    """

    key: str = ""
    digest: str = ""
    files: dict[str, str] = dataclasses.field(default_factory=dict)

    @property
    def sums(self) -> bytes:
        """The list of checksums."""
        return as_lines((digest, name) for name, digest in sorted(self.files.items())).encode()
