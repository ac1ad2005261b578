"""What a run had and has no more, or not as it was: told, remembered, and mended where it can be."""

import dataclasses
import os
import resource
import stat
from pathlib import Path

import pytest

from harness.cli import main
from harness.judge.results import Cell, CellResult
from harness.registry import BadInput
from harness.reproduce import open_study
from harness.store.codec import encode
from harness.store.files import append, write_atomic
from harness.store.opening import open_for_report, open_for_run, open_to_verify
from harness.store.request import write_request
from harness.store.sums import SUMS
from tests.harness.small_runs import CONDITIONS, RECORDING, REQUEST, result, run, snapshot, strange

__all__ = ["run"]


@pytest.mark.parametrize(
    "gone", ["cells/*", "recordings/*", "figures/*", "cells", "scores.csv", SUMS, "[!r]*"]
)
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


def test_cells_that_were_stored_before_the_first_report_are_listed_too(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as directory:
        directory.save(result())
    assert main(["verify", str(tmp_path)]) == 0
    (tmp_path / "cells/cartpole__bc__seed0.json").unlink()
    assert main(["verify", str(tmp_path)]) == 1


@pytest.mark.parametrize("what", ["scores.csv", "figures/cartpole_scores.png", "report.key", "cells/*"])
def test_a_list_of_checksums_that_was_shortened_is_damage_and_mended_by_report(
    run: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = run.glob(what)
    name = file.relative_to(run).as_posix()
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if not line.endswith(f"  {name}\n")))
    before = file.read_bytes()
    if what != "cells/*":
        file.write_text("something else")
    assert main(["verify", str(run)]) == 1
    assert "SHA256SUMS" in capsys.readouterr().out
    with open_for_run(run, REQUEST) as directory:
        assert not directory.is_sealed(list(directory.load()[0].values()))
    told = what != "report.key"  # of which the list may be as old as a killed report
    assert main(["report", str(run)]) == told
    assert ("what was stored once and is gone cannot be told" in capsys.readouterr().err) == told
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0
    assert file.name == "report.key" or file.read_bytes() == before


def test_a_cell_that_was_deleted_with_its_line_is_damage(run: Path) -> None:
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if "  cells/" not in line))
    (run / "cells/cartpole__bc__seed0.json").unlink()
    assert main(["verify", str(run)]) == 1


@pytest.mark.parametrize("how", ["gone", "empty", "other"])
def test_a_cell_that_was_deleted_with_the_whole_list_is_told(
    tmp_path: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, methods=("bc", "shaped"))) as directory:
        directory.save(result())
        directory.save(result("shaped"))
    assert main(["report", str(tmp_path)]) == 0
    (tmp_path / "cells/cartpole__bc__seed0.json").unlink()
    if how == "gone":
        (tmp_path / SUMS).unlink()
    else:
        (tmp_path / SUMS).write_text("" if how == "empty" else f"{'0' * 64}  notes\n")
    capsys.readouterr()
    assert main(["verify", str(tmp_path)]) == 1
    assert "cartpole__bc__seed0.json: not there, though asked for" in capsys.readouterr().out
    assert main(["report", str(tmp_path)]) == 1
    told = capsys.readouterr()
    assert "what was stored once and is gone cannot be told" in told.err
    assert "not computed yet, or gone: cartpole__reference__seed0 and 8 more" in told.out
    assert "not complete: 1 of the 10 cells" in (tmp_path / "report.html").read_text()


def test_a_changed_request_is_damage_though_it_says_the_same(run: Path) -> None:
    (run / "run.json").write_text((run / "run.json").read_text().replace(",", " ,"))
    assert main(["verify", str(run)]) == 1


@pytest.mark.parametrize("gone", ["deleted", "damaged"])
def test_a_report_without_a_cell_that_was_stored_says_so_and_remembers_it(
    tmp_path: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1))) as directory:
        directory.save(result())
        second = dataclasses.replace(result().rows[0], seed=1)
        directory.save(CellResult(Cell("cartpole", "bc", 1), [second]))
    lost = tmp_path / "cells/cartpole__bc__seed1.json"
    lost.write_text("{") if gone == "damaged" else lost.unlink()
    for _ in range(2):
        assert main(["report", str(tmp_path)]) == 1
        assert "cartpole__bc__seed1" in capsys.readouterr().err
        assert main(["verify", str(tmp_path)]) == 1
        assert lost.name in capsys.readouterr().out


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
def test_a_leaderboard_that_is_none_is_built_again(
    run: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    table = run / "leaderboard.md"
    before = table.read_bytes()
    table.unlink()
    if kind == "pipe":
        os.mkfifo(table)
    elif kind == "link":
        table.symlink_to("/etc/hostname")
    elif kind == "binary":
        table.write_bytes(b"\xff\x1b[2J")
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if not line.endswith("  leaderboard.md\n")))
    capsys.readouterr()
    assert main(["report", str(run)]) == 1
    assert table.read_bytes() == before


def test_rows_of_another_protocol_are_refused(run: Path) -> None:
    strange(run, protocol="native")
    with open_for_report(run) as directory:
        assert list(directory.load()[1].values()) == ["it was computed under another protocol"]


def test_a_short_write_to_the_list_of_checksums_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    try:
        with pytest.raises(OSError, match=r"No space left|File too large"):
            append(tmp_path / "list", b"x" * 101)
    finally:
        most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def test_names_that_no_file_can_have_are_damage(run: Path) -> None:
    with (run / SUMS).open("a") as sums:
        sums.write("0" * 64 + "  a\0b\n")
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 0


def test_another_runs_cell_is_damage(run: Path, tmp_path: Path) -> None:
    with open_for_run(tmp_path / "other", REQUEST) as directory:
        better = dataclasses.replace(result().rows[0], return_mean=9.0)
        directory.save(dataclasses.replace(result(), rows=[better]))
    name = "cells/cartpole__bc__seed0.json"
    (run / name).write_bytes((tmp_path / "other" / name).read_bytes())
    assert main(["verify", str(run)]) == 1


def test_cells_that_a_run_was_not_asked_for_are_left_out(run: Path) -> None:
    (run / "cells/cartpole__shaped__seed0.json").write_text(encode(result("shaped")))
    with open_for_report(run) as directory:
        found, unusable = directory.load()
    assert list(found) == [Cell("cartpole", "bc", 0)]
    assert list(unusable.values()) == ["this run was not asked for it"]


def test_folders_that_cannot_be_read_are_told(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listdir = os.listdir

    def refuse(folder: Path) -> list[str]:
        if folder.name == "cells":
            raise PermissionError(13, "Permission denied")
        return listdir(folder)

    monkeypatch.setattr("harness.store.store.os.listdir", refuse)
    with (
        pytest.raises(BadInput, match=r"cannot read .*cells: Permission denied"),
        open_to_verify(run) as opened,
    ):
        opened.damaged()


def test_a_moved_or_deleted_directory_ends_a_run_in_a_line(tmp_path: Path) -> None:
    with open_for_run(tmp_path / "run", REQUEST) as directory:
        (tmp_path / "run").rename(tmp_path / "moved")
        with pytest.raises(OSError, match="moved, deleted or changed while the run goes on"):
            directory.save(result())
    assert not (tmp_path / "run/cells").exists()


def test_a_run_does_not_write_into_another_one_that_took_its_place(tmp_path: Path) -> None:
    other = dataclasses.replace(REQUEST, conditions=dataclasses.replace(CONDITIONS, budget="quick"))
    for request in (other, REQUEST):  # of other conditions, and of the same
        with open_for_run(tmp_path / "run", REQUEST) as directory:
            (tmp_path / "run").rename(tmp_path / f"moved {request.conditions.budget}")
            with open_for_run(tmp_path / "run", request):
                before = snapshot(tmp_path / "run")
                for write in (lambda: directory.save(result()), lambda: directory.seal([], [])):
                    with pytest.raises(OSError, match="changed while the run goes on"):
                        write()
                assert snapshot(tmp_path / "run") == before
        (tmp_path / "run").rename(tmp_path / f"second {request.conditions.budget}")


def test_a_request_that_changes_while_the_run_goes_on_ends_it(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as directory:
        directory.save(result())
        (tmp_path / "run.json").write_text((tmp_path / "run.json").read_text().replace("smoke", "quick"))
        for write in (lambda: directory.save(result()), lambda: directory.seal([result()], [])):
            with pytest.raises(OSError, match="changed while the run goes on"):
                write()


def test_a_run_that_would_grow_beyond_what_can_be_read_is_refused(tmp_path: Path) -> None:
    write_request(tmp_path, dataclasses.replace(REQUEST, methods=tuple(f"m{i}" for i in range(200))))
    before = snapshot(tmp_path)
    with pytest.raises(BadInput, match="cannot hold so much"), open_for_run(tmp_path, REQUEST):
        pass
    assert snapshot(tmp_path) == before


def test_a_torn_last_line_of_the_list_is_mended_by_the_next_writer(run: Path) -> None:
    whole = (run / SUMS).read_bytes()
    for command in ("run", "report"):
        (run / SUMS).write_bytes(whole + whole[:90])
        (run / "report.key").unlink()
        assert main(["verify", str(run)]) == 1
        if command == "run":
            with open_for_run(run, REQUEST):
                assert (run / SUMS).read_bytes() == whole
        assert main(["report", str(run)]) == 0
        assert main(["verify", str(run)]) == 0


def test_a_swapped_cell_is_told_by_report(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strange(run, return_mean=999.0)
    for command in (["report"], ["compare", str(run)], ["report"]):
        assert main([*command, str(run)]) == 2  # it is the only cell
        said = capsys.readouterr().err
        assert "cartpole__bc__seed0.json: its checksum does not match" in said
        assert "holds no finished cell" in said


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


def test_a_users_cells_of_other_names_are_nobodys_damage(run: Path) -> None:
    (run / "cells/old_cartpole__bc__seed0.json").write_text("mine")
    assert main(["verify", str(run)]) == 0


def test_a_study_with_a_strangers_run_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    with open_study(tmp_path):
        pass
    (tmp_path / "native").mkdir()
    (tmp_path / "native/mine").write_text("mine")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    assert not (tmp_path / "absorbing").exists()
