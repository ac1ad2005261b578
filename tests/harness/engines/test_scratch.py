"""The temporary folder of a run: nobody else's is deleted, and none of ours stays."""

import os
import shutil
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
from harness.run.files import opened


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for temporary files."""
    with tempfile.TemporaryDirectory(prefix="t-") as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


def snapshot(path: Path) -> dict[str, bytes | None]:
    return {str(file): file.read_bytes() if file.is_file() else None for file in path.rglob("*")}


def abandoned(parent: Path) -> Path:
    """What a killed run leaves."""
    with scratch_folder() as folder:
        kept = folder.with_name("kept")
        folder.rename(kept)
    assert not folder.exists()
    return kept.rename(folder)


def test_what_a_killed_run_left_is_deleted_by_the_next(temporary: Path) -> None:
    left = abandoned(temporary)
    (left / "program").mkdir()
    (left / "program/file").write_text("")
    with scratch_folder() as folder:
        assert [path.name for path in temporary.iterdir()] == [folder.name]
    assert list(temporary.iterdir()) == []


def test_a_deletion_that_is_interrupted_is_gone_on_with(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupted(BaseException):
        pass

    def interrupt(*_: object, **__: object) -> None:
        raise Interrupted

    def leave(inner: str) -> None:
        with scratch_folder() as folder:
            (folder / inner).mkdir()

    for number in range(5):  # in whatever order the folder lists them
        with monkeypatch.context() as changed:
            changed.setattr(scratch.shutil, "rmtree", interrupt)
            with pytest.raises(Interrupted):
                leave(f"folder{number}")
    with scratch_folder() as folder:
        assert list(temporary.iterdir()) == [folder]


def test_folders_that_only_look_like_ours_are_left_alone(temporary: Path) -> None:
    pid = 424242
    names = [
        f"{PREFIX}2026-results",
        f"{PREFIX}{pid}-seeds",
        f"{PREFIX}20261123093000-x",
        PREFIX + "a",
        "mine",
    ]
    for name in names:
        (temporary / name).mkdir()
        (temporary / name / "precious").write_text("mine")
    (temporary / f"{PREFIX}file").write_text("mine")
    for name in ("copied", "moved"):  # with everything that is in them
        left = abandoned(temporary)
        left.rename(temporary / f"{PREFIX}{name}")
    (temporary / f"{PREFIX}empty").mkdir()
    (temporary / f"{PREFIX}empty" / MARKER).write_text("")
    (temporary / f"{PREFIX}pipe").mkdir()
    os.mkfifo(temporary / f"{PREFIX}pipe" / MARKER)
    (temporary / f"{PREFIX}link").symlink_to(abandoned(temporary).rename(temporary / "elsewhere"))
    before = snapshot(temporary)
    with scratch_folder():
        pass
    assert snapshot(temporary) == before


def test_a_folder_that_a_live_run_holds_is_left_alone(temporary: Path) -> None:
    """A lock tells, not a number of a process: those mean nothing to another PID namespace."""
    left = abandoned(temporary)
    holder = (
        "import sys; from filelock import lock_descriptor as lock; f = open(sys.argv[1]); lock(f.fileno()); "
    )
    holder += "print(); input()"
    process = subprocess.Popen(
        [sys.executable, "-c", holder, str(left / MARKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
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
    with monkeypatch.context() as changed:
        changed.setattr(scratch.os, "geteuid", lambda: owner + 1)
        with scratch_folder():
            pass
    assert left.exists()


def test_a_folder_is_never_there_unlocked_with_its_marker(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a run is killed while it makes its folder, nobody takes the folder of a run that lives."""
    mark = scratch._mark

    def check(folder: Path) -> bytes:
        with opened(folder / MARKER) as marker:
            assert marker.read() == b""
            assert not lock_descriptor(marker.fileno(), blocking=False)
        return mark(folder)

    with monkeypatch.context() as changed:
        changed.setattr(scratch, "_mark", check)
        with scratch_folder() as folder:
            assert (folder / MARKER).read_bytes() == mark(folder)


def test_a_copy_of_the_same_name_is_nobodys(temporary: Path) -> None:
    left = abandoned(temporary)
    shutil.copytree(left, temporary / "copy")
    left.rename(temporary / "first")
    copy = (temporary / "copy").rename(left)
    with scratch_folder():
        pass
    assert (copy / MARKER).exists()


def test_what_cannot_be_deleted_keeps_its_marker(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as changed:
        changed.setattr(scratch.shutil, "rmtree", lambda *_, **__: None)
        with scratch_folder() as folder:
            (folder / "inner").mkdir()
    assert (folder / MARKER).exists()
    with scratch_folder():
        assert not folder.exists()


def test_bench_keeps_what_it_cannot_cache_in_its_own_folder(temporary: Path) -> None:
    assert tempfile.gettempdir() == str(temporary)
    with as_in_cells():
        assert Path(tempfile.gettempdir()).parents[1] == temporary
    assert tempfile.gettempdir() == str(temporary)
