"""Files that are read whole, and nowhere else; folders that are filled, or not there."""

import os
import resource
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.store.database import FILE
from harness.store.files import SUMS, appending, new_folder, read, write_atomic
from tests.harness.small_runs import RECORDING, run, snapshot

__all__ = ["run"]

ROOT = Path(__file__).parents[3]


def interrupted(target: Path) -> None:
    with new_folder(target) as folder:
        (folder / "half").write_text("half")
        raise KeyboardInterrupt


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_that_cannot_be_filled_is_not_left(tmp_path: Path, there: bool) -> None:
    target = tmp_path / "deep/er/page"
    if there:
        target.mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt):
        interrupted(target)
    assert target.exists() == (tmp_path / "deep").exists() == there
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []
    with new_folder(target) as folder:
        (folder / "whole").write_text("whole")
    assert [file.name for file in target.parent.rglob("*")] == ["page", "whole"]


@pytest.mark.parametrize("name", [FILE, "scores.csv", SUMS, f"recordings/{RECORDING}"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "huge"])
def test_special_files_block_nobody(run: Path, name: str, kind: str) -> None:
    file = run / name
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    elif kind == "device":
        file.symlink_to("/dev/zero")
    else:
        with file.open("wb") as handle:
            handle.truncate(1 << 36)
    assert main(["verify", str(run)]) == (2 if name == FILE else 1)
    # A folder cannot be replaced.
    refused = name == FILE or (kind == "folder" and "/" not in name)
    assert main(["report", str(run)]) == (2 if refused else 1 if name.startswith("recordings") else 0)


@pytest.mark.parametrize("kind", ["pipe", "link", "unreadable"])
def test_a_lock_that_is_none_stops_no_verification(run: Path, kind: str) -> None:
    (run / ".lock").unlink()
    if kind == "pipe":
        os.mkfifo(run / ".lock")
    elif kind == "link":
        (run / ".lock").symlink_to("nowhere")
    else:
        (run / ".lock").write_bytes(b"\xff")
    assert main(["verify", str(run)]) == 0


def test_a_report_says_the_same_in_any_locale(run: Path) -> None:
    before = snapshot(run)
    (run / "report.html").unlink()
    env = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
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


def test_a_short_write_is_an_error_and_an_old_file_stays_whole(tmp_path: Path) -> None:
    write_atomic(tmp_path / "file", "old")
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, most[1]))
    try:
        with pytest.raises(OSError, match="File too large"), appending(tmp_path / "log") as file:
            file.write(b"x" * 101)
        with pytest.raises(OSError, match="File too large"):
            write_atomic(tmp_path / "file", b"x" * 101)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    assert {file.name for file in tmp_path.iterdir()} == {"file", "log"}
    assert read(tmp_path / "file") == b"old"
