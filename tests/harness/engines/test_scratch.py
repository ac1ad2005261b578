"""The temporary folder of a run: nobody else's is deleted, and none of ours stays."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from filelock import lock_descriptor

from harness.engines import scratch
from harness.engines.cell_environment import as_in_cells
from harness.engines.scratch import PREFIX, scratch_folder
from harness.store.files import opened

HOLDER = """
import sys, filelock
file = open(sys.argv[1])
filelock.lock_descriptor(file.fileno())
print(flush=True)
input()
"""


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for temporary files."""
    with tempfile.TemporaryDirectory(prefix="t-") as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


def abandoned(parent: Path) -> Path:
    """Return the folder that a killed run leaves in `parent`."""
    folder = parent / f"{PREFIX}1234abcd"
    (folder / "program").mkdir(parents=True)
    (folder / "program/file").write_text("")
    folder.with_suffix(".lock").touch()
    return folder


def test_what_a_killed_run_left_is_deleted_by_the_next(temporary: Path) -> None:
    abandoned(temporary)
    with scratch_folder() as folder:
        assert {path.stem for path in temporary.iterdir()} == {folder.name}
    assert list(temporary.iterdir()) == []


def test_folders_that_only_look_like_ours_are_left_alone(temporary: Path) -> None:
    names = ["irl-bench-2026-results", "irl-bench-424242-seeds", "irl-bench-20261123093000-x", "mine"]
    for name in [*names, f"{PREFIX}copied-without-its-lock"]:
        (temporary / name).mkdir()
        (temporary / name / "precious").write_text("mine")
    (temporary / f"{PREFIX}file").write_text("mine")
    os.mkfifo(temporary / f"{PREFIX}pipe.lock")
    (temporary / f"{PREFIX}link").symlink_to(temporary / "mine")
    (temporary / f"{PREFIX}link.lock").touch()
    before = sorted(temporary.rglob("*"))
    with scratch_folder():
        pass
    assert sorted(temporary.rglob("*")) == before


def test_a_folder_that_a_live_run_holds_is_left_alone(temporary: Path) -> None:
    """A lock tells, not a number of a process: those mean nothing to another PID namespace."""
    left = abandoned(temporary)
    command = [sys.executable, "-c", HOLDER, str(left.with_suffix(".lock"))]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    with scratch_folder():
        assert left.exists()
    process.communicate(b"\n")
    with scratch_folder():
        assert not left.exists()


def test_another_users_folder_is_left_alone(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = abandoned(temporary)
    owner = os.geteuid()
    monkeypatch.setattr(scratch, "_user", lambda: owner + 1)
    with scratch_folder():
        pass
    assert left.exists()


def test_a_folder_is_never_there_without_its_lock(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a run is killed while it makes its folder, nobody takes the folder of a run that lives."""
    make = Path.mkdir

    def check(folder: Path, **how: int) -> None:
        with opened(folder.with_suffix(".lock")) as lock:
            assert not lock_descriptor(lock.fileno(), blocking=False)
        make(folder, **how)

    monkeypatch.setattr(Path, "mkdir", check)
    with scratch_folder() as folder:
        assert folder.is_dir()


def test_what_cannot_be_deleted_keeps_its_lock(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next run goes on with it, also where a deletion was interrupted."""
    with monkeypatch.context() as changed:
        changed.setattr(scratch.shutil, "rmtree", lambda *_, **__: None)
        with scratch_folder() as folder:
            (folder / "inner").mkdir()
    assert folder.with_suffix(".lock").exists()
    with scratch_folder():
        assert not folder.exists()
    assert list(temporary.iterdir()) == []


def test_bench_keeps_what_it_cannot_cache_in_its_own_folder(temporary: Path) -> None:
    with as_in_cells():
        assert Path(tempfile.gettempdir()).parents[1] == temporary
    assert tempfile.gettempdir() == str(temporary)
