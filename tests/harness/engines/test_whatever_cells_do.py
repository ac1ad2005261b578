"""Whatever a cell does becomes its own failed row: the run goes on, and nothing of the cell is left."""

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from harness.engines.jobs import Job, Outcome
from harness.engines.processes import Processes, Worker
from harness.engines.server import Server
from harness.records import Cell, CellResult, Conditions
from harness.registry import BadInput
from tests.harness.fake_runs import FAKE, SMOKE, compute, faults
from tests.harness.small_runs import NAME, stored

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
ODD = {
    "panic": "Panic: index out of bounds; in faked",
    "mute": "Mute: (its message raises RuntimeError); in faked",
    "surrogate": r"ValueError: caf\udce9 \x1b[2J; in faked",
    "group": "its process was killed by SIGTERM",
    "other_protocol": "ValueError: pi_star: of protocol another, not absorbing",
    "ghost_recording": "ValueError: its files are not those that its result names",
    "one_row": "ValueError: asked for pi_star, pi_R, got pi_star",
    "escape": "ValueError: Expected `str` of one plain line, or a plain name - at `$.warnings[0]`",
    "leaves_one_and_kill": "its process was killed by SIGKILL (out of memory?)",
    "closes_files": "its process ended without a result, exit code 1",
    "babbles": "it closed its connection to the run, or wrote to it",
}
Run = Callable[..., dict[str, CellResult]]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    """Computes one cell of each of the methods, and one that is good, and returns them by method."""
    (tmp_path / "run").mkdir()
    before = {*psutil.Process().children()}  # such as a browser of other tests

    def call(*methods: str, workers: int = 2, timeout: float | None = None) -> dict[str, CellResult]:
        cells = [Cell("cartpole", method, 0) for method in (*methods, "good")]
        found = compute(tmp_path / "run", cells, workers, timeout).results
        assert len(found) == len(methods) + 1
        return {result.cell.method: result for result in found}

    yield call
    assert {*psutil.Process().children()} <= before


def reason(result: CellResult) -> str:
    """Why all rows failed, or ''."""
    (found,) = {(row.status, row.reason) for row in result.rows}
    assert found[0] == ("failed" if found[1] else "ok")
    return found[1]


def left_behind(directory: Path) -> list[int]:
    """Processes that cells started and that are still there."""
    told = [int(pid) for pid in (directory / "left_behind.txt").read_text().split()]
    assert told
    return [pid for pid in told if psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie"]


def test_odd_ends_are_failed_rows_and_nothing_of_them_is_left(run: Run, tmp_path: Path) -> None:
    results = run(*ODD, timeout=20)
    for method, expected in ODD.items():
        assert reason(results[method]).startswith(expected), method
    assert reason(results["good"]) == ""
    assert left_behind(tmp_path / "run") == []


def test_a_message_that_no_terminal_can_show_is_stored_and_reported(tmp_path: Path) -> None:
    faults(tmp_path, **{NAME: "surrogate"})
    command = [*FAKE, *SMOKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert rf"FAILED: {NAME}: ValueError: caf\udce9 \x1b[2J" in done.stderr
    assert all(row["reason"].isprintable() for row in stored(tmp_path / "run", NAME)["rows"])


@pytest.mark.parametrize("behaviour", ["changes_its_process", "forks", "leaves_an_alarm", "leaves_one"])
def test_a_change_of_its_process_reaches_no_other_cell(run: Run, behaviour: str) -> None:
    results = run(behaviour, "looks_for_temporary_files", "slow", workers=1)
    assert [reason(result) for result in results.values()] == [""] * 4


def test_a_cell_that_hangs_is_stopped_in_time_with_all_that_it_started(run: Run, tmp_path: Path) -> None:
    started = time.monotonic()
    results = run("leaves_one_and_sleep", "stops_itself", "stops_server", "brief", timeout=4)
    assert time.monotonic() - started < 30  # they would sleep for a minute
    stopped = "it was stopped after 4 s"
    expected = {"leaves_one_and_sleep": stopped, "stops_itself": stopped, "stops_server": ""}
    assert {method: reason(results[method]) for method in expected} == expected
    assert [reason(results[method]) for method in ("brief", "good")] == ["", ""]
    assert left_behind(tmp_path / "run") == []


@pytest.mark.parametrize(("behaviour", "processes"), [("leaves_one_and_sleep", 2), ("never_yields", 1)])
def test_what_a_cell_started_ends_with_a_killed_run(tmp_path: Path, behaviour: str, processes: int) -> None:
    faults(tmp_path, **{NAME: behaviour})
    command = [*FAKE, *SMOKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    file = tmp_path / "run/left_behind.txt"
    try:
        while not file.exists() or len(file.read_text().split()) < processes:
            assert process.poll() is None
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    deadline = time.monotonic() + 10
    while left_behind(tmp_path / "run"):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_dead_server_of_processes_is_started_again_and_cells_lose_nothing(run: Run) -> None:
    results = run("server", "slow", "brief", "kill")
    assert reason(results["kill"]).startswith("its process ")
    assert [reason(results[method]) for method in ("server", "slow", "brief", "good")] == [""] * 4


@pytest.mark.parametrize("what", ["Process", "_ask"])
def test_where_no_process_can_be_started_or_seen_cells_fail_and_say_so(
    run: Run, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    def refuse(*_: object) -> None:
        raise psutil.NoSuchProcess(1) if what == "Process" else BlockingIOError(11, "Resource unavailable")

    with monkeypatch.context() as changed:
        changed.setattr(psutil if what == "Process" else Server, what, refuse)
        result = run()["good"]
    said = "NoSuchProcess" if what == "Process" else "BlockingIOError: [Errno 11] Resource unavailable"
    assert reason(result).startswith(f"no expert: its process could not be started: {said}")


def test_where_not_even_the_server_can_be_started_one_line_says_so(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.raises(BadInput, match="no process can be started: Resource temporarily unavailable"):
        run()


def outcome_of(engine: Processes, job: Job) -> Outcome:
    engine.submit(job)
    while not (ended := engine.completed()):
        pass
    return ended[0][1]


def test_a_server_that_is_killed_as_it_starts_is_told_in_plain_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "killed.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with Processes(1, work="fake_cells", preload="killed") as engine:
        outcome = outcome_of(engine, Job((Cell("cartpole", "bc", 0),), False, CONDITIONS, ""))
    said = "its process could not be started: the process that it is forked from was killed (out of memory?)"
    assert (outcome.error, outcome.lost) == (said, True)


def test_a_process_that_is_killed_while_it_waits_costs_no_job_its_result() -> None:
    with Processes(1, work="fake_cells", preload="fake_preload") as engine:
        worker = Worker(engine._server)
        worker.end()
        engine._idle.append(worker)
        assert outcome_of(engine, Job((Cell("cartpole", "good", 0),), True, CONDITIONS, "")).lost


def test_a_long_path_for_temporary_files_is_no_obstacle(tmp_path: Path) -> None:
    temporary = tmp_path / ("x" * 200)
    temporary.mkdir()
    faults(tmp_path)
    command = [*FAKE, *SMOKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    env = {**os.environ, "TMPDIR": str(temporary)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "WARNING: cartpole: low bar\n")
    assert list(temporary.iterdir()) == []


def test_where_no_temporary_file_can_be_one_line_says_so_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from harness.cli.main import main

    monkeypatch.setattr(tempfile, "tempdir", "x" * 200)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert main(["run", "--out", str(tmp_path / "run")]) == 2
    assert "no folder for temporary files" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
