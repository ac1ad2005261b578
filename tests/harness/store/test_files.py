"""Files that are read whole."""

import os
import stat
import tracemalloc
from pathlib import Path

import pytest

from harness.store.files import read

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
