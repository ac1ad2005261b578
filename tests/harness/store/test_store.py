"""A run's directory: what is stored comes back, or is named as damaged; and who may write where."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.records import LEARNED, Cell, CellResult
from harness.registry import BadInput, packages
from harness.store.database import FILE
from harness.store.files import SUMS, sha256_of
from harness.store.opening import open_for_report, open_for_run, open_to_verify
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
TWO = dataclasses.replace(REQUEST, seeds=(0, 1))


def with_learned(of: CellResult, data: bytes = b"x") -> tuple[CellResult, dict[str, bytes]]:
    return dataclasses.replace(of, learned=sha256_of(data)), {LEARNED: data}


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
        run.save(*with_learned(result()))
        assert list(run.load()[0]) == [CELL]
        assert run.handed_on(CELL)[LEARNED] == b"x"
    monkeypatch.setattr(packages, "version_of", lambda package: "0")
    with open_for_run(tmp_path, REQUEST) as run:
        results, unusable = run.load()
        assert results == {}
        assert "version" in unusable[run.place(NAME)]
        assert run.handed_on(CELL) == {}
    with open_for_report(tmp_path) as run:
        assert list(run.load()[0]) == [CELL]


def test_cells_that_a_run_was_not_asked_for_are_left_out(run: Path) -> None:
    strange(run, protocol="native")
    shaped = stored(run)
    shaped["cell"]["method"] = shaped["rows"][0]["method"] = "shaped"
    store(run, shaped, "cartpole__shaped__seed0")
    with open_for_report(run) as directory:
        assert directory.load()[1] == {
            directory.place(NAME): "it was computed under another protocol",
            directory.place("cartpole__shaped__seed0"): "this run was not asked for it",
        }


@pytest.mark.parametrize(
    ("lost", "how"),
    [
        (f"recordings/{RECORDING}", lambda run: (run / "recordings" / RECORDING).write_bytes(b"another")),
        (f"{FILE}/learned/{NAME}", lambda run: delete(run, NAME, "learned")),
        (f"{FILE}/learned/{NAME}", lambda run: store(run, b"of another cell", NAME, "learned")),
    ],
)
def test_a_cell_whose_recording_or_artifact_is_damaged_is_computed_again(
    tmp_path: Path, lost: str, how: Callable[[Path], object]
) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        its, files = recorded()
        its, learned = with_learned(its)
        run.save(its, files | learned)
        assert (list(run.load()[0]), run.handed_on(CELL)[LEARNED]) == ([CELL], b"x")
        how(tmp_path)
        assert run.load() == ({}, {run.place(NAME): f"{lost} is missing or damaged"})
        assert run.handed_on(CELL) == {}
    assert main(["verify", str(tmp_path)]) == 1
    with open_for_report(tmp_path) as run:
        assert list(run.load()[0]) == [CELL]


def test_what_a_cell_had_before_goes_with_its_new_result(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        first, files = recorded()
        first, learned = with_learned(first)
        run.save(first, files | learned)
        assert names(tmp_path, "learned") == [NAME]
        run.save(result())
        assert names(tmp_path, "learned") == []
        assert list((tmp_path / "recordings").iterdir()) == []
        assert run.damaged() == {}


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


@pytest.mark.parametrize("how", [delete, damage])
def test_a_cell_that_was_stored_and_is_gone_is_damage_and_no_full_report(
    tmp_path: Path, how: Callable[[Path, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, TWO) as directory:
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
        with open_for_run(run, TWO) as directory:
            directory.save(result(seed=1))
    elif how == "a changed list":
        (run / SUMS).write_text((run / SUMS).read_text().replace("scores.csv", "scores.txt"))
        said = f"{run / SUMS}: its checksum does not match"
    else:
        damage(run, "report", "run")
        said = f"{run / FILE}/run/report: its checksum does not match"
    assert main(["verify", str(run)]) == 1
    assert said in capsys.readouterr().out
    with open_for_run(run, REQUEST) as directory:
        assert not directory.is_sealed()
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0
