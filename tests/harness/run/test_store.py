"""A run's directory: what is stored comes back, or is named as damaged; and who may write where."""

import contextlib
import dataclasses
import errno
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.judge.results import FORMATS, LARGEST, Cell, CellResult, Conditions, Request, Row
from harness.registry import BadInput, packages
from harness.run import marked
from harness.run.codec import checksum, decode, encode
from harness.run.files import sha256_of, write_atomic
from harness.run.opening import open_for_report, open_for_run, open_to_verify
from harness.run.sums import SUMS

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
REQUEST = Request(("bc",), ("cartpole",), (0,), CONDITIONS)
CELL = Cell("cartpole", "bc", 0)
FLOATS = st.floats(-LARGEST, LARGEST) | st.just(math.nan)


def result(score: float = 1.5, cell: Cell = CELL) -> CellResult:
    row = Row(cell.env, cell.method, cell.seed, "pi_star", "absorbing", return_mean=score)
    return CellResult(
        cell, [row], {"loss": [(0.0, score), (1.0, math.nan)]}, {"pi_star": {"fell": 3}}, ["low"]
    )


@given(FLOATS)
def test_a_result_comes_back_bit_by_bit(score: float) -> None:
    there = decode(encode(result(score)))
    # repr tells every float from every other, and NaN equals NaN.
    assert repr(there) == repr(result(score))


@given(st.data())
def test_any_changed_byte_is_noticed_or_harmless(data: st.DataObject) -> None:
    whole = encode(result()).encode()
    at = data.draw(st.integers(0, len(whole) - 1))
    changed = bytearray(whole)
    changed[at] ^= 1 << data.draw(st.integers(0, 7))
    with contextlib.suppress(ValueError):
        assert repr(decode(bytes(changed))) == repr(result())  # it was white space


@pytest.mark.parametrize(
    "text", ["", "[]", "null", "3", "{}", '{"sha256": 1}', "[" * 100_000, b"\xff\xfe\x00"]
)
def test_anything_else_is_no_result(text: str | bytes) -> None:
    with pytest.raises(ValueError, match="stored cell"):
        decode(text)


def test_a_truncated_or_renamed_cell_is_named_and_the_others_load(tmp_path: Path) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=(0, 1, 2))) as run:
        for seed in range(3):
            run.save(result(seed, Cell("cartpole", "bc", seed)))
        cells = tmp_path / "cells"
        half = cells / "cartpole__bc__seed0.json"
        half.write_bytes(half.read_bytes()[:100])
        other = (cells / "cartpole__bc__seed1.json").rename(cells / "cartpole__bc__seed7.json")
        results, unusable = run.load()
    assert list(results) == [Cell("cartpole", "bc", 2)]
    assert set(unusable) == {half, other}


def test_what_another_version_computed_is_left_out_of_runs_but_not_of_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_for_run(tmp_path, REQUEST) as run:
        run.save(result())
    with open_for_run(tmp_path, REQUEST) as run:
        assert list(run.load()[0]) == [CELL]
    with monkeypatch.context() as changed:
        changed.setattr(packages, "version_of", lambda package: "0")
        with open_for_run(tmp_path, REQUEST) as run:
            found, unusable = run.load()
            assert found == {}
            assert {path.name: "version" in reason for path, reason in unusable.items()} == {
                f"{CELL.name}.json": True
            }
            run.save(result(2.5))
            assert run.load()[0][CELL].rows[0].return_mean == 2.5
    with open_for_report(tmp_path) as run:
        assert run.load()[0][CELL].rows[0].return_mean == 2.5


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A run's directory with a file of every kind."""
    with open_for_run(tmp_path, REQUEST) as run:
        derived = ("scores.csv", "leaderboard.csv", "leaderboard.md", "report.html", "figures/a.png")
        for name in derived:
            write_atomic(tmp_path / name, f"what {name} holds")
        files = {"recordings/a.rrd": b"a recording", "artifacts/a.safetensors": b"what was learned"}
        names = {"recordings": "a.rrd", "artifacts": "a.safetensors"}
        digests: Any = {at: {name: sha256_of(files[f"{at}/{name}"])} for at, name in names.items()}
        run.save(dataclasses.replace(result(), **digests), files)
        run.seal(list(run.load()[0].values()), [tmp_path / name for name in derived])
        assert run.damaged() == {}
    return tmp_path


@pytest.mark.parametrize("damage", ["flip", "truncate", "empty", "delete"])
def test_whatever_is_damaged_is_named(whole: Path, damage: str) -> None:
    files = [file for file in whole.rglob("*") if file.is_file() and file.name not in (".lock", "run.json")]
    assert len(files) == 10
    rng = np.random.default_rng(0)
    for file in files:
        before = file.read_bytes()
        place = int(rng.integers(len(before)))
        flipped = before[:place] + bytes([before[place] ^ 1 << int(rng.integers(8))]) + before[place + 1 :]
        file.write_bytes({"flip": flipped, "truncate": before[: len(before) // 2]}.get(damage, b""))
        if damage == "delete":
            file.unlink()
        with open_for_report(whole) as run:
            damaged = run.damaged()
        if file.name == SUMS:  # then no file is as it says
            assert damaged
        else:
            assert set(damaged) == {file}
        file.write_bytes(before)
    with open_for_report(whole) as run:
        assert run.damaged() == {}


def test_what_nobody_can_write_to_is_read_all_the_same(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(marked, "locked", refuse)
    with open_to_verify(whole) as run:
        assert run.damaged() == {}
    with pytest.raises(BadInput, match="cannot write to"), open_for_report(whole):
        pass


@pytest.mark.parametrize("damage", ["flip", "truncate", "empty"])
def test_a_damaged_request_is_refused(whole: Path, damage: str) -> None:
    file = whole / "run.json"
    text = file.read_text()
    assert '"seeds": 1' in text
    damages = {"flip": text.replace('"seeds": 1', '"seeds": 3'), "truncate": text[:40], "empty": ""}
    file.write_text(damages[damage])
    for another in (open_for_run(whole, REQUEST), open_for_report(whole)):
        with pytest.raises(BadInput, match="is damaged"), another:
            pass


@pytest.mark.parametrize("name", ["a.rrd", "absent.rrd"])
def test_a_cell_whose_recording_is_gone_is_computed_again(whole: Path, name: str) -> None:
    (whole / "recordings/a.rrd").write_bytes(b"another")
    with open_for_run(whole, REQUEST) as run:
        run.save(dataclasses.replace(result(), recordings={name: "0" * 64}))
        found, unusable = run.load()
        assert found == {}
        assert list(unusable.values()) == [f"recordings/{name} is missing or damaged"]
    with open_for_report(whole) as run:
        assert list(run.load()[0]) == [CELL]


def test_a_cell_whose_artifact_is_damaged_is_computed_again(whole: Path) -> None:
    (whole / "artifacts/a.safetensors").write_bytes(b"another")
    with open_for_run(whole, REQUEST) as run:
        found, unusable = run.load()
        assert found == {}
        assert list(unusable.values()) == ["artifacts/a.safetensors is missing or damaged"]


def test_a_cell_goes_on_from_what_this_version_learned_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"{CELL.name}.safetensors"
    with open_for_run(tmp_path, REQUEST) as run:
        assert run.learned(CELL) == b""
        run.save(
            dataclasses.replace(result(), artifacts={name: sha256_of(b"x")}), {f"artifacts/{name}": b"x"}
        )
        assert run.learned(CELL) == b"x"
        (tmp_path / "artifacts" / name).write_bytes(b"y")
        assert run.learned(CELL) == b""
        (tmp_path / "artifacts" / name).write_bytes(b"x")
        assert run.learned(CELL) == b"x"
    monkeypatch.setattr(packages, "version_of", lambda package: "0")
    with open_for_run(tmp_path, REQUEST) as run:
        assert run.learned(CELL) == b""


def test_what_a_cell_had_before_goes_with_its_new_result(tmp_path: Path) -> None:
    name = f"{CELL.name}.safetensors"
    with open_for_run(tmp_path, REQUEST) as run:
        kept = {"artifacts": {name: sha256_of(b"x")}}
        run.save(dataclasses.replace(result(), **kept), {f"artifacts/{name}": b"x"})
        assert (tmp_path / "artifacts" / name).exists()
        run.save(result())
        assert not (tmp_path / "artifacts" / name).exists()
        run.seal(list(run.load()[0].values()), [])
        assert tmp_path / "artifacts" / name not in run.damaged()


def test_time_does_not_run_back(whole: Path) -> None:
    stored = json.loads((whole / "cells" / f"{CELL.name}.json").read_text())["result"]
    stored["seconds"] = {"fit": -1.0}
    with pytest.raises(ValueError, match="seconds"):
        decode(json.dumps({"sha256": checksum(stored), "result": stored}))


def test_a_cell_of_before_a_field_was_there_has_its_default(whole: Path) -> None:
    file = whole / "cells" / f"{CELL.name}.json"
    stored = json.loads(file.read_text())["result"]
    for name in ("artifacts", "seconds"):
        del stored[name]
    found = decode(json.dumps({"sha256": checksum(stored), "result": stored}))
    assert (found.artifacts, found.seconds) == ({}, {})
    stored["another"] = 1
    with pytest.raises(ValueError, match="holds more than a cell does"):
        decode(json.dumps({"sha256": checksum(stored), "result": stored}))


@pytest.mark.parametrize(
    ("seeds", "stored"), [((0, 1, 2), 3), ((0,), 1), ((7,), [7]), ((0, 2, 3), [0, 2, 3])]
)
def test_seeds_are_stored_as_a_count_or_by_number(
    tmp_path: Path, seeds: tuple[int, ...], stored: object
) -> None:
    request = dataclasses.replace(REQUEST, seeds=seeds)
    with open_for_run(tmp_path, request) as run:
        assert {cell.seed for cell in run.request.cells} == set(seeds)
    assert json.loads((tmp_path / "run.json").read_text())["seeds"] == stored
    with open_for_report(tmp_path) as run:
        assert run.request == request


@pytest.mark.parametrize("seeds", [[], [1, 0], [0, 0], [-1], [1000], 0, 1001, True, "3", [0.5]])
def test_seeds_that_are_none_are_refused(tmp_path: Path, seeds: object) -> None:
    with open_for_run(tmp_path, REQUEST):
        pass
    data = json.loads((tmp_path / "run.json").read_text()) | {"seeds": seeds}
    del data["sha256"]
    (tmp_path / "run.json").write_text(json.dumps({"sha256": checksum(data), **data}))
    with pytest.raises(BadInput, match="is damaged"), open_for_report(tmp_path):
        pass


def test_a_run_directory_grows_and_remembers_everything_asked_of_it(tmp_path: Path) -> None:
    more = Request(("shaped",), ("highway",), tuple(range(3)), CONDITIONS)
    for request in (REQUEST, more, REQUEST):
        with open_for_run(tmp_path / "a/b", request):
            pass
    stored = json.loads((tmp_path / "a/b/run.json").read_text())
    assert len(stored.pop("sha256")) == 64
    assert stored == {
        "format": FORMATS[0],
        "methods": ["shaped", "bc"],
        "envs": ["cartpole", "highway"],
        "seeds": 3,
        "budget": "smoke",
        "protocol": "absorbing",
        "rl": "sbx",
        "deterministic": True,
        "experts": "shipped",
        "record": "both",
    }


def stored(**changes: object) -> str:
    """A run.json that REQUEST fits, but for the changes."""
    asked = {"methods": ["bc"], "envs": ["cartpole"], "seeds": 1}
    data = {"format": FORMATS[0], **asked, **dataclasses.asdict(CONDITIONS), **changes}
    return json.dumps({"sha256": checksum(data), **data})


def test_a_run_that_recorded_first_episodes_goes_on_with_others(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(stored(record="first"))
    with open_for_run(tmp_path, REQUEST) as run:
        assert run.request.conditions == CONDITIONS
    assert json.loads((tmp_path / "run.json").read_text())["record"] == CONDITIONS.record


def snapshot(path: Path) -> dict[str, bytes]:
    return {str(file): file.read_bytes() for file in path.rglob("*") if file.is_file()}


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        (stored(budget="full"), "budget full, not smoke"),
        (stored(protocol="native"), "protocol native, not absorbing"),
        (stored(rl="sb3"), "rl sb3, not sbx"),
        (stored(record="none"), "record none, not both"),
        (stored(format=99, envs=None), "format 99"),
        (stored(envs=None), "damaged"),
        (stored()[:-9], "damaged"),
        ("[]", "damaged"),
        (None, "holds no run"),
    ],
)
def test_another_run_is_refused_and_left_as_it_was(tmp_path: Path, stored: str | None, message: str) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    if stored is not None:
        (tmp_path / "run.json").write_text(stored)
    before = snapshot(tmp_path)
    with pytest.raises(BadInput, match=message), open_for_run(tmp_path, REQUEST):
        pass
    assert snapshot(tmp_path) == before


def test_a_path_where_no_directory_can_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below", tmp_path / ("x" * 300), Path("/proc/nowhere")):
        with pytest.raises(BadInput, match="cannot"), open_for_run(path, REQUEST):
            pass
    assert snapshot(tmp_path) == {str(tmp_path / "file"): b""}


def test_the_second_writer_is_told_who_the_first_is(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST):
        for another in (open_for_run(tmp_path, REQUEST), open_for_report(tmp_path)):
            with pytest.raises(BadInput, match=f"in use by another run .process {os.getpid()}"), another:
                pass
    with open_for_report(tmp_path):
        pass


def test_a_run_killed_before_its_first_whole_file_can_be_started_again(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / ".run.json.0123456789abcdef.tmp").write_text("{")
    with open_for_run(tmp_path, REQUEST):
        assert sorted(file.name for file in tmp_path.iterdir()) == [".lock", SUMS, "run.json"]
