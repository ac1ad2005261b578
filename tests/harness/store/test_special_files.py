"""Special files in a run's directory, and files that may not be read: named, and nobody is blocked."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.store.database import FILE
from harness.store.files import appending, read, write_atomic
from harness.store.sums import SUMS
from tests.harness.small_runs import RECORDING, run, snapshot

__all__ = ["run"]

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", [FILE, "scores.csv", SUMS, f"recordings/{RECORDING}"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "link", "huge", "binary"])
def test_special_files_block_nobody(run: Path, name: str, kind: str) -> None:
    file = run / name
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    elif kind == "device":
        file.symlink_to("/dev/zero")
    elif kind == "link":
        file.symlink_to("/etc/hostname")
    elif kind == "huge":
        with file.open("wb") as handle:
            handle.truncate(1 << 36)
    else:
        file.write_bytes(bytes(range(256)))
    assert main(["verify", str(run)]) == (2 if name == FILE else 1)
    # What is a folder cannot be replaced.
    refused = name == FILE or (kind == "folder" and "/" not in name)
    assert main(["report", str(run)]) == (2 if refused else 1 if name.startswith("recordings") else 0)


@pytest.mark.parametrize("kind", ["pipe", "folder", "link", "unreadable"])
def test_a_lock_that_is_none_stops_no_verification(run: Path, kind: str) -> None:
    (run / ".lock").unlink()
    if kind == "pipe":
        os.mkfifo(run / ".lock")
    elif kind == "folder":
        (run / ".lock").mkdir()
    elif kind == "link":
        (run / ".lock").symlink_to("nowhere")
    else:
        (run / ".lock").write_bytes(b"\xff")
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize("locale", ["C", "POSIX"])
def test_a_report_says_the_same_in_any_locale(run: Path, locale: str) -> None:
    before = snapshot(run)
    (run / "report.html").unlink()
    env = {**os.environ, "LC_ALL": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "harness", "report", str(run)]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    page = str(run / "report.html")
    assert snapshot(run)[page] == before[page]
    assert "π" in (run / "report.html").read_text(encoding="utf-8")


def test_files_obey_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "new/file", "text")
        with appending(tmp_path / "log"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new/file").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "log").stat().st_mode) == 0o640
    assert read(tmp_path / "new/file") == b"text"
