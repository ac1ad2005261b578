"""What a run had and has no more, or not as it was: told, remembered, and mended where it can be."""

import dataclasses
import os
import resource
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.benchmarks.reproduce import open_study
from harness.cli.main import main
from harness.records import Cell
from harness.registry import BadInput
from harness.store.database import FILE
from harness.store.files import append, write_atomic
from harness.store.opening import open_for_report, open_for_run, open_to_verify
from harness.store.request import Request
from harness.store.sums import SUMS
from tests.harness.small_runs import (
    CONDITIONS,
    NAME,
    RECORDING,
    REQUEST,
    damage,
    delete,
    result,
    run,
    snapshot,
    store,
    stored,
    strange,
)

__all__ = ["run"]

SECOND = "cartpole__bc__seed1"


@pytest.mark.parametrize("gone", ["recordings/*", "scores.csv", "report.html", SUMS, "[!r.]*.*", "[!r.]*"])
def test_whatever_a_run_had_and_has_no_more_is_damage(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in run.glob(gone):
        if path.is_dir():
            path.rename(run.parent / path.name)
        else:
            path.unlink()
    assert main(["verify", str(run)]) == 1
    assert "every file is as it was written" not in capsys.readouterr().out


@pytest.mark.parametrize("how", [delete, damage])
def test_a_cell_that_was_stored_is_named_and_not_forgotten(
    tmp_path: Path, how: Callable[[Path, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1))) as directory:
        for seed in (0, 1):
            directory.save(result(seed=seed))
    assert main(["verify", str(tmp_path)]) == 0
    assert main(["report", str(tmp_path)]) == 0
    how(tmp_path, SECOND)
    for _ in range(2):
        capsys.readouterr()
        assert main(["report", str(tmp_path)]) == 1
        assert SECOND in capsys.readouterr().err
        assert "not complete: 1 of the 18 cells" in (tmp_path / "report.html").read_text()
        assert main(["verify", str(tmp_path)]) == 1
        (line,) = capsys.readouterr().out.splitlines()[-1:]
        assert line.startswith(f"{tmp_path / FILE / SECOND}: ")


@pytest.mark.parametrize("table", ["scores.csv", "leaderboard.md"])
def test_a_list_of_checksums_that_was_changed_is_damage_and_mended_by_report(
    run: Path, table: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if not line.endswith(f"  {table}\n")))
    before = (run / table).read_bytes()
    (run / table).write_text("something else")
    assert main(["verify", str(run)]) == 1
    said = capsys.readouterr().out
    assert f"{run / SUMS}: its checksum does not match" in said
    assert f"{run / table}: its checksum does not match" in said
    with open_for_run(run, REQUEST) as directory:
        assert not directory.is_sealed()
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0
    assert (run / table).read_bytes() == before


@pytest.mark.parametrize("how", ["another run's", "stored since"])
def test_tables_of_other_cells_are_damage(run: Path, how: str, capsys: pytest.CaptureFixture[str]) -> None:
    if how == "another run's":  # valid in itself
        strange(run, return_mean=9.0)
    else:
        with open_for_run(run, dataclasses.replace(REQUEST, seeds=(0, 1))) as directory:
            directory.save(result(seed=1))
    assert main(["verify", str(run)]) == 1
    assert f"{run / 'scores.csv'}: cells were stored since it was written" in capsys.readouterr().out
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize("gone", ["deleted", "damaged"])
def test_a_report_without_a_recording_says_so(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = run / "recordings" / RECORDING
    recording.write_text("{") if gone == "damaged" else recording.unlink()
    assert main(["report", str(run)]) == 1
    why = "missing" if gone == "deleted" else "its checksum does not match"
    assert f"{RECORDING}: {why}\n" in capsys.readouterr().err
    assert main(["verify", str(run)]) == 1


@pytest.mark.parametrize("kind", ["deleted", "pipe", "link", "binary"])
def test_a_leaderboard_that_is_none_is_built_again(run: Path, kind: str) -> None:
    table = run / "leaderboard.md"
    before = table.read_bytes()
    table.unlink()
    if kind == "pipe":
        os.mkfifo(table)
    elif kind == "link":
        table.symlink_to("/etc/hostname")
    elif kind == "binary":
        table.write_bytes(b"\xff\x1b[2J")
    assert main(["report", str(run)]) == 0
    assert table.read_bytes() == before


def test_what_the_report_was_made_of_is_damaged(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage(run, "report", "run")
    assert main(["verify", str(run)]) == 1
    assert f"{run / FILE}/run/report: its checksum does not match" in capsys.readouterr().out
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize(
    ("name", "changes", "why"),
    [
        (NAME, {"protocol": "native"}, "it was computed under another protocol"),
        ("cartpole__shaped__seed0", {"method": "shaped"}, "this run was not asked for it"),
    ],
)
def test_cells_that_a_run_was_not_asked_for_are_left_out(
    run: Path, name: str, changes: dict[str, str], why: str
) -> None:
    cell = stored(run)
    cell["cell"]["method"] = changes.get("method", "bc")
    cell["rows"][0] |= changes
    store(run, cell, name)
    with open_for_report(run) as directory:
        assert directory.load()[1] == {directory.place(name): why}


def test_a_swapped_cell_is_told_by_report(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store(run, stored(run), digest="0" * 64)
    for command in (["report"], ["compare", str(run)], ["report"]):
        assert main([*command, str(run)]) == 2  # it is the only cell
        said = capsys.readouterr().err
        assert f"{NAME}: its checksum does not match" in said
        assert "holds no finished cell" in said


def test_a_run_does_not_write_into_another_one_that_took_its_place(tmp_path: Path) -> None:
    with open_for_run(tmp_path / "run", REQUEST) as directory:
        (tmp_path / "run").rename(tmp_path / "moved")
        for _ in range(2):  # gone, and another's
            for write in (
                lambda: directory.save(result()),
                lambda: directory.seal([], []),
                lambda: directory.keep_beside([]),
            ):
                before = snapshot(tmp_path)
                with pytest.raises(OSError, match="moved, deleted or changed while the run goes on"):
                    write()
                assert snapshot(tmp_path) == before
            with open_for_run(tmp_path / "run", REQUEST):
                pass


def test_a_run_that_would_grow_beyond_what_can_be_read_is_refused(tmp_path: Path) -> None:
    many = Request(tuple(f"m{i}" for i in range(200)), ("cartpole",), (0,), CONDITIONS)
    with open_for_run(tmp_path, many):
        pass
    before = snapshot(tmp_path)
    with pytest.raises(BadInput, match="cannot hold so much"), open_for_run(tmp_path, REQUEST):
        pass
    assert snapshot(tmp_path) == before


def test_a_short_write_to_the_log_is_an_error(tmp_path: Path) -> None:
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, most[1]))
    try:
        with pytest.raises(OSError, match=r"No space left|File too large"):
            append(tmp_path / "log", b"x" * 101)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)


def test_two_may_verify_at_once(run: Path) -> None:
    with open_to_verify(run):
        assert main(["verify", str(run)]) == 0
        with pytest.raises(BadInput, match="in use"), open_for_report(run):
            pass


def test_a_file_system_that_cannot_sync_folders_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsync = os.fsync

    def refuse(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(22, "Invalid argument")
        fsync(handle)

    monkeypatch.setattr("harness.store.files.os.fsync", refuse)
    write_atomic(tmp_path / "file", "text")
    assert (tmp_path / "file").read_text() == "text"


def test_a_study_with_a_strangers_run_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    with open_study(tmp_path):
        pass
    (tmp_path / "native").mkdir()
    (tmp_path / "native/mine").write_text("mine")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    assert not (tmp_path / "absorbing").exists()


def test_the_next_run_may_ask_for_cells_that_are_there(run: Path) -> None:
    with open_for_run(run, dataclasses.replace(REQUEST, methods=("bc", "shaped"))) as directory:
        assert list(directory.load()[0]) == [Cell("cartpole", "bc", 0)]
