"""A run from the command line goes on, is planned, computes again what was lost, and says what it found."""

import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from harness.report.model import Report
from harness.schedule import plan
from harness.schedule.events import AnyEvent, Begun, Ended, Reported
from tests.harness.fake_runs import PER_SEED, SMOKE, computed, faults, scores
from tests.harness.small_runs import damage, snapshot

Main = Callable[..., tuple[int, str, str]]


def test_a_run_goes_on_where_it_stopped_and_may_grow(main: Main, tmp_path: Path) -> None:
    run = Path("results/latest")
    code, out, err = main(*SMOKE, "--methods", "bc,bc", "--workers", "2")
    assert code == 0
    assert f"{PER_SEED + 1} ok; budget smoke, protocol absorbing, seed 0; NOT A RESULT" in out
    assert err == "WARNING: cartpole: low bar\n"
    assert len(computed(run)) == PER_SEED + 1
    before = scores(run)
    code, out, _ = main(*SMOKE, "--methods", "shaped,bc,maxent_linear", "--seeds", "2")
    assert code == 0
    assert f"{PER_SEED + 5} cells to run, {PER_SEED + 1} kept" in out
    assert len(computed(run)) == len(set(computed(run))) == 2 * (PER_SEED + 3)
    assert before.items() <= scores(run).items()
    code, _, err = main("run", "--budget", "quick")
    assert (code, err) == (
        2,
        f"irl-bench: error: {run} holds a run with budget smoke, not quick; give another --out "
        "(docs/commands.md)\n",
    )


def test_a_plan_counts_what_a_run_would_compute_and_writes_nothing(
    main: Main, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IRL_BENCH_CACHE", str(tmp_path_factory.mktemp("cache")))  # with no measured seconds
    asked = (*SMOKE, "--methods", "bc,shaped", "--seeds", "2", "--out", "run")
    code, out, _ = main(*asked, "--plan")
    assert (code, list(tmp_path.iterdir())) == (0, [])
    every = 2 * (PER_SEED + 2)
    assert out.startswith(f"{every} cells: 0 kept from before, in run; 0 of a baseline; {every} to run\n")
    assert re.search(r"cartpole bc +2 .*a guess", out)
    for cores in plan.CORES:
        assert re.search(rf"wall time with {cores:,} cores: \d+:\d\d\n", out)
    assert main(*SMOKE, "--methods", "bc", "--out", "run")[0] == 0
    before = snapshot(tmp_path)
    code, out, _ = main(*asked, "--plan")
    there = PER_SEED + 1
    assert out.startswith(
        f"{every} cells: {there} kept from before, in run; 0 of a baseline; {every - there}"
    )
    assert re.search(r"cartpole bc +1 +[0-9.]+\n", out), "measured by now"
    code, out, _ = main(*asked[:-1], "other", "--baseline", "run", "--plan")
    assert f"0 kept from before, in other; {there} of a baseline; {every - there} to run" in out
    assert snapshot(tmp_path) == before
    code, out, _ = main(*asked)
    assert (code, out.splitlines()[0].split(",")[0]) == (0, f"{every - there} cells to run")
    assert main(*asked, "--plan")[1].endswith("; 0 to run\n")


def test_for_programs_standard_output_is_json_and_text_goes_to_standard_error(
    main: Main, tmp_path: Path
) -> None:
    faults(tmp_path, cartpole__control_true__seed0="raise")
    asked = (*SMOKE, "--methods", "bc", "--out", "run", "--json-progress")
    code, out, err = main(*asked)
    assert code == 1
    told = [msgspec.json.decode(line, type=AnyEvent) for line in out.splitlines()]
    assert (type(told[0]), told[0].cells) == (Begun, PER_SEED + 1)
    ends = {one.name: one for one in told if isinstance(one, Ended)}
    assert len(ends) == PER_SEED + 2
    assert ends["cartpole__control_true__seed0"].status == "failed"
    assert ends["cartpole__bc__seed0"].returns == {"pi_star": 2.0, "pi_R": 2.0}
    assert (told[-2].cells_done, told[-2].cells_failed) == (PER_SEED + 1, 1)
    assert isinstance(told[-1], Reported)
    assert (told[-1].directory, told[-1].failed) == ("run", ["cartpole__control_true__seed0"])
    assert len(told[-1].found) == 5
    assert f"{PER_SEED + 1} cells to run" in err
    assert all(line in err for line in told[-1].found)
    code, out, _ = main(*asked)
    assert [json.loads(line)["event"] for line in out.splitlines()] == ["reported"]


def test_tables_are_printed_when_asked(main: Main) -> None:
    assert "Behind the best" not in main(*SMOKE, "--methods", "bc", "--out", "run")[1]
    assert "Behind the best" not in main("report", "run")[1]
    out = main("report", "run", "--print")[1]
    assert (
        "cartpole; NOT A RESULT: budget smoke only shows that everything runs; one seed ranks no methods"
        in out
    )
    assert re.search(r" control_true +pi_R ", out)


def test_printing_tables_writes_nothing(main: Main, tmp_path: Path) -> None:
    main(*SMOKE, "--methods", "bc", "--out", "run")
    (tmp_path / "run" / "scores.csv").write_text("damaged")
    before = snapshot(tmp_path)
    assert "Behind the best" in main("report", "run", "--print")[1]
    assert snapshot(tmp_path) == before


def test_all_runs_below_a_folder_are_verified(main: Main, tmp_path: Path) -> None:
    for name in ("one", "two"):
        main(*SMOKE, "--methods", "bc", "--out", f"study/{name}")
    assert main("verify", "study")[0] == 0
    (tmp_path / "study/two/scores.csv").write_text("damaged")
    code, out, _ = main("verify", "study")
    assert code == 1
    assert "study/one: every file that has a checksum is as it was written" in out
    assert "study/two/scores.csv: " in out


def test_a_directory_of_runs_is_named_as_one(main: Main, tmp_path: Path) -> None:
    for name in ("absorbing", "native"):
        (tmp_path / "study" / name).mkdir(parents=True)
        (tmp_path / "study" / name / "run.sqlite").write_text("{}")
    expected = "runs in it are study/absorbing, study/native: name one\n"
    assert main("report", "study") == (2, "", f"irl-bench: error: study holds no run; {expected}")
    (tmp_path / "study/study.json").write_text("{}")
    told = f"irl-bench: error: study holds a study (its tables: study.md); {expected}"
    assert main("report", "study") == (2, "", told)


def test_what_was_damaged_is_computed_again_and_what_failed_when_asked(main: Main, tmp_path: Path) -> None:
    faults(tmp_path, cartpole__bc__seed0="raise")
    code, out, err = main(*SMOKE, "--methods", "bc", "--out", "run")
    assert code == 1
    assert f"{PER_SEED} ok, 1 failed; " in out
    assert "FAILED: cartpole__bc__seed0: ValueError: two lines; in faked (fake_cells.py:" in err
    damaged = Path("run/run.sqlite/cartpole__reference__seed0")
    damage(tmp_path / "run", damaged.name)
    code, _, err = main("report", "run")
    assert code == 1
    assert f"left out: {damaged}: its checksum does not match" in err
    (tmp_path / "faults.json").unlink()
    code, out, err = main(*SMOKE, "--methods", "bc", "--out", "run")
    assert code == 1
    assert f"1 cells to run, {PER_SEED} kept" in out
    assert f"{damaged.name}: its checksum does not match" in err
    assert "FAILED: cartpole__bc__seed0: ValueError" in err
    code, out, err = main(*SMOKE, "--methods", "bc", "--out", "run", "--retry-failed")
    assert code == 0
    assert f"1 cells to run, {PER_SEED} kept" in out
    assert computed(tmp_path / "run")[PER_SEED + 1 :] == ["cartpole__reference__seed0", "cartpole__bc__seed0"]
    assert main("report", "run")[0] == 0


def test_cells_that_fail_alike_are_one_line(main: Main, tmp_path: Path) -> None:
    faults(tmp_path, cartpole__bc__seed0="raise", cartpole__control_true__seed0="raise")
    code, _, err = main(*SMOKE, "--methods", "bc", "--out", "run")
    assert code == 1
    assert err.count("FAILED: ") == 1
    assert "FAILED: cartpole__control_true__seed0 and 1 more: ValueError: two lines" in err


def test_inline_cells_are_computed_in_this_process(
    main: Main, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults(tmp_path, cartpole__bc__seed0="raise")
    code, out, err = main(*SMOKE, "--methods", "bc", "--engine", "inline", "--out", "run")
    assert code == 1
    assert "a cell speaks" in out
    assert "Traceback" in err
    assert "FAILED: cartpole__bc__seed0: ValueError: two lines; in faked" in err
    run = Path("run")
    lines = (run / "computed.txt").read_text().split()
    assert set(lines[1::2]) == {str(os.getpid())}
    code, out, _ = main(*SMOKE, "--methods", "bc", "--engine", "inline", "--out", "run")
    assert f"0 cells to run, {PER_SEED + 1} kept" in out
    for option in (["--workers", "2"], ["--cell-timeout", "5"]):
        code, out, err = main(*SMOKE, "--engine", "inline", *option)
        assert (code, out) == (2, "")
        assert "computes one cell after the other and cannot stop any" in err


def test_inline_cells_replace_none_of_another_engine(main: Main, tmp_path: Path) -> None:
    assert main(*SMOKE, "--methods", "bc", "--out", "run")[0] == 0
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    code, out, err = main(*SMOKE, "--methods", "bc", "--seeds", "2", "--engine", "inline", "--out", "run")
    assert (code, out) == (2, "")
    assert "run holds cells that were computed otherwise; give another --out" in err
    assert {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()} == before


def test_a_cache_that_cannot_be_written_to_is_told(
    main: Main, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("IRL_BENCH_CACHE", str(tmp_path / "file"))
    code, _, err = main(*SMOKE, "--methods", "bc", "--out", "run")
    assert code == 0
    assert (
        f"the cache {tmp_path / 'file'} cannot be written to: experts are trained for this run alone" in err
    )


def test_a_report_is_built_again_where_cells_came_or_it_was_damaged(
    main: Main, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    built: list[int] = []
    write_report = sys.modules["harness.report.files"].write_report

    def count(directory: Path, report: Report) -> list[Path]:
        built.append(len(report.results))
        return write_report(directory, report)

    monkeypatch.setattr(sys.modules["harness.report.files"], "write_report", count)
    out = ("--out", "run")
    for _ in range(2):
        assert main(*SMOKE, "--methods", "bc", *out)[0] == 0
    assert built == [1 + PER_SEED]
    assert f"{PER_SEED + 1} ok" in main(*SMOKE, "--methods", "bc", *out)[1]
    (tmp_path / "run/leaderboard.md").write_text("something else\n")
    assert main(*SMOKE, "--methods", "bc", *out)[0] == 0
    assert main(*SMOKE, "--methods", "bc,maxent", *out)[0] == 0
    assert built == [1 + PER_SEED, 1 + PER_SEED, 2 + PER_SEED]
    assert main("verify", "run")[0] == 0
