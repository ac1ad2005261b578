"""Measures, how they are taken and printed, and how what many cells take grows with their number."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from harness.benchmarks import growth, measure, scale, speed
from harness.benchmarks.measure import Measure
from harness.cli import main as cli
from harness.engines.processes import Processes
from harness.process.environment import CACHE_VARIABLE
from harness.records import Cell
from harness.report import html, model
from harness.report.files import report_files
from harness.report.model import build


def test_measures_are_printed_one_by_one_and_as_json_also_where_one_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ratio = Measure("RL", "times", [3, 1, 2.5], 3)
    memory = Measure("a worker", "MB", [1043.2], 2000)

    def fail() -> Iterator[Measure]:
        yield memory
        measure.command(["nonsense"])

    monkeypatch.setattr(speed, "measures", lambda: iter([ratio]))
    monkeypatch.setattr(growth, "measures", lambda: iter([memory]))
    monkeypatch.setattr(scale, "measures", lambda: iter([]))
    lines = "RL: 2.5 times (1 to 3), bar 3 MISSED\na worker: 1043 MB (1043 to 1043), bar 2000\n"
    assert cli.main(["bench"]) == 1
    assert capsys.readouterr().out == lines
    assert cli.main(["bench", "--json"]) == 1
    output = capsys.readouterr()
    assert output.err == lines
    everything = json.loads(output.out)
    assert everything["measures"] == [ratio.to_json(), memory.to_json()]
    assert cli.main(["bench", "growth"]) == 0
    assert capsys.readouterr().out == lines.splitlines()[1] + "\n"
    monkeypatch.setattr(growth, "measures", fail)
    assert cli.main(["bench", "growth", "--json"]) == 1
    output = capsys.readouterr()
    assert "FAILED: Command" in output.err
    assert len(json.loads(output.out)["measures"]) == 1


@pytest.fixture(autouse=True)
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results of short curves, for what they are is no matter here; and a cache of its own."""
    monkeypatch.setattr(scale, "CURVE", 3)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))


def times_as_long(work: Callable[[int], object], few: int, *, enough: float = 2.8) -> float:
    """How much longer the processor takes for twice as many, the best time of each count. The counts take
    turns, for a machine's speed changes, until the ratio is below `enough`, eight times at most."""

    def seconds(count: int) -> float:
        began = time.process_time()
        work(count)
        return time.process_time() - began

    work(few // 10)
    best = [math.inf, math.inf]
    for turn in range(8):
        best = [min(least, seconds(count)) for least, count in zip(best, (few, 2 * few), strict=True)]
        if turn > 0 and best[1] / best[0] < enough:
            break
    return best[1] / best[0]


def test_of_3000_cells_on_1000_workers_with_faults_none_is_lost_or_comes_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cells, cpu, megabytes = scale.drive(3000)  # which raises otherwise
    assert cells == 3000
    assert 0 < cpu < 5
    assert megabytes < 500
    save = scale.Account.save
    for times in (0, 2):
        monkeypatch.setattr(scale.Account, "save", lambda *its, n=times: [save(*its) for _ in range(n)])
        with pytest.raises(RuntimeError, match=f"of 100 cells {100 * times} came"):
            scale.drive(100)


def test_a_cell_that_fails_is_not_measured() -> None:
    with pytest.raises(RuntimeError, match="no method named 'nothing'"):
        measure.compute([Cell("gridworld", "nothing", 0)], measure.SMOKE, Processes(1))


def test_work_grows_no_faster_than_cells_and_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert scale.drive_and_store(200)[0] == 200
    assert times_as_long(scale.drive_and_store, 200) < 2.8
    assert times_as_long(scale.drive, 1000) < 2.8
    monkeypatch.setattr(model, "MOST_DRAWN", 0)
    shapes = (lambda n: (5, 3, 1, n // 70)), (lambda n: (3, 3, n // 40, 1))  # many seeds, many boards
    for shape in shapes:
        made = {count: scale.made_up(shape(count)) for count in (150, 1500, 3000)}
        assert times_as_long(lambda count, made=made: report_files(build(*made[count])), 1500) < 2.8


def test_a_page_lists_the_first_of_many_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html, "MOST_LISTED", 5)
    request, results = scale.made_up((2, 3, 1, 2))
    results = [dataclasses.replace(result, warnings=["odd"]) for result in results]
    text = str(report_files(build(request, results))["report.html"])
    assert text.count(": odd</li>") == 5
    assert f"and {len(results) - 5} more; scores.csv has every row" in text
