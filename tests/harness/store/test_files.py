"""Files of a run that are damaged, and files that it did not write, to which nothing happens."""

import os
import resource
from pathlib import Path

import numpy as np
import pytest

from harness.benchmarks.reproduce import open_study
from harness.cli.main import main
from harness.records import Cell, CellResult
from harness.registry import BadInput
from harness.store.database import FILE
from harness.store.files import SUMS, appending, read, write_atomic
from harness.store.opening import open_for_run, open_to_verify
from tests.harness.small_runs import (
    RECORDING,
    REQUEST,
    execute,
    run,
    snapshot,
    strange,
)

__all__ = ["run"]


def test_a_short_write_is_an_error_and_an_old_file_stays_whole(tmp_path: Path) -> None:
    write_atomic(tmp_path / "file", "old")
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, most[1]))
    try:
        with pytest.raises(OSError, match="File too large"), appending(tmp_path / "log") as file:
            file.write(b"x" * 101)
        with pytest.raises(OSError, match="File too large"):
            write_atomic(tmp_path / "file", b"x" * 101)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    assert {file.name for file in tmp_path.iterdir()} == {"file", "log"}
    assert read(tmp_path / "file") == b"old"


@pytest.mark.parametrize("name", [FILE, "scores.csv", f"recordings/{RECORDING}"])
@pytest.mark.parametrize("kind", ["pipe", "device", "huge"])
def test_special_files_block_nobody(run: Path, name: str, kind: str) -> None:
    (run / name).unlink()
    if kind == "pipe":
        os.mkfifo(run / name)
    elif kind == "device":
        (run / name).symlink_to("/dev/zero")
    else:
        (run / name).touch()
        os.truncate(run / name, 1 << 36)
    assert main(["verify", str(run)]) == (2 if name == FILE else 1)
    assert main(["report", str(run)]) == {FILE: 2, "scores.csv": 0}.get(name, 1)


def test_a_users_own_files_in_a_runs_directory_are_nobodys_damage(run: Path) -> None:
    mine = ["notes.txt", "leaderboard.xlsx", ".notes.tmp", "recordings/mine.rrd", ".report.html.swp"]
    for name in mine:
        (run / name).write_text("mine")
    for command in ("verify", "report", "verify"):
        assert main([command, str(run)]) == 0
    with open_for_run(run, REQUEST):
        pass
    assert [(run / name).read_text() for name in mine] == ["mine"] * len(mine)
    assert "mine.rrd" not in (run / "report.html").read_text()


@pytest.mark.parametrize("name", [SUMS, "recordings/x", ".lock"])
@pytest.mark.parametrize("command", ["run", "reproduce"])
def test_a_directory_of_somebody_elses_is_refused_and_left_as_it_was(
    tmp_path: Path, name: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine" / name).parent.mkdir(parents=True)
    (tmp_path / "mine" / name).write_text("another program's")
    before = snapshot(tmp_path)
    assert main([command, "--out", str(tmp_path / "mine")]) == 2
    assert "is not empty and holds no" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_reproduce_and_run_leave_each_others_directories_alone(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = run.parent / "study"
    with open_study(study):
        pass
    (study / "native").symlink_to(run)
    before = snapshot(run.parent)
    for command, out in (("reproduce", run), ("run", study), ("reproduce", study)):
        assert main([command, "--out", str(out)]) == 2
        assert snapshot(run.parent) == before
    assert "it is a link" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["report.html", SUMS, FILE, ".lock", "run.log"])
def test_a_link_in_the_place_of_a_file_is_replaced_or_refused_and_not_followed(run: Path, name: str) -> None:
    elsewhere = run.parents[1] / "mine"
    elsewhere.write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(elsewhere)
    if name in ("report.html", SUMS):
        assert main(["verify", str(run)]) == 1
        assert main(["report", str(run)]) == 0
        assert not (run / name).is_symlink()
    else:
        with pytest.raises((BadInput, OSError), match="link"), open_for_run(run, REQUEST) as directory:
            directory.log(b"more")
    assert elsewhere.read_text() == "mine"


@pytest.mark.parametrize("changes", [{"env": "../../x"}, {"seed": 1}, {"policy": "expert"}])
def test_rows_of_another_cell_are_refused_and_nothing_outside_is_written(
    run: Path, changes: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    strange(run, **changes)
    before = set(run.parents[1].rglob("*"))
    assert main(["report", str(run)]) == 2
    assert "holds no finished cell" in capsys.readouterr().err
    assert main(["verify", str(run)]) == 1
    assert set(run.parents[1].rglob("*")) == before


def test_what_a_killed_run_left_half_written_is_deleted_by_run_and_left_by_verify(run: Path) -> None:
    half = [".scores.csv.0123456789abcdef.tmp", "recordings/.a.rrd.0123456789abcdef.tmp"]
    for name in half:
        (run / name).write_text("{")
    (run / ".lock").unlink()
    before = snapshot(run)
    assert main(["verify", str(run)]) == 0
    assert snapshot(run) == before
    with open_for_run(run, REQUEST):
        assert not any((run / name).exists() for name in half)


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
        capsys.readouterr()
        code = main(["verify", str(run)])
        noticed += code > 0
        if code == 0:
            assert repr(computed(run)) == repr(cells)
        if code == 2:
            assert capsys.readouterr().err.count("\n") == 1
    assert noticed > 5


SPOILED = {
    "other tables": "CREATE VIEW more AS SELECT * FROM cells",
    "other request": "UPDATE run SET data = '{}' WHERE name = 'request'",
    "another program's": "PRAGMA application_id = 0",
    "another format's": "PRAGMA user_version = 99",
}


@pytest.mark.parametrize("how", ["cut", "empty page", "no database", *SPOILED])
def test_a_database_that_is_not_whole_is_refused_in_a_line_and_left_as_it_is(
    run: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (run / FILE).read_bytes()
    half = len(whole) // 2 // 4096 * 4096
    if how == "cut":
        os.truncate(run / FILE, half)
    elif how == "empty page":
        (run / FILE).write_bytes(whole[:half] + bytes(4096) + whole[half + 4096 :])
    elif how == "no database":
        (run / FILE).write_bytes(b"\xff" * len(whole))
    else:
        execute(run, SPOILED[how])
    before = snapshot(run)
    for words in (["verify"], ["report"], ["run", "--methods", "bc", "--envs", "cartpole", "--out"]):
        assert main([*words, str(run)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert f"{run / FILE} {'has format 99' if 'format' in how else 'is'}" in said
        assert snapshot(run) == before


@pytest.mark.parametrize("begun", [b"", b"half a page"])
def test_a_run_killed_before_its_first_whole_file_can_be_started_again(tmp_path: Path, begun: bytes) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / FILE).touch()
    (tmp_path / f"{FILE}-journal").write_bytes(begun)
    with open_for_run(tmp_path, REQUEST):
        assert sorted(file.name for file in tmp_path.iterdir()) == [".lock", FILE]
