"""The one file of a run: damaged, cut off, or made by a stranger."""

import os
import signal
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
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
PAGE = 4096


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """A run of 40 cells, on a page or more each, without a report."""
    path = tmp_path / "many"
    with open_for_run(path, MANY) as directory:
        for seed in range(40):
            directory.save(large(seed))
    return path


def large(seed: int) -> CellResult:
    cell = result("bc", seed)
    cell.curves["loss"][:] = [(float(x), float(seed)) for x in range(500)]
    return cell


def changed(run: Path, place: int, data: bytes) -> None:
    with (run / FILE).open("r+b") as file:
        file.seek(place)
        file.write(data)


def computed(run: Path) -> dict[Cell, CellResult]:
    with open_to_verify(run) as directory:
        return directory.load()[0]


def test_any_flipped_bit_is_noticed_or_harmless(
    run: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole, cells = (run / FILE).read_bytes(), computed(run)
    rng, noticed = np.random.default_rng(0), 0
    for place in rng.integers(len(whole), size=150):
        changed(run, int(place), bytes([whole[place] ^ 1 << int(rng.integers(8))]))
        code = main(["verify", str(run)])
        noticed += code > 0
        assert code in (0, 1, 2)
        if code == 0:
            assert repr(computed(run)) == repr(cells)
        if code == 2:
            assert capsys.readouterr().err.count("\n") == 1
        (run / FILE).write_bytes(whole)
    assert noticed > 10
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize("how", ["cut", "empty page", "no database", "other tables", "other request"])
def test_what_cannot_be_read_is_moved_aside_by_the_next_run(
    many: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    size, before = (many / FILE).stat().st_size, computed(many)
    if how == "cut":
        os.truncate(many / FILE, size // 2)
    elif how == "empty page":
        changed(many, size // 2 // PAGE * PAGE, bytes(PAGE))
    elif how == "no database":
        (many / FILE).write_bytes(b"\xff" * size)
    elif how == "other tables":
        execute(many, "CREATE VIEW more AS SELECT * FROM cells")
    else:
        execute(many, "UPDATE run SET data = '{}' WHERE name = 'request'")
    for command in ("verify", "report"):
        assert main([command, str(many)]) in (1, 2)
    assert f"{FILE} is damaged: " in capsys.readouterr().err
    damaged = (many / FILE).read_bytes()
    with open_for_run(many, MANY) as directory:
        kept, unusable = directory.load()
    aside = many / f"{FILE}.damaged-1"
    assert list(unusable) == [aside]
    assert aside.read_bytes() == damaged
    assert kept.items() <= before.items()
    least = {"cut": 10, "empty page": 30, "no database": 0}.get(how, 40)
    assert len(kept) >= least
    with open_for_run(many, MANY) as directory:
        for seed in {*range(40)} - {cell.seed for cell in kept}:
            directory.save(large(seed))
    assert [cell.seed for cell in computed(many)] == list(range(40))
    assert main(["verify", str(many)]) == 0
    assert f"{aside}: covered by no checksum" in capsys.readouterr().out


def test_a_second_damaged_database_gets_another_name(run: Path) -> None:
    for number in (1, 2):
        (run / FILE).write_bytes(b"\xff" * number)
        with open_for_run(run, REQUEST):
            assert (run / f"{FILE}.damaged-{number}").read_bytes() == b"\xff" * number


@pytest.mark.parametrize("program", ["another's", "no database"])
def test_a_database_of_another_program_is_left_alone(tmp_path: Path, program: str) -> None:
    if program == "another's":
        execute(tmp_path, "CREATE TABLE mine (x)")
    else:
        (tmp_path / FILE).write_text("mine")
    before = snapshot(tmp_path)
    with pytest.raises(BadInput, match="is no database of a run"), open_for_run(tmp_path, REQUEST):
        pass
    assert snapshot(tmp_path) == before


def test_a_database_of_another_format_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    execute(run, "PRAGMA user_version = 99")
    for command in (["verify"], ["run", "--methods", "bc", "--envs", "cartpole", "--out"]):
        assert main([*command, str(run)]) == 2
        assert "has format 99; this version reads 9" in capsys.readouterr().err


KILLED = """
import os, signal, sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("PRAGMA cache_size = 1")
database.execute("BEGIN IMMEDIATE")
database.execute("UPDATE cells SET data = upper(data)")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("first", ["verify", "run"])
def test_a_transaction_that_a_kill_cut_off_is_undone(many: Path, first: str) -> None:
    before = repr(computed(many))
    killed = subprocess.run([sys.executable, "-c", KILLED, many / FILE], check=False)
    assert killed.returncode == -signal.SIGKILL
    there = snapshot(many)
    assert os.path.getsize(many / f"{FILE}-journal") > 0
    assert there[str(many / FILE)] is not None
    assert b'"CELL"' in there[str(many / FILE)]  # type: ignore[operator]
    if first == "verify":
        assert main(["verify", str(many)]) == 0
        assert repr(computed(many)) == before
        assert snapshot(many) == there  # a copy was read
    with open_for_run(many, MANY) as directory:
        assert len(directory.load()[0]) == 40
    assert repr(computed(many)) == before
    assert not (many / f"{FILE}-journal").exists()


@pytest.mark.parametrize("name", [f"{FILE}-journal", FILE, f"{FILE}-wal"])
@pytest.mark.parametrize("kind", ["link", "hard link", "pipe", "folder"])
def test_what_sqlite_would_follow_is_refused(run: Path, name: str, kind: str) -> None:
    mine = run.parents[1] / "mine"
    mine.write_text("mine")
    (run / name).unlink(missing_ok=True)
    if kind == "link":
        (run / name).symlink_to(mine)
    elif kind == "hard link":
        (run / name).hardlink_to(mine)
    elif kind == "pipe":
        os.mkfifo(run / name)
    else:
        (run / name).mkdir()
    assert_refused(run, writers=kind == "hard link")
    assert mine.read_text() == "mine"
    assert os.path.lexists(run / name)


def assert_refused(run: Path, writers: bool = False) -> None:
    """Nobody opens the run, or no writer."""
    contexts = [open_for_run(run, REQUEST), open_for_report(run), open_to_verify(run)]
    for another in contexts[: 2 if writers else 3]:
        with pytest.raises(BadInput, match=r"cannot use .*run\.sqlite|holds no run"), another:
            pass


def test_a_journal_that_names_another_file_deletes_it_nowhere(run: Path) -> None:
    """As SQLite writes it where a transaction is of several databases, of which it deletes the named file."""
    mine = run.parents[1] / "mine"
    mine.write_text("mine")
    text = os.fsencode(mine)
    lengths = struct.pack(">II", len(text), sum(text))
    (run / f"{FILE}-journal").write_bytes(b"\1" * 512 + text + lengths + POINTS_ELSEWHERE)
    assert_refused(run)
    assert mine.read_text() == "mine"


def test_a_row_larger_than_a_cell_may_be_is_not_read(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(database, "LARGEST_ROW", 100_000)
    execute(run, "INSERT INTO cells VALUES ('cartpole__large__seed0', zeroblob(200000), '')")
    assert main(["verify", str(run)]) == 1
    assert "too big" in capsys.readouterr().out
    monkeypatch.setattr(database, "LARGEST_FILE", 4096)
    assert main(["verify", str(run)]) == 2
    assert "larger than" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["", 1, 1.5, b"\xff", "[" * 9999])
@pytest.mark.parametrize("column", ["data", "sha256", "name"])
def test_rows_of_other_types_are_named(run: Path, value: object, column: str) -> None:
    execute(run, f"UPDATE cells SET {column} = ?", value)
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 2


def test_tables_whose_pages_lead_round_in_a_circle_end(many: Path) -> None:
    """The pages of a table list the first of them again and again."""
    with closing(sqlite3.connect(many / FILE)) as file:
        ((root,),) = file.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'cells'").fetchall()
    page = (root - 1) * PAGE
    whole = (many / FILE).read_bytes()
    assert whole[page] == 5, "an inner page"
    cells = int.from_bytes(whole[page + 3 : page + 5], "big")
    places = [
        page + int.from_bytes(whole[page + 12 + 2 * n : page + 14 + 2 * n], "big") for n in range(cells)
    ]
    for place in places:
        changed(many, place, whole[places[0] : places[0] + 4])
    with open_to_verify(many) as directory:
        found, unusable = directory.load()
        assert len(found) + len(unusable) < 40
        assert any("pages repeat" in why or "malformed" in why for why in unusable.values())
        assert many / FILE in directory.damaged()


def test_a_cell_can_be_asked_for_by_sql(run: Path) -> None:
    assert names(run) == [NAME]
    ((mean,),) = execute(run, "SELECT json_extract(data, '$.rows[0].return_mean') FROM cells")
    assert mean == stored(run)["rows"][0]["return_mean"] == 1.0
