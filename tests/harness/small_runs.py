"""A finished run of one cell with a real report, to be harmed."""

import dataclasses
import json
from pathlib import Path

import pytest

from harness.cli import main
from harness.judge.results import Cell, CellResult, Conditions, Request, Row
from harness.run.codec import checksum
from harness.run.files import sha256, write_atomic
from harness.run.opening import open_for_run

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
REQUEST = Request(("bc",), ("cartpole",), (0,), CONDITIONS)
RECORDING = "cartpole__bc__seed0__pi_star.rrd"


def result(method: str = "bc") -> CellResult:
    row = Row("cartpole", method, 0, "pi_star", "absorbing", episodes=1, return_mean=1.0, length_mean=1.0)
    return CellResult(Cell("cartpole", method, 0), [row], {"loss": [(0.0, 1.0), (1.0, 0.5)]})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of a real report."""
    path = tmp_path / "deep/run"
    with open_for_run(path, REQUEST) as directory:
        write_atomic(path / "recordings" / RECORDING, b"a recording")
        recordings = {RECORDING: sha256(path / "recordings" / RECORDING)}
        directory.save(dataclasses.replace(result(), recordings=recordings))
    (path / "figures").mkdir()  # as runs of earlier versions have
    assert main(["report", str(path)]) == 0
    assert main(["verify", str(path)]) == 0
    return path


def snapshot(path: Path) -> dict[str, bytes | None]:
    return {str(file): file.read_bytes() if file.is_file() else None for file in path.rglob("*")}


def strange(run: Path, **changes: object) -> None:
    """The stored cell with other values in its row, and a right checksum."""
    file = run / "cells/cartpole__bc__seed0.json"
    stored = json.loads(file.read_text())
    stored["result"]["rows"][0] |= changes
    stored["sha256"] = checksum(stored["result"])
    file.write_text(json.dumps(stored))
