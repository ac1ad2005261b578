"""The one file of a run: damaged, cut off, or made by a stranger."""

import os
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from harness.cli.main import main
from harness.records import Cell, CellResult
from harness.registry import BadInput
from harness.store import database
from harness.store.database import FILE, POINTS_ELSEWHERE
from harness.store.opening import open_for_report, open_for_run, open_to_verify
from harness.store.request import Request
from tests.harness.small_runs import CONDITIONS, NAME, REQUEST, execute, names, result, run, snapshot, stored

__all__ = ["run"]

MANY = Request(("bc",), ("cartpole",), tuple(range(40)), CONDITIONS)


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """A run of 40 cells, on a page or more each, without a report."""
    path = tmp_path / "many"
    with open_for_run(path, MANY) as directory:
        for seed in range(40):
            cell = result("bc", seed)
            cell.curves["loss"][:] = [(float(x), float(seed)) for x in range(500)]
            directory.save(cell)
    return path


def computed(run: Path) -> dict[Cell, CellResult]:
    with open_to_verify(run) as directory:
        return directory.load()[0]


def test_any_flipped_bit_is_noticed_or_harmless(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, cells = (run / FILE).read_bytes(), computed(run)
    rng, noticed = np.random.default_rng(0), 0
    for place in rng.integers(len(whole), size=150):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        (run / FILE).write_bytes(damaged)
        code = main(["verify", str(run)])
        noticed += code > 0
        if code == 0:
            assert repr(computed(run)) == repr(cells)
        if code == 2:
            assert capsys.readouterr().err.count("\n") == 1
    assert noticed > 5


@pytest.mark.parametrize(
    "how", ["cut", "empty page", "no database", "other tables", "other request", "another program's"]
)
def test_a_database_that_is_not_whole_is_refused_in_a_line_and_left_as_it_is(
    many: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (many / FILE).read_bytes()
    half = len(whole) // 2 // 4096 * 4096
    if how == "cut":
        os.truncate(many / FILE, half)
    elif how == "empty page":
        (many / FILE).write_bytes(whole[:half] + bytes(4096) + whole[half + 4096 :])
    elif how == "no database":
        (many / FILE).write_bytes(b"\xff" * len(whole))
    elif how == "other tables":
        execute(many, "CREATE VIEW more AS SELECT * FROM cells")
    elif how == "other request":
        execute(many, "UPDATE run SET data = '{}' WHERE name = 'request'")
    else:
        execute(many, "PRAGMA application_id = 0")
    before = snapshot(many)
    for words in (["verify"], ["report"], ["run", "--methods", "bc", "--envs", "cartpole", "--out"]):
        assert main([*words, str(many)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert f"{many / FILE} is" in said
        assert snapshot(many) == before


def test_a_database_of_another_format_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    execute(run, "PRAGMA user_version = 99")
    assert main(["verify", str(run)]) == 2
    assert "has format 99; this version reads 9" in capsys.readouterr().err


KILLED = """
import os, signal, sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("PRAGMA cache_size = 1")
database.execute("BEGIN IMMEDIATE")
database.execute("UPDATE cells SET data = upper(data)")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_transaction_that_a_kill_cut_off_is_undone(many: Path) -> None:
    before = repr(computed(many))
    killed = subprocess.run([sys.executable, "-c", KILLED, many / FILE], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert b'"CELL"' in (many / FILE).read_bytes()
    there = snapshot(many)
    assert main(["verify", str(many)]) == 0
    assert repr(computed(many)) == before
    assert snapshot(many) == there, "a copy was read"
    with open_for_run(many, MANY) as directory:
        assert len(directory.load()[0]) == 40
    assert not (many / f"{FILE}-journal").exists()


@pytest.mark.parametrize("name", [f"{FILE}-journal", FILE])
@pytest.mark.parametrize("kind", ["link", "pipe", "names another file"])
def test_nothing_that_lies_in_the_place_of_the_database_is_followed(run: Path, name: str, kind: str) -> None:
    mine = run.parents[1] / "mine"
    mine.write_text("mine")
    (run / name).unlink(missing_ok=True)
    if kind == "link":
        (run / name).symlink_to(mine)
    elif kind == "pipe":
        os.mkfifo(run / name)
    else:  # As where a transaction is of several databases: SQLite deletes the file that is named.
        text = os.fsencode(mine)
        lengths = struct.pack(">II", len(text), sum(text))
        (run / name).write_bytes(b"\1" * 512 + text + lengths + POINTS_ELSEWHERE)
    for another in (open_for_run(run, REQUEST), open_for_report(run), open_to_verify(run)):
        with pytest.raises(BadInput, match=r"run\.sqlite"), another:
            pass
    assert mine.read_text() == "mine"


def test_a_row_larger_than_a_cell_may_be_is_not_read(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(database, "LARGEST_ROW", 100_000)
    execute(run, "INSERT INTO cells VALUES ('cartpole__large__seed0', zeroblob(200000), '')")
    assert main(["verify", str(run)]) == 1
    assert "too big" in capsys.readouterr().out


@pytest.mark.parametrize("value", [1, b"\xff", "[" * 9999])
@pytest.mark.parametrize("column", ["data", "sha256", "name"])
def test_rows_of_other_types_are_named(run: Path, value: object, column: str) -> None:
    execute(run, f"UPDATE cells SET {column} = ?", value)
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 2


def test_a_cell_can_be_asked_for_by_sql(run: Path) -> None:
    assert names(run) == [NAME]
    ((mean,),) = execute(run, "SELECT json_extract(data, '$.rows[0].return_mean') FROM cells")
    assert mean == stored(run)["rows"][0]["return_mean"] == 1.0
