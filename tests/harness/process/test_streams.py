"""Whatever becomes of standard output and error, the work is done and the exit code says what came of it."""

import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from harness.records import Conditions
from tests.harness.fake_runs import FAKE, FAKE_ENV, PER_SEED, ROOT, faults
from tests.harness.small_runs import damage, names

RUN = "run --budget smoke --envs cartpole --methods bc --out run"
CONDITIONS = Conditions("smoke", "absorbing", "sbx")
BC = "cartpole__bc__seed0"
HEARING = ("env", "--default-signal=HUP")
"""Before a command that must hear of a lost terminal, though the tests be run by nohup."""


def shell(directory: Path, line: str, *flags: str, **variables: str) -> tuple[int, str]:
    """Run a line of bash in which $IRL is the command line with fake cells. Return its exit code, and
    stderr."""
    env = {**FAKE_ENV, "IRL": " ".join([FAKE[0], *flags, FAKE[1]]), **variables}
    words, nowhere = ["bash", "-c", line], subprocess.DEVNULL
    done = subprocess.run(
        words, cwd=directory, env=env, stdout=nowhere, stderr=subprocess.PIPE, text=True, check=False
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    "line",
    [
        "$IRL RUN 2>&1 | head -1; exit ${PIPESTATUS[0]}",
        "$IRL RUN >/dev/full 2>&1",
        "$IRL RUN <&- >&- 2>&-",
    ],
)
def test_wherever_it_prints_to_a_failed_cell_is_exit_1_and_the_report_is_there(
    tmp_path: Path, line: str
) -> None:
    faults(tmp_path, **{BC: "raise"})
    code, err = shell(tmp_path, line.replace("RUN", RUN))
    assert code == 1
    assert "Traceback" not in err
    assert (tmp_path / "run/leaderboard.md").read_text() == f"a table of {PER_SEED + 1} cells\n"
    assert len(names(tmp_path / "run")) == PER_SEED + 1


def test_a_damaged_cell_is_computed_again_and_reported_though_nobody_reads(tmp_path: Path) -> None:
    faults(tmp_path)
    assert shell(tmp_path, f"$IRL {RUN}")[0] == 0
    for command, code in (("report run", 1), (RUN, 0), ("report run", 0)):
        if code == 1 or command == RUN:
            damage(tmp_path / "run", "cartpole__reference__seed0")
        (tmp_path / "run/leaderboard.md").unlink()
        line = f"$IRL {command} 2>&1 | head -0; exit ${{PIPESTATUS[0]}}"
        assert shell(tmp_path, line)[0] == code
        assert (tmp_path / "run/leaderboard.md").exists()
    assert (tmp_path / "run/computed.txt").read_text().count("reference") == 2


@pytest.mark.parametrize(
    ("line", "code", "message"),
    [
        ("$IRL list >/dev/full", 1, "cut short: No space left on device"),
        ("$IRL --help | head -0; exit ${PIPESTATUS[0]}", 0, ""),
        ("$IRL list >&-", 0, ""),
        ("$IRL nonsense 2>&-", 2, ""),
        (r"$IRL verify $'\e[2J'", 2, r"\x1b[2J holds no run"),
    ],
)
def test_what_was_asked_to_be_printed_is_whole_or_exit_1(
    tmp_path: Path, line: str, code: int, message: str
) -> None:
    returned, err = shell(tmp_path, line)
    assert returned == code
    assert message in err
    assert err.count("\n") == bool(message)


@pytest.mark.parametrize(("flag", "reason"), [("-OO", "without -OO"), ("-I", "without -E and -I")])
def test_flags_that_cells_cannot_have_are_refused_and_nothing_is_written(
    tmp_path: Path, flag: str, reason: str
) -> None:
    code, err = shell(tmp_path, f"cd {ROOT} && {sys.executable} {flag} -m harness {RUN}x{tmp_path.name}")
    assert code == 2
    assert reason in err or "No module named" in err  # the package is not installed where -I looks
    assert not (ROOT / f"runx{tmp_path.name}").exists()


IGNORING = "signal.signal(signal.SIGCHLD, signal.SIG_IGN)"
BLOCKING = "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})"
BEFORE = f"import os, signal, sys; {IGNORING}; {BLOCKING}; os.execv(sys.argv[1], sys.argv[1:])"


def test_ignored_and_blocked_signals_of_children_hide_no_end(tmp_path: Path) -> None:
    faults(tmp_path, **{BC: "kill"})
    code, err = shell(tmp_path, f'{sys.executable} -c "{BEFORE}" $IRL {RUN}')
    assert code == 1
    assert "its process was killed by SIGKILL" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("flags", "variables"),
    [
        ("-Xdev -bb -P", {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "undefined"}),
        ("-Werror -O -s", {"PYTHONIOENCODING": "ascii:strict", "TERM": "nonsense", "MPLBACKEND": "bogus"}),
    ],
)
def test_flags_and_variables_of_the_shell_change_nothing(
    tmp_path: Path, flags: str, variables: dict[str, str]
) -> None:
    faults(tmp_path, **{BC: "raise"})
    code, err = shell(tmp_path, f"$IRL {RUN}", *flags.split(), **variables)
    assert code == 1, err
    assert "Traceback" not in err
    assert (tmp_path / "run/leaderboard.md").exists()


def begun(directory: Path, *before: str, **how: object) -> subprocess.Popen[str]:
    """Return a run whose cell of bc hangs, when it does."""
    faults(directory, **{BC: "sleep"})
    env = {**FAKE_ENV, "TERM": "xterm"}
    process = subprocess.Popen([*before, *FAKE, *RUN.split()], cwd=directory, env=env, text=True, **how)  # type: ignore[call-overload]
    file = directory / "run/computed.txt"
    while not file.exists() or BC not in file.read_text():
        assert process.poll() is None
        time.sleep(0.02)
    return process


@pytest.mark.parametrize("ignores", [False, True])
def test_a_closed_terminal_stops_a_run_like_ctrl_c_unless_it_ignores_that(
    tmp_path: Path, ignores: bool
) -> None:
    ours, theirs = pty.openpty()
    before = ("bash", "-c", 'trap "" HUP; exec "$@"', "-") if ignores else HEARING
    process = begun(tmp_path, *before, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
    os.close(theirs)
    os.close(ours)
    os.killpg(process.pid, signal.SIGHUP)
    if ignores:
        cell = (tmp_path / "run/computed.txt").read_text().split(f"{BC} ")[1].split()[0]
        time.sleep(0.5)
        os.kill(int(cell), signal.SIGKILL)
    assert process.wait(20) == (1 if ignores else 130)
    assert not ignores or (tmp_path / "run/leaderboard.md").exists()


@pytest.mark.parametrize("after", [0.1, 0.2, 0.5])
def test_ctrl_c_while_it_starts_is_no_traceback(tmp_path: Path, after: float) -> None:
    command = ["env", "--default-signal=INT", sys.executable, "-m", "harness", "report", str(tmp_path)]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    if process.returncode in (1, -signal.SIGINT):  # Python itself had not yet started
        assert str(ROOT / "harness") not in err
    else:
        assert process.returncode in (130, 2)
        assert "Traceback" not in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_ctrl_c_twice_is_a_clean_stop_too(tmp_path: Path, number: signal.Signals) -> None:
    process = begun(tmp_path, *HEARING, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    for _ in range(5):
        process.send_signal(number)
        time.sleep(0.01)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Traceback" not in err
