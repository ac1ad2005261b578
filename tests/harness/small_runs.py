"""A finished run of one cell with a real report, to be harmed; and hands for the rows of its database."""

import dataclasses
import hashlib
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from harness.cli.main import main
from harness.records import Cell, CellResult, Conditions, Row
from harness.store.database import FILE
from harness.store.files import sha256_of
from harness.store.opening import open_for_run
from harness.store.request import Request

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
REQUEST = Request(("bc",), ("cartpole",), (0,), CONDITIONS)
NAME = "cartpole__bc__seed0"
RECORDING = f"{NAME}__pi_star.rrd"


def result(method: str = "bc", seed: int = 0) -> CellResult:
    row = Row("cartpole", method, seed, "pi_star", "absorbing", episodes=1, return_mean=1.0, length_mean=1.0)
    return CellResult(Cell("cartpole", method, seed), [row], {"loss": [(0.0, 1.0), (1.0, 0.5)]})


def recorded() -> tuple[CellResult, dict[str, bytes]]:
    """Return a result with a recording, and that file."""
    files = {f"recordings/{RECORDING}": b"a recording"}
    return dataclasses.replace(result(), recordings={RECORDING: sha256_of(b"a recording")}), files


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of a real report."""
    path = tmp_path / "deep/run"
    with open_for_run(path, REQUEST) as directory:
        directory.save(*recorded())
    assert main(["report", str(path)]) == 0
    return path


def snapshot(path: Path) -> dict[str, bytes | None]:
    return {str(file): file.read_bytes() if file.is_file() else None for file in path.rglob("*")}


def execute(run: Path, statement: str, *values: object) -> list[tuple[Any, ...]]:
    """Return what a statement of SQL finds in a run's database, or change that."""
    with closing(sqlite3.connect(run / FILE)) as database, database:
        return database.execute(statement, values).fetchall()


def names(run: Path, table: str = "cells") -> list[str]:
    return [name for (name,) in execute(run, f"SELECT name FROM {table} ORDER BY name")]


def stored(run: Path, name: str = NAME, table: str = "cells") -> dict[str, Any]:
    """Return what the row of a cell holds."""
    ((data,),) = execute(run, f"SELECT data FROM {table} WHERE name = ?", name)
    found: dict[str, Any] = json.loads(data)
    return found


def store(run: Path, data: object, name: str = NAME, table: str = "cells") -> None:
    """Write a row with any JSON, text or bytes, and the right checksum."""
    text = data if isinstance(data, str | bytes) else json.dumps(data)
    digest = hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()
    execute(run, f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?)", name, text, digest)


def damage(run: Path, name: str = NAME, table: str = "cells") -> None:
    """Change a row, and not its checksum."""
    execute(run, f"UPDATE {table} SET data = replace(data, '1', '7') WHERE name = ?", name)


def delete(run: Path, name: str = NAME, table: str = "cells") -> None:
    execute(run, f"DELETE FROM {table} WHERE name = ?", name)


def strange(run: Path, **changes: object) -> None:
    """Change values in the row of the stored cell, and its checksum."""
    result = stored(run)
    result["rows"][0] |= changes
    store(run, result)
