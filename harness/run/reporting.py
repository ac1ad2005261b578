"""Writes the report of a run into its directory."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from harness.judge.results import CellResult, Request
from harness.registry.keys import PAGE_PARTS, program
from harness.run.files import write_atomic
from harness.show.report import report_files


def write_report(directory: Path, request: Request, results: Sequence[CellResult]) -> list[Path]:
    """Writes what `report_files` makes of the results into `directory`; returns the files' paths."""
    recorded: list[str] = []
    with suppress(OSError):
        recorded = os.listdir(directory / "recordings")
    parts = {Path(name).name: program()[name].decode() for name in PAGE_PARTS}
    files = report_files(request, results, parts, recorded)
    for name, content in files.items():
        write_atomic(directory / name, content)
    return [directory / name for name in files]
