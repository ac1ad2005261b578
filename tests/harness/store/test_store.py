"""A run's directory: what is stored comes back, or is named as damaged; and who may write where."""

import contextlib
import dataclasses
import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.records import LEARNED, Cell, CellResult, Conditions
from harness.registry import BadInput, packages
from harness.store.database import FILE
from harness.store.files import SUMS, sha256_of
from harness.store.opening import open_for_report, open_for_run, open_to_plan, open_to_verify
from harness.store.request import Request
from tests.harness.small_runs import (
    CONDITIONS,
    NAME,
    RECORDING,
    REQUEST,
    damage,
    delete,
    execute,
    names,
    recorded,
    result,
    run,
    snapshot,
    store,
    stored,
    strange,
)

__all__ = ["run"]

CELL = Cell("cartpole", "bc", 0)
SECOND = "cartpole__bc__seed1"


def with_learned(data: bytes = b"x") -> tuple[CellResult, dict[str, bytes]]:
    return dataclasses.replace(result(), learned=sha256_of(data)), {LEARNED: data}


def test_a_damaged_or_renamed_cell_is_named_and_the_others_load(tmp_path: Path) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1, 2))) as run:
        for seed in range(3):
            run.save(result(seed=seed))
        damage(tmp_path)
        execute(tmp_path, "UPDATE cells SET name = 'cartpole__bc__seed7' WHERE name = ?", SECOND)
        results, unusable = run.load()
    assert list(results) == [Cell("cartpole", "bc", 2)]
    assert unusable == {
        run.place(NAME): "its checksum does not match",
        run.place("cartpole__bc__seed7"): f"holds the cell {SECOND}",
    }


def test_what_another_version_computed_is_left_out_of_runs_but_not_of_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned())
        assert list(run.load()[0]) == [CELL]
        assert run.learned(CELL) == b"x"
    monkeypatch.setattr(packages, "version_of", lambda package: "0")
    with open_for_run(tmp_path, REQUEST) as run:
        results, unusable = run.load()
        assert results == {}
        assert "version" in unusable[run.place(NAME)]
        assert run.learned(CELL) == b""
    with open_for_report(tmp_path) as run:
        assert list(run.load()[0]) == [CELL]


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


def test_what_nobody_can_write_to_is_read_all_the_same(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opening = os.open

    def refuse(path: Path, flags: int, *more: int) -> int:
        if flags & (os.O_CREAT | os.O_RDWR):
            raise PermissionError(errno.EROFS, "Read-only file system")
        return opening(path, flags, *more)

    monkeypatch.setattr(os, "open", refuse)
    with open_to_verify(run) as opened:
        assert opened.damaged() == {}
    with pytest.raises(BadInput, match="cannot write to"), open_for_report(run):
        pass


def test_a_cell_whose_recording_is_gone_is_computed_again(run: Path) -> None:
    (run / "recordings" / RECORDING).write_bytes(b"another")
    with open_for_run(run, REQUEST) as opened:
        opened.save(dataclasses.replace(result(), recordings={RECORDING: "0" * 64}))
        found, unusable = opened.load()
        assert found == {}
        assert list(unusable.values()) == [f"recordings/{RECORDING} is missing or damaged"]
    with open_for_report(run) as opened:
        assert list(opened.load()[0]) == [CELL]


@pytest.mark.parametrize("how", ["deleted", "swapped"])
def test_a_cell_whose_artifact_is_damaged_is_computed_again(tmp_path: Path, how: str) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned(b"1"))
        assert run.learned(CELL) == b"1"
        if how == "deleted":
            delete(tmp_path, NAME, "learned")
        else:
            store(tmp_path, b"of another cell", NAME, "learned")
        assert run.learned(CELL) == b""
        assert run.load() == ({}, {run.place(NAME): f"{FILE}/learned/{NAME} is missing or damaged"})
    assert main(["verify", str(tmp_path)]) == 1


def test_what_a_cell_had_before_goes_with_its_new_result(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        first, files = recorded()
        run.save(dataclasses.replace(first, learned=sha256_of(b"x")), files | {LEARNED: b"x"})
        assert names(tmp_path, "learned") == [NAME]
        run.save(result())
        assert names(tmp_path, "learned") == []
        assert list((tmp_path / "recordings").iterdir()) == []
        assert run.damaged() == {}


def test_a_cell_is_whole_or_absent_where_its_transaction_fails(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned())
        with contextlib.suppress(KeyboardInterrupt), run._database.writing():
            run._database.put("cells", NAME, "half")
            raise KeyboardInterrupt
        assert run.damaged() == {}
        assert run.learned(CELL) == b"x"


@pytest.mark.parametrize("seeds", [[], [1, 0], [-1], [1000], 0, "3", [0.5]])
def test_a_request_that_is_none_is_damaged(tmp_path: Path, seeds: object) -> None:
    with open_for_run(tmp_path, REQUEST):
        pass
    store(tmp_path, stored(tmp_path, "request", "run") | {"seeds": seeds}, "request", "run")
    for another in (open_for_report(tmp_path), open_to_verify(tmp_path)):
        with pytest.raises(BadInput, match="is damaged: what was asked for"), another:
            pass


def test_a_run_directory_grows_and_remembers_everything_asked_of_it(tmp_path: Path) -> None:
    more = Request(("shaped",), ("highway",), (0, 2, 3), CONDITIONS)
    for request in (REQUEST, more, REQUEST):
        with open_for_run(tmp_path / "a/b", request) as run:
            pass
    expected = Request(("shaped", "bc"), ("cartpole", "highway"), (0, 2, 3), CONDITIONS)
    assert run.request == expected
    with open_to_verify(tmp_path / "a/b") as run:
        assert run.request == expected
    assert sorted(os.listdir(tmp_path / "a/b")) == [".lock", FILE]


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"budget": "full"}, "budget full, not smoke"), ({"record": "none"}, "record none, not both")],
)
def test_another_run_is_refused_and_left_as_it_was(
    tmp_path: Path, changes: dict[str, str], message: str
) -> None:
    conditions: Conditions = dataclasses.replace(CONDITIONS, **changes)  # type: ignore[arg-type]
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, conditions=conditions)):
        pass
    before = snapshot(tmp_path)
    for another in (open_for_run(tmp_path, REQUEST), open_to_plan(tmp_path, REQUEST, {})):
        with pytest.raises(BadInput, match=message), another:
            pass
    assert snapshot(tmp_path) == before


def test_a_run_that_would_grow_beyond_what_can_be_read_is_refused(tmp_path: Path) -> None:
    many = Request(tuple(f"m{i}" for i in range(200)), ("cartpole",), (0,), CONDITIONS)
    with open_for_run(tmp_path, many):
        pass
    with pytest.raises(BadInput, match="cannot hold so much"), open_for_run(tmp_path, REQUEST):
        pass


def test_a_path_where_no_directory_can_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below", tmp_path / ("x" * 300), Path("/proc/nowhere")):
        with pytest.raises(BadInput, match="cannot"), open_for_run(path, REQUEST):
            pass
    assert snapshot(tmp_path) == {str(tmp_path / "file"): b""}


def test_one_may_write_and_many_may_read(run: Path) -> None:
    in_use = f"in use by another run .process {os.getpid()}"
    with open_for_run(run, REQUEST):
        for another in (open_for_run(run, REQUEST), open_for_report(run), open_to_verify(run)):
            with pytest.raises(BadInput, match=in_use), another:
                pass
    with open_to_verify(run):
        assert main(["verify", str(run)]) == 0
        with pytest.raises(BadInput, match="in use"), open_for_report(run):
            pass


def test_a_run_does_not_write_into_another_one_that_took_its_place(tmp_path: Path) -> None:
    with open_for_run(tmp_path / "run", REQUEST) as directory:
        (tmp_path / "run").rename(tmp_path / "moved")
        for _ in range(2):  # gone, and another's
            for write in (lambda: directory.save(*recorded()), lambda: directory.seal([], [])):
                before = snapshot(tmp_path)
                with pytest.raises(OSError, match="moved, deleted or changed while the run goes on"):
                    write()
                assert snapshot(tmp_path) == before
            with open_for_run(tmp_path / "run", REQUEST):
                pass


@pytest.mark.parametrize("begun", [b"", b"half a page"])
def test_a_run_killed_before_its_first_whole_file_can_be_started_again(tmp_path: Path, begun: bytes) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / FILE).touch()
    (tmp_path / f"{FILE}-journal").write_bytes(begun)
    with open_for_run(tmp_path, REQUEST):
        assert sorted(file.name for file in tmp_path.iterdir()) == [".lock", FILE]


@pytest.mark.parametrize("gone", ["recordings/*", "scores.csv", "report.html", SUMS])
def test_whatever_a_run_had_and_has_no_more_is_damage(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in run.glob(gone):
        path.unlink()
    capsys.readouterr()
    assert main(["verify", str(run)]) == 1
    assert capsys.readouterr().out.endswith(": missing\n")
    assert main(["report", str(run)]) == (1 if "recordings" in gone else 0)
    assert main(["verify", str(run)]) == (1 if "recordings" in gone else 0)


@pytest.mark.parametrize("how", [delete, damage])
def test_a_cell_that_was_stored_and_is_gone_is_damage_and_no_full_report(
    tmp_path: Path, how: Callable[[Path, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1))) as directory:
        for seed in (0, 1):
            directory.save(result(seed=seed))
    assert main(["report", str(tmp_path)]) == 0
    assert main(["verify", str(tmp_path)]) == 0
    how(tmp_path, SECOND)
    assert main(["verify", str(tmp_path)]) == 1
    capsys.readouterr()
    assert main(["report", str(tmp_path)]) == (how is damage)
    assert how is delete or SECOND in capsys.readouterr().err
    assert "not complete: 1 of the 18 cells" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("how", ["another run's", "stored since", "a changed list", "the report's note"])
def test_tables_of_other_cells_or_lists_are_damage_and_mended_by_report(
    run: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = f"{run / 'scores.csv'}: cells were stored or lost since it was written"
    if how == "another run's":  # valid in itself
        strange(run, return_mean=9.0)
    elif how == "stored since":
        with open_for_run(run, dataclasses.replace(REQUEST, seeds=(0, 1))) as directory:
            directory.save(result(seed=1))
    elif how == "a changed list":
        lines = (run / SUMS).read_text().splitlines(keepends=True)
        (run / SUMS).write_text("".join(line for line in lines if not line.endswith("  scores.csv\n")))
        said = f"{run / SUMS}: its checksum does not match"
    else:
        damage(run, "report", "run")
        said = f"{run / FILE}/run/report: its checksum does not match"
    capsys.readouterr()
    assert main(["verify", str(run)]) == 1
    assert said in capsys.readouterr().out
    with open_for_run(run, REQUEST) as directory:
        assert not directory.is_sealed()
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0
