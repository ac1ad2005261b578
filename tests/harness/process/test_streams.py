"""Whatever becomes of standard output and error, the work is done and the exit code says what came of it."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.fake_runs import FAKE, FAKE_ENV, PER_SEED, ROOT, faults
from tests.harness.small_runs import names

RUN = "run --budget smoke --envs cartpole --methods bc --out run"
BC = "cartpole__bc__seed0"


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
    ("line", "flags", "variables"),
    [
        ("$IRL RUN 2>&1 | head -1; exit ${PIPESTATUS[0]}", "", {}),
        ("$IRL RUN >/dev/full 2>&1", "", {}),
        ("$IRL RUN <&- >&- 2>&-", "", {}),
        ("$IRL RUN", "-Xdev -bb -P", {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "undefined"}),
        ("$IRL RUN", "-Werror -O -s", {"PYTHONIOENCODING": "ascii:strict", "TERM": "nonsense"}),
    ],
)
def test_wherever_it_prints_to_a_failed_cell_is_exit_1_and_the_report_is_there(
    tmp_path: Path, line: str, flags: str, variables: dict[str, str]
) -> None:
    faults(tmp_path, **{BC: "raise"})
    code, err = shell(tmp_path, line.replace("RUN", RUN), *flags.split(), **variables)
    assert code == 1, err
    assert "Traceback" not in err
    assert (tmp_path / "run/leaderboard.md").read_text() == f"a table of {PER_SEED + 1} cells\n"
    assert len(names(tmp_path / "run")) == PER_SEED + 1


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


def test_a_flag_that_cells_cannot_have_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    code, err = shell(tmp_path, f"cd {ROOT} && {sys.executable} -OO -m harness {RUN}x{tmp_path.name}")
    assert code == 2
    assert "without -OO" in err
    assert not (ROOT / f"runx{tmp_path.name}").exists()
