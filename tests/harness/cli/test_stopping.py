"""Runs in processes of their own: stopped, refused, moved, out of space, on a terminal; nothing is lost."""

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.process.environment import SAME_INSTRUCTIONS
from harness.process.signals import STOPS, stop_cleanly
from tests.harness.fake_runs import FAKE, FAKE_ENV, PER_SEED, SMOKE, computed, faults, scores
from tests.harness.small_runs import names, stored

SHAPED = "cartpole__shaped__seed0"


def command(tmp_path: Path, *more: str) -> list[str]:
    return [*FAKE, *SMOKE, "--methods", "shaped", "--out", str(tmp_path / "run"), *more]


def start(tmp_path: Path, *before: str) -> subprocess.Popen[str]:
    """Return a run whose cell of shaped hangs, at the moment when that cell is the last one running."""
    faults(tmp_path, **{SHAPED: "sleep"})
    pipe, words = subprocess.PIPE, [*before, *command(tmp_path, "--workers", "2")]
    process = subprocess.Popen(
        words, env=FAKE_ENV, start_new_session=True, text=True, stdout=pipe, stderr=pipe
    )
    assert process.stdout is not None
    while "; 1 cell left" not in (line := process.stdout.readline()):
        assert line, process.communicate()
    while SHAPED not in computed(tmp_path / "run"):
        time.sleep(0.05)
    return process


def finish(tmp_path: Path, *more: str, **env: str) -> None:
    """Run without faults until the end."""
    faults(tmp_path)
    subprocess.run(command(tmp_path, *more), env={**FAKE_ENV, **env}, check=True, capture_output=True)


def process_of(directory: Path, cell: str) -> int:
    """Return the process that computes the cell."""
    lines = (directory / "computed.txt").read_text().splitlines()
    return int(dict(line.split() for line in lines)[cell])


def wait_until_gone(tmp_path: Path) -> None:
    pids = (tmp_path / "run/computed.txt").read_text().split()[1::2]
    deadline = time.monotonic() + 5
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < deadline, "a cell's process outlived its run"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the cells of an undisturbed run hold."""
    directory = tmp_path_factory.mktemp("unbroken")
    finish(directory)
    return scores(directory / "run")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Every stop interrupts, also where the tests themselves run in the background, deaf to them."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in STOPS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("interruptible")
def test_whatever_would_end_a_run_stops_it_cleanly_once() -> None:
    ending = {signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGXCPU}
    assert ending <= {*STOPS}
    for number in STOPS:
        for other in STOPS:
            signal.signal(other, signal.SIG_DFL)
        stop_cleanly()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        signal.raise_signal(number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGUSR1, signal.SIGKILL])
def test_a_run_that_is_stopped_keeps_what_is_finished_and_resumes(
    tmp_path: Path, unbroken: dict[str, str], number: int
) -> None:
    process = start(tmp_path)
    stopped = time.monotonic()
    if number != signal.SIGKILL:
        os.killpg(process.pid, number)  # as a terminal does: to everything in the foreground
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=10)
    if number == signal.SIGKILL:
        assert process.returncode == -number
    else:
        assert time.monotonic() - stopped < 2
        assert process.returncode == 130
        again, _, report = err.splitlines()[-3:]
        assert f"--out {tmp_path / 'run'}" in again
        assert report.endswith(f"report {tmp_path / 'run'}")
    wait_until_gone(tmp_path)
    assert len(scores(tmp_path / "run")) == PER_SEED
    finish(tmp_path)
    assert scores(tmp_path / "run") == unbroken
    assert computed(tmp_path / "run").count(SHAPED) == 2
    assert len(computed(tmp_path / "run")) == PER_SEED + 2


@pytest.mark.parametrize("after", [0.3, 0.7, 1.2, 2.0])
def test_being_stopped_again_and_again_is_one_clean_stop(tmp_path: Path, after: float) -> None:
    faults(tmp_path)
    process = subprocess.Popen(
        command(tmp_path), env=FAKE_ENV, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    time.sleep(after)  # at whatever it does then
    for _ in range(3):
        process.terminate()
        time.sleep(0.02)
    _, err = process.communicate(timeout=30)
    assert process.returncode in (0, 130, -signal.SIGTERM)
    assert process.returncode != -signal.SIGTERM or not err  # Nothing was begun yet.
    assert "Traceback" not in err


def test_a_second_run_is_refused_and_a_reader_that_leaves_stops_nothing(tmp_path: Path) -> None:
    process = start(tmp_path)
    assert process.stdout is not None
    process.stdout.close()
    second = subprocess.run(
        [*FAKE, "report", str(tmp_path / "run")], env=FAKE_ENV, capture_output=True, text=True, check=False
    )
    assert second.returncode == 2
    assert f"in use by another run (process {process.pid})" in second.stderr
    os.kill(process_of(tmp_path / "run", SHAPED), signal.SIGSEGV)
    assert process.wait(20) == 1
    assert process.stderr is not None
    err = process.stderr.read()
    process.stderr.close()
    assert f"FAILED: {SHAPED}: its process was killed by SIGSEGV" in err
    assert "Traceback" not in err
    assert (tmp_path / "run/leaderboard.md").exists()


def test_on_a_full_disk_one_line_says_so_and_nothing_is_half_written(
    tmp_path: Path, unbroken: dict[str, str]
) -> None:
    faults(tmp_path, **{name.removesuffix(".json"): "large" for name in unbroken})
    # As a full disk does, the system refuses to write on, here after 600 KiB a file.
    limited = ["bash", "-c", 'ulimit -f 600; exec "$@"', "-", *command(tmp_path)]
    full = subprocess.run(limited, env=FAKE_ENV, capture_output=True, text=True, check=False)
    assert full.returncode == 2
    assert re.fullmatch(
        r"irl-bench: error: .*/run\.sqlite: (disk I/O error|database or disk is full)\n", full.stderr
    )
    assert names(tmp_path / "run") == []
    wait_until_gone(tmp_path)
    finish(tmp_path)
    assert scores(tmp_path / "run") == unbroken


def test_a_run_pins_its_instructions_unless_asked_to_be_fast_and_mixes_with_no_other(tmp_path: Path) -> None:
    finish(tmp_path)
    printed = (tmp_path / "run/run.log").read_text()
    for name, value in SAME_INSTRUCTIONS.items():
        assert printed.count(f"{name}={value}\n") == PER_SEED + 1
    fast = command(tmp_path, "--fast")
    done = subprocess.run(fast, env=FAKE_ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "holds a run with deterministic True, not False" in done.stderr
    subprocess.run([*fast, "--out", str(tmp_path / "other")], env=FAKE_ENV, check=True, capture_output=True)
    assert "--xla_cpu_max_isa" not in (tmp_path / "other/run.log").read_text()
    assert stored(tmp_path / "other", "request", "run")["conditions"]["deterministic"] is False


@pytest.mark.parametrize("how", ["moved", "deleted"])
def test_a_directory_that_goes_while_the_run_goes_on_is_one_line(tmp_path: Path, how: str) -> None:
    process = start(tmp_path)
    cell = process_of(tmp_path / "run", SHAPED)
    if how == "moved":
        (tmp_path / "run").rename(tmp_path / "elsewhere")
    else:
        shutil.rmtree(tmp_path / "run")
    os.kill(cell, signal.SIGKILL)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert re.fullmatch(r"irl-bench: error: .*/run: moved, deleted or changed while the run goes on\n", err)
    assert not (tmp_path / "run").exists()
