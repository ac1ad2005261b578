"""Files that are read whole, and nowhere else; folders that are filled, or not there."""

import os
import stat
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from harness.store.files import new_folder, opened_below, read

BLOCK = 1 << 16


def test_reading_asks_for_memory_for_what_there_is_and_not_for_the_most_that_may_be(tmp_path: Path) -> None:
    file = tmp_path / "small"
    file.write_bytes(b"x" * 2000)
    tracemalloc.start()
    try:
        assert read(file, 1 << 28) == b"x" * 2000
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("more", [0, 1, 2, BLOCK, 5 * BLOCK])
def test_a_file_that_grows_while_it_is_read_is_read_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: int
) -> None:
    file = tmp_path / "grown"
    file.write_bytes(bytes(10 * BLOCK))
    size, now = file.stat().st_size, os.fstat

    def earlier(handle: int) -> os.stat_result:
        fields = [*now(handle)]
        fields[stat.ST_SIZE] -= more
        return os.stat_result(fields)

    monkeypatch.setattr(os, "fstat", earlier)
    assert read(file, size) == file.read_bytes()
    with pytest.raises(OSError, match="it is larger than"):
        read(file, size - 1)


def read_below(*its: Any) -> bytes:
    with opened_below(*its) as file:
        return file.read()


def test_no_link_below_a_folder_is_followed(tmp_path: Path) -> None:
    (tmp_path / "run/a").mkdir(parents=True)
    (tmp_path / "run/a/file").write_text("mine")
    secret = tmp_path / "secret"
    secret.write_text("secret")
    (tmp_path / "run/link").symlink_to(secret)
    (tmp_path / "run/folder").symlink_to(tmp_path / "run/a")
    assert read_below(tmp_path / "run", "a/file") == b"mine"
    for name in ("link", "folder/file", "../secret", str(secret), "a/../../secret", "a", "none", "", "x\0"):
        with pytest.raises(OSError, match=r"link|leads out|no regular|No such|null"):
            read_below(tmp_path / "run", name)
    with pytest.raises(OSError, match="larger than"):
        read_below(tmp_path / "run", "a/file", 3)


def interrupted(target: Path) -> None:
    with new_folder(target) as folder:
        (folder / "half").write_text("half")
        raise KeyboardInterrupt


def test_a_folder_that_cannot_be_filled_is_not_left(tmp_path: Path) -> None:
    for there in (False, True):
        target = tmp_path / "deep/er/page"
        if there:
            target.mkdir(parents=True)
        with pytest.raises(KeyboardInterrupt):
            interrupted(target)
        assert target.exists() == (tmp_path / "deep").exists() == there
        if there:
            assert [*target.iterdir()] == []
    with new_folder(target) as folder:
        (folder / "whole").write_text("whole")
    assert [file.name for file in target.iterdir()] == ["whole"]
    with new_folder(tmp_path / "another/one") as folder:
        (folder / "whole").write_text("whole")
    assert [file.name for file in (tmp_path / "another").rglob("*")] == ["one", "whole"]
