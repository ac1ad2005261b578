"""A run's directory: what is stored comes back, or is named as damaged; and who may write where."""

import contextlib
import dataclasses
import errno
import math
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.cli.main import main
from harness.records import LEARNED, Cell, CellResult, Conditions, Row
from harness.registry import BadInput, packages
from harness.registry.bounds import LARGEST
from harness.store import marked
from harness.store.codec import decode, encode
from harness.store.database import FILE
from harness.store.files import sha256_of
from harness.store.opening import open_for_report, open_for_run, open_to_plan, open_to_verify
from harness.store.request import Request
from harness.store.sums import SUMS
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
    run,
    snapshot,
    store,
    stored,
)

__all__ = ["run"]

CELL = Cell("cartpole", "bc", 0)
FLOATS = st.floats(-LARGEST, LARGEST) | st.just(math.nan)


def result(score: float = 1.5, cell: Cell = CELL) -> CellResult:
    row = Row(cell.env, cell.method, cell.seed, "pi_star", "absorbing", return_mean=score)
    return CellResult(
        cell, [row], {"loss": [(0.0, score), (1.0, math.nan)]}, {"pi_star": {"fell": 3}}, ["low"]
    )


def with_learned(data: bytes = b"x") -> tuple[CellResult, dict[str, bytes]]:
    return dataclasses.replace(result(), learned=sha256_of(data)), {LEARNED: data}


@given(FLOATS)
def test_a_result_comes_back_bit_by_bit(score: float) -> None:
    # repr tells every float from every other, and NaN equals NaN.
    assert repr(decode(encode(result(score)))) == repr(result(score))


@pytest.mark.parametrize("text", ["", "[]", "null", "3", "{}", "[" * 100_000, b"\xff\xfe\x00"])
def test_anything_else_is_no_result(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"no JSON of a run|Expected|missing"):
        decode(text)


def test_a_damaged_or_renamed_cell_is_named_and_the_others_load(tmp_path: Path) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1, 2))) as run:
        for seed in range(3):
            run.save(result(seed, Cell("cartpole", "bc", seed)))
        damage(tmp_path)
        execute(tmp_path, "UPDATE cells SET name = 'cartpole__bc__seed7' WHERE name = 'cartpole__bc__seed1'")
        results, unusable = run.load()
    assert list(results) == [Cell("cartpole", "bc", 2)]
    assert unusable == {
        run.place(NAME): "its checksum does not match",
        run.place("cartpole__bc__seed7"): "holds the cell cartpole__bc__seed1",
    }


def test_what_another_version_computed_is_left_out_of_runs_but_not_of_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned())
        assert list(run.load()[0]) == [CELL]
        assert run.learned(CELL) == b"x"
    with monkeypatch.context() as changed:
        changed.setattr(packages, "version_of", lambda package: "0")
        with open_for_run(tmp_path, REQUEST) as run:
            results, unusable = run.load()
            assert (results, list(unusable)) == ({}, [run.place(NAME)])
            assert "version" in unusable[run.place(NAME)]
            assert run.learned(CELL) == b""
            run.save(result(2.5))
            assert run.load()[0][CELL].rows[0].return_mean == 2.5
    with open_for_report(tmp_path) as run:
        assert run.load()[0][CELL].rows[0].return_mean == 2.5


def test_what_nobody_can_write_to_is_read_all_the_same(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(marked, "locked", refuse)
    with open_to_verify(run) as opened:
        assert opened.damaged() == {}
    with pytest.raises(BadInput, match="cannot write to"), open_for_report(run):
        pass


@pytest.mark.parametrize("name", [RECORDING, "absent.rrd"])
def test_a_cell_whose_recording_is_gone_is_computed_again(run: Path, name: str) -> None:
    (run / "recordings" / RECORDING).write_bytes(b"another")
    with open_for_run(run, REQUEST) as opened:
        opened.save(dataclasses.replace(result(), recordings={name: "0" * 64}))
        found, unusable = opened.load()
        assert found == {}
        assert list(unusable.values()) == [f"recordings/{name} is missing or damaged"]
    with open_for_report(run) as opened:
        assert list(opened.load()[0]) == [CELL]


@pytest.mark.parametrize("how", ["damaged", "deleted", "swapped"])
def test_a_cell_whose_artifact_is_damaged_is_computed_again(tmp_path: Path, how: str) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned(b"1"))
        assert run.learned(CELL) == b"1"
        assert run.load()[0]
        if how == "damaged":
            execute(tmp_path, "UPDATE learned SET data = CAST('2' AS BLOB)")
        elif how == "deleted":
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


def test_fields_that_a_stored_cell_lacks_have_their_defaults_and_others_are_refused(run: Path) -> None:
    cell = stored(run)
    for name in ("learned", "seconds", "settings"):
        del cell[name]
    found = decode(encode(cell))
    assert (found.learned, found.seconds, found.settings) == ("", {}, {})
    with pytest.raises(ValueError, match="holds more than a CellResult"):
        decode(encode(cell | {"another": 1}))
    with pytest.raises(ValueError, match="seconds"):  # time does not run back
        decode(encode(cell | {"seconds": {"fit": -1.0}}))


@pytest.mark.parametrize("seeds", [[], [1, 0], [0, 0], [-1], [1000], 0, 1001, True, "3", [0.5]])
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
    [
        ({"budget": "full"}, "budget full, not smoke"),
        ({"protocol": "native"}, "protocol native, not absorbing"),
        ({"rl": "sb3"}, "rl sb3, not sbx"),
        ({"record": "none"}, "record none, not both"),
    ],
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


def test_a_run_of_an_earlier_version_is_refused_and_its_tables_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import irl_bench

    (tmp_path / "run.json").write_text("{}")
    for name in ("scores.csv", "leaderboard.csv"):
        (tmp_path / name).write_text("env,score\ncartpole,1.0\n")
    before = snapshot(tmp_path)
    for command in (["report"], ["verify"], ["compare", str(tmp_path)], ["run", "--out"]):
        assert main([*command, str(tmp_path)]) == 2
        said = capsys.readouterr().err
        assert "holds a run of an earlier version: its numbers are in scores.csv" in said
        assert said.count("\n") == 1
    assert snapshot(tmp_path) == before
    assert len(irl_bench.load(tmp_path).scores) == 1


def test_a_path_where_no_directory_can_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below", tmp_path / ("x" * 300), Path("/proc/nowhere")):
        with pytest.raises(BadInput, match="cannot"), open_for_run(path, REQUEST):
            pass
    assert snapshot(tmp_path) == {str(tmp_path / "file"): b""}


def test_the_second_writer_is_told_who_the_first_is(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST):
        for another in (open_for_run(tmp_path, REQUEST), open_for_report(tmp_path), open_to_verify(tmp_path)):
            with pytest.raises(BadInput, match=f"in use by another run .process {os.getpid()}"), another:
                pass
    with open_for_report(tmp_path):
        pass


@pytest.mark.parametrize("begun", [b"", b"half a page"])
def test_a_run_killed_before_its_first_whole_file_can_be_started_again(tmp_path: Path, begun: bytes) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / FILE).touch()
    (tmp_path / f"{FILE}-journal").write_bytes(begun)
    with open_for_run(tmp_path, REQUEST):
        assert sorted(file.name for file in tmp_path.iterdir()) == [".lock", FILE]


def test_a_cell_is_whole_or_absent_where_its_transaction_fails(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(*with_learned())
        with contextlib.suppress(KeyboardInterrupt), run._database.writing():
            run._database.put("cells", NAME, "half")
            raise KeyboardInterrupt
        assert run.damaged() == {}
        assert run.learned(CELL) == b"x"
    assert SUMS not in os.listdir(tmp_path)
