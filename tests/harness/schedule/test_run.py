"""The grid: whatever a cell does, it is accounted for and the others go on."""

import dataclasses
import json
import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.engines.jobs import Job
from harness.process.environment import CACHE_VARIABLE
from harness.records import Cell, CellResult, Conditions
from harness.schedule.costs import Costs
from harness.store.codec import encode
from tests.harness.fake_runs import compute

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
REASONS = {
    "raise": "ValueError: two lines; in faked (fake_cells.py:",
    "kill": "its process was killed by SIGKILL (out of memory?)",
    "vanish": "its process ended without a result, exit code 0",
    "exit": "SystemExit: gave up; in faked",
    "hungry": "out of memory: MemoryError: Unable to allocate 1.00 GiB",
    "nan": "FloatingPointError: pi_star: return_mean is nan; in ",
    "other": "ValueError: asked for cartpole__other__seed0, got 2 rows of cartpole__bc__seed99",
    "unstorable": "TypeError: complex is no JSON; in _as_builtin (codec.py:",
}


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    (tmp_path / "run").mkdir()
    yield tmp_path / "run"
    assert multiprocessing.active_children() == []


def run(
    directory: Path, cells: list[Cell], workers: int, timeout: float | None = None
) -> dict[Cell, CellResult]:
    results = compute(directory, cells, workers, timeout).results
    assert len({result.cell for result in results}) == len(results)
    return {result.cell: result for result in results}


def test_every_way_to_fail_is_told_and_takes_no_other_cell_with_it(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("good", *REASONS, "fine")]
    results = run(directory, cells, workers=2)
    assert set(results) == set(cells)
    for cell, result in results.items():
        expected = REASONS.get(cell.method)
        assert [row.policy for row in result.rows] == ["pi_star", "pi_R"]
        for row in result.rows:
            assert row.status == ("failed" if expected else "ok")
            assert row.reason.startswith(expected or "")
            assert "\n" not in row.reason
    log = (directory / "run.log").read_text()
    assert "a cell speaks; pytest here: False" in log
    assert "Traceback" in log
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 * (len(cells) + 1)
    assert "; 0 cells left" in lines[-1]


def test_a_cell_that_hangs_is_stopped(directory: Path) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("sleep", "good")]
    results = run(directory, cells, workers=1, timeout=3)
    assert [results[cell].rows[0].reason for cell in cells] == ["it was stopped after 3 s", ""]


def test_the_number_of_workers_changes_no_result(directory: Path) -> None:
    cells = [Cell("cartpole", "good", seed) for seed in range(3)]
    one, three = run(directory, cells, workers=1), run(directory, cells, workers=3)
    for cell, result in one.items():
        its = dataclasses.replace(three[cell], seconds=result.seconds)
        assert encode(result) == encode(its)


def test_experts_come_first_and_of_unknown_tasks_those_with_the_most_steps(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [Cell(env, m, 0) for env in ("cartpole", "highway") for m in ("bc", "maxent")]
    run(directory, cells, workers=1)
    started = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("start")]
    assert set(started[:2]) == {"highway__expert__seed0", "cartpole__expert__seed0"}
    jobs = [Job((cell,), False, CONDITIONS, "") for cell in cells]
    guess = Costs(dataclasses.replace(CONDITIONS, budget="full")).of
    assert guess(jobs[0]) == guess(jobs[1]) < guess(jobs[2])


def test_what_was_measured_decides_what_comes_first(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("brief", "good", "slow")]
    for expected in (["brief", "good", "slow"], ["slow", "brief", "good"]):
        run(directory, cells, workers=1)
        lines = capsys.readouterr().out.splitlines()
        started = [line.split("__")[1] for line in lines if line.startswith("start")]
        assert started == ["expert", *expected]
    others = Costs(dataclasses.replace(CONDITIONS, budget="quick"))
    jobs = [Job((cell,), False, CONDITIONS, "") for cell in cells]
    assert len({others.of(job) for job in jobs}) == 1, "of another budget nothing is known"


@pytest.mark.parametrize("seconds", [1e308, -1.0, 0.0, 1e-320, 1e7])
def test_seconds_that_nothing_takes_are_not_believed(directory: Path, seconds: float) -> None:
    kept = directory.parent / "cache/seconds.json"
    kept.parent.mkdir()
    (job,) = [Job((Cell("cartpole", "bc", 0),), False, CONDITIONS, "")]
    guess = Costs(CONDITIONS).of(job)
    kept.write_text(json.dumps({"smoke, sb3, experts shipped": {"cartpole bc": seconds}}))
    assert Costs(CONDITIONS).of(job) == guess
    run(directory, list(job.cells), workers=1)
    assert Costs(CONDITIONS).of(job) != guess


def processes(directory: Path) -> list[str]:
    """Return the process of each cell that was computed, in order."""
    return (directory / "computed.txt").read_text().split()[1::2]


def test_cells_share_a_process_until_it_has_done_its_share(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = [Cell("cartpole", "good", seed) for seed in range(3)]
    run(directory, cells, workers=1)
    assert len(set(processes(directory))) == 1
    monkeypatch.setattr("harness.engines.processes.MOST_JOBS", 1)
    run(directory, cells, workers=1)
    assert len(set(processes(directory))) == 1 + len(cells)


@pytest.mark.parametrize("fault", ["raise", "kill", "hungry"])
def test_no_cell_shares_a_process_in_which_another_failed(directory: Path, fault: str) -> None:
    run(directory, [Cell("cartpole", fault, 0), Cell("cartpole", "good", 1)], workers=1)
    first, second = processes(directory)
    assert first != second
