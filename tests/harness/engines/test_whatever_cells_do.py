"""Whatever a cell does becomes its own failed row: the run goes on, and nothing of the cell is left."""

import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from harness.cli.main import main
from harness.engines.server import Server
from harness.records import Cell, CellResult
from tests.harness.fake_runs import FAKE, SMOKE, compute, faults
from tests.harness.small_runs import NAME

ODD = {
    "panic": "Panic: index out of bounds; in faked",
    "surrogate": r"ValueError: caf\udce9 \x1b[2J; in faked",
    "group": "its process was killed by SIGTERM",
    "ghost_recording": "ValueError: its files are not those that its result names",
    "leaves_one_and_kill": "its process was killed by SIGKILL (out of memory?)",
}
Run = Callable[..., dict[str, str]]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    """Computes one cell of each of the methods, and one that is good. Returns by method why it failed, or
    ''."""
    (tmp_path / "run").mkdir()
    before = {*psutil.Process().children()}  # such as a browser of other tests

    def reason(result: CellResult) -> str:
        ((status, why),) = {(row.status, row.reason) for row in result.rows}
        assert status == ("failed" if why else "ok")
        return why

    def call(*methods: str, workers: int = 2, timeout: float | None = None) -> dict[str, str]:
        cells = [Cell("cartpole", method, 0) for method in (*methods, "good")]
        found = compute(tmp_path / "run", cells, workers, timeout).results
        assert len(found) == len(methods) + 1
        return {result.cell.method: reason(result) for result in found}

    yield call
    assert {*psutil.Process().children()} <= before


def left_behind(directory: Path) -> list[int]:
    """Return the processes that cells started and that are still there."""
    told = [int(pid) for pid in (directory / "left_behind.txt").read_text().split()]
    assert told
    return [pid for pid in told if psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie"]


def test_odd_ends_are_failed_rows_and_nothing_of_them_is_left(run: Run, tmp_path: Path) -> None:
    reasons = run(*ODD, timeout=20)
    for method, expected in ODD.items():
        assert reasons[method].startswith(expected), method
        assert reasons[method].isprintable()
    assert reasons["good"] == ""
    assert left_behind(tmp_path / "run") == []


@pytest.mark.parametrize("behaviour", ["changes_its_process", "forks"])
def test_a_change_of_its_process_reaches_no_other_cell(run: Run, behaviour: str) -> None:
    reasons = run(behaviour, "looks_for_temporary_files", "slow", workers=1)
    assert list(reasons.values()) == [""] * 4


def test_a_cell_that_hangs_is_stopped_in_time_with_all_that_it_started(run: Run, tmp_path: Path) -> None:
    started = time.monotonic()
    reasons = run("leaves_one_and_sleep", "stops_itself", "brief", timeout=4)
    assert time.monotonic() - started < 30  # they would sleep for a minute
    stopped = dict.fromkeys(("leaves_one_and_sleep", "stops_itself"), "it was stopped after 4 s")
    assert reasons == {"brief": "", "good": ""} | stopped
    assert left_behind(tmp_path / "run") == []


def test_what_a_cell_started_ends_with_a_killed_run(tmp_path: Path) -> None:
    faults(tmp_path, **{NAME: "leaves_one_and_sleep"})
    command = [*FAKE, *SMOKE, "--methods", "bc", "--out", str(tmp_path / "run")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    file = tmp_path / "run/left_behind.txt"
    try:
        while not file.exists() or len(file.read_text().split()) < 2:
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
    reasons = run("server", "slow", "brief", "kill")
    assert reasons.pop("kill").startswith("its process ")
    assert reasons == dict.fromkeys(("server", "slow", "brief", "good"), "")


def test_where_no_process_can_be_started_cells_fail_and_say_so(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise BlockingIOError(11, "Resource unavailable")

    monkeypatch.setattr(Server, "_ask", refuse)
    said = "BlockingIOError: [Errno 11] Resource unavailable"
    assert run()["good"].startswith(f"no expert: its process could not be started: {said}")


def test_where_no_temporary_file_can_be_one_line_says_so_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "x" * 200)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert main(["run", "--out", str(tmp_path / "run")]) == 2
    assert "no folder for temporary files" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


FREES = """
import psutil
from harness.engines.compute import process_restored

def size():
    return psutil.Process().memory_info().rss >> 20

before = size()
with process_restored():
    blocks = [bytearray(60_000) for _ in range(5000)]
    stay, most = blocks[::50], size()
    del blocks
print(most - before, size() - before)
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="of glibc")
def test_what_a_job_freed_goes_back_to_the_machine() -> None:
    """Blocks that stay lie between those that are freed, as after a job that traces and compiles."""
    done = subprocess.run([sys.executable, "-c", FREES], capture_output=True, text=True, check=True)
    most, left = map(int, done.stdout.split())
    assert most > 250
    assert left < 60
