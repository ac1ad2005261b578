"""Whatever a cell does becomes its own failed row: the run goes on, and nothing of the cell is left."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from harness.engines.jobs import Job
from harness.engines.processes import Processes, Worker
from harness.engines.server import Server
from harness.records import Cell, CellResult, Conditions
from harness.registry import BadInput
from tests.harness.fake_runs import compute
from tests.harness.small_runs import stored

HERE = Path(__file__).parents[1]
FAKE = [sys.executable, str(HERE / "fake_cells.py"), "run", "--budget", "smoke", "--envs", "cartpole"]
CONDITIONS = Conditions("smoke", "absorbing", "sb3")
ODD = {
    "keyboard": "KeyboardInterrupt; in faked",
    "generator": "GeneratorExit: left; in faked",
    "panic": "Panic: index out of bounds; in faked",
    "mute": "Mute: (its message raises RuntimeError); in faked",
    "surrogate": r"ValueError: caf\udce9 \x1b[2J; in faked",
    "group": "its process was killed by SIGTERM",
    "many_curves": "ValueError: Expected `object` of length <= 30 - at `$.curves`",
    "other_protocol": "ValueError: pi_star: of protocol another, not absorbing",
    "ghost_recording": "ValueError: its files are not those that its result names",
    "records_anothers": "ValueError: recordings/cartpole__good__seed0__pi_R.rrd is no file of",
    "one_row": "ValueError: asked for pi_star, pi_R, got pi_star",
    "escape": "ValueError: Expected `str` of one plain line, or a plain name - at `$.warnings[0]`",
    "leaves_and_dies": "its process was killed by SIGKILL",
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


def test_odd_ends_are_failed_rows(run: Run) -> None:
    results = run(*ODD)
    for method, expected in ODD.items():
        assert reason(results[method]).startswith(expected), method
    assert reason(results["good"]) == ""


def test_what_a_cell_leaves_in_its_temporary_folder_is_gone_for_the_next(run: Run) -> None:
    methods = ["fills_temporary_files", "looks_for_temporary_files", "deletes_temporary_files"]
    results = run(*methods, "makes_temporary_files", "records", workers=1)
    assert {reason(result) for result in results.values()} == {""}


def test_a_handler_that_a_cell_leaves_behind_ends_nothing_else(run: Run) -> None:
    methods = ("handler_exit", "handler_keyboard", "handler_timeout", "handler_error")
    results = run(*methods)  # whether theirs come through is chance; that they are rows is none
    assert reason(results["good"]) == ""
    assert all(len(results[method].rows) == 2 for method in methods)


def test_what_fails_oddly_can_be_stored_and_reported(tmp_path: Path) -> None:
    (tmp_path / "faults.json").write_text(json.dumps({"cartpole__bc__seed0": "surrogate"}))
    command = [*FAKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert r"FAILED: cartpole__bc__seed0: ValueError: caf\udce9 \x1b[2J" in done.stderr
    (row, *_) = stored(tmp_path / "run", "cartpole__bc__seed0")["rows"]
    assert row["reason"].isprintable()


@pytest.mark.parametrize("method", ["leaves", "leaves_and_dies", "leaves_and_hangs"])
def test_what_a_cell_started_ends_with_it(run: Run, tmp_path: Path, method: str) -> None:
    started = time.monotonic()
    results = run(method, timeout=4)
    assert left_behind(tmp_path / "run") == []
    assert time.monotonic() - started < 30  # they would sleep for a minute
    hanging = method == "leaves_and_hangs"
    expected = {"leaves": "", "leaves_and_dies": "its process was killed by SIGKILL (out of memory?)"}
    assert reason(results[method]) == expected.get(method, "it was stopped after 4 s")
    assert hanging or time.monotonic() - started < 10


@pytest.mark.parametrize(("behaviour", "processes"), [("leaves_and_hangs", 2), ("never_yields", 1)])
def test_what_a_cell_started_ends_with_a_killed_run(tmp_path: Path, behaviour: str, processes: int) -> None:
    (tmp_path / "faults.json").write_text(json.dumps({"cartpole__bc__seed0": behaviour}))
    command = [*FAKE, "--methods", "bc", "--out", str(tmp_path / "run")]
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


def test_a_cell_that_suspends_itself_is_stopped_in_time_and_the_server_is_woken(run: Run) -> None:
    results = run("stops_itself", "stops_server", "brief", timeout=4)
    assert reason(results["stops_itself"]) == "it was stopped after 4 s"
    assert [reason(results[method]) for method in ("stops_server", "brief", "good")] == ["", "", ""]


def test_where_processes_cannot_be_seen_cells_fail_and_say_so(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise psutil.NoSuchProcess(1)

    with monkeypatch.context() as changed:
        changed.setattr(psutil, "Process", refuse)
        result = run()["good"]
    assert reason(result).startswith("no expert: its process could not be started: NoSuchProcess")


def test_where_no_process_can_be_started_cells_fail_and_the_run_ends(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(Server, "_ask", refuse)
    expected = "no expert: its process could not be started: BlockingIOError: [Errno 11] Resource temp"
    assert reason(run()["good"]).startswith(expected)


def test_a_server_that_is_killed_as_it_starts_is_told_in_plain_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "killed.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with Processes(1, work="fake_cells", preload="killed") as engine:
        engine.submit(Job((Cell("cartpole", "bc", 0),), False, CONDITIONS, ""))
        while not (ended := engine.completed()):
            pass
    ((_, outcome),) = ended
    said = "its process could not be started: the process that it is forked from was killed (out of memory?)"
    assert (outcome.error, outcome.lost) == (said, True)


def test_where_not_even_the_server_can_be_started_one_line_says_so(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.raises(BadInput, match="no process can be started: Resource temporarily unavailable"):
        run()


@pytest.mark.parametrize("length", [80, 200])
def test_a_long_path_for_temporary_files_is_no_obstacle(tmp_path: Path, length: int) -> None:
    temporary = tmp_path / ("x" * length)
    temporary.mkdir()
    env = {**os.environ, "TMPDIR": str(temporary)}
    command = [*FAKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    (tmp_path / "faults.json").write_text("{}")
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


def test_ctrl_z_suspends_the_cells_and_they_go_on(tmp_path: Path) -> None:
    (tmp_path / "faults.json").write_text(json.dumps({"cartpole__bc__seed0": "sleep"}))
    command = [*FAKE, "--methods", "bc", "--workers", "1", "--out", str(tmp_path / "run")]
    # A job of a shell: the system suspends no group whose members have no parents outside it.
    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=nowhere, stderr=nowhere, process_group=0)
    try:
        file = tmp_path / "run/computed.txt"
        while not file.exists() or "bc" not in file.read_text():
            assert process.poll() is None
            time.sleep(0.01)
        both = [psutil.Process(process.pid), psutil.Process(int(file.read_text().split()[-1]))]

        def wait_until(stopped: bool) -> None:
            deadline = time.monotonic() + 20
            while [one.status() == "stopped" for one in both] != [stopped, stopped]:
                assert time.monotonic() < deadline
                time.sleep(0.01)

        process.send_signal(signal.SIGTSTP)
        wait_until(stopped=True)
        process.send_signal(signal.SIGCONT)
        wait_until(stopped=False)
        process.terminate()
        assert process.wait(20) == 130
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("behaviour", ["forks", "leaves_an_alarm"])
def test_what_a_cell_leaves_in_its_process_reaches_no_other(run: Run, behaviour: str) -> None:
    results = run(behaviour, "naps", workers=1)
    assert [row.status for method in (behaviour, "naps", "good") for row in results[method].rows] == [
        "ok"
    ] * 6


@pytest.mark.parametrize(
    ("behaviour", "reason"),
    [
        ("babbles", "it closed its connection to the run, or wrote to it"),
        ("babbles_well", "it closed its connection to the run, or wrote to it"),
        ("closes_files", "its process ended without a result, exit code 1"),
    ],
)
def test_a_cell_that_disturbs_its_connection_fails_alone(run: Run, behaviour: str, reason: str) -> None:
    results = run(behaviour, workers=1, timeout=3)
    assert {row.reason for row in results[behaviour].rows} == {reason}
    assert [row.status for row in results["good"].rows] == ["ok", "ok"]


def test_a_process_that_is_killed_while_it_waits_costs_no_job_its_result() -> None:
    job = Job((Cell("cartpole", "good", 0),), True, CONDITIONS, "")
    with Processes(1, work="fake_cells", preload="fake_preload") as engine:
        worker = Worker(engine._server)
        worker.end()
        engine._idle.append(worker)
        engine.submit(job)
        while not (ended := engine.completed()):
            pass
    assert ended[0][1].lost
