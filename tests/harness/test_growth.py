"""What is said of memory is what processes hold; the figures themselves are asserted nowhere."""

from __future__ import annotations

import time

import pytest

from harness import growth
from harness.bench import compute
from harness.engines.processes import Processes
from harness.judge.results import Cell


def hold(megabytes: int) -> int:
    held = bytearray(megabytes * growth.MEGABYTE)
    held[::4096] = b"x" * len(held[::4096])  # a byte of each page
    time.sleep(3 * growth.LOOK_EVERY)
    return megabytes


def test_the_peak_of_a_process_is_seen_after_its_end() -> None:
    with growth.watch() as idle:
        time.sleep(2 * growth.LOOK_EVERY)
    with growth.watch() as peak:
        assert growth.apart(hold, 1) == 1
        least = peak.largest
        assert growth.apart(hold, 300) == 300
    assert idle.largest < least  # Python's own helpers of earlier tests
    assert 250 < peak.largest - least < 350
    assert peak.total > 300


def test_cells_of_one_process_are_measured_one_by_one() -> None:
    sizes = growth._cells_in_a_row(2)
    assert len(sizes) == 2
    assert min(sizes) > 100


def test_a_cell_that_fails_is_not_measured() -> None:
    with pytest.raises(RuntimeError, match="no method named 'nothing'"):
        compute([Cell("gridworld", "nothing", 0)], growth.SMOKE, Processes(1))
