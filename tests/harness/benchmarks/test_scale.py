"""What many cells and rows take grows with their number and no faster; and of many none is lost."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.benchmarks import scale
from harness.process.environment import CACHE_VARIABLE
from harness.records import Shown
from harness.registry.keys import cell_keys
from harness.report import charts, curves, html, model
from harness.report.files import report_files
from harness.report.model import build
from harness.store.request import Request


@pytest.fixture(autouse=True)
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results of short curves, for what they are is no matter here; and a cache of its own."""
    monkeypatch.setattr(scale, "CURVE", 3)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))


def growth(work: Callable[[int], object], few: int, *, enough: float = 2.8) -> float:
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


def test_of_3000_cells_on_1000_workers_with_faults_none_is_lost() -> None:
    cells, cpu, megabytes = scale.drive(3000)  # which raises where one is, or comes twice
    assert cells == 3000
    assert 0 < cpu < 5
    assert megabytes < 500


@pytest.mark.parametrize("times", [0, 2])
def test_a_cell_that_is_lost_or_comes_twice_is_noticed(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    save = scale.Account.save
    monkeypatch.setattr(scale.Account, "save", lambda *given: [save(*given) for _ in range(times)])
    with pytest.raises(RuntimeError, match=f"of 100 cells {100 * times} came"):
        scale.drive(100)


def test_work_grows_no_faster_than_cells_and_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert scale.drive_and_store(200)[0] == 200
    assert growth(scale.drive_and_store, 200) < 2.8
    assert growth(scale.drive, 1000) < 2.8
    monkeypatch.setattr(model, "MOST_DRAWN", 0)
    shapes = (lambda n: (5, 3, 1, n // 70)), (lambda n: (3, 3, n // 40, 1))  # many seeds, many boards
    for shape in shapes:
        made = {count: scale.made_up(shape(count)) for count in (150, 1500, 3000)}
        assert growth(lambda count, made=made: report_files(build(*made[count])), 1500) < 2.8


def test_keys_grow_no_faster_than_cells_and_hardly_with_their_seeds() -> None:
    def keys(seeds: int, shown: int) -> None:
        ways = tuple(map(Shown, range(1, shown + 1)))
        request = Request(("bc", "gail"), ("cartpole", "swingup"), tuple(range(seeds)), scale.SMOKE, ways)
        cell_keys(request.cells, request.conditions, {})

    assert growth(lambda count: keys(1, count), 100) < 2.8
    assert growth(lambda count: keys(count, 20), 10, enough=1.8) < 1.8


def test_a_run_of_many_rows_is_drawn_in_few_figures_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, asked = [], []
    monkeypatch.setattr(charts, "scores", lambda board: drawn.append(board.name))
    for name in ("costs", "distances", "demonstrations"):
        monkeypatch.setattr(charts, name, lambda *its: None)
    monkeypatch.setattr(curves, "learning", lambda board, most: asked.append(most))
    monkeypatch.setattr(model, "MANY_ROWS", 2000)
    monkeypatch.setattr(model, "MOST_LINES", 1000)
    monkeypatch.setattr(html, "MOST_LISTED", 5)
    request, results = scale.made_up((2, 3, 40, 4))
    results = [dataclasses.replace(result, warnings=["odd"]) for result in results]
    files = report_files(build(request, results))
    rows = list(csv.DictReader(io.StringIO(str(files["scores.csv"]))))
    assert len(rows) == sum(len(result.rows) for result in results) > 2000
    lines = list(csv.DictReader(io.StringIO(str(files["leaderboard.csv"]))))
    boards = list(dict.fromkeys((line["env"], line["demos"]) for line in lines))
    assert len(boards) == 80
    assert len(drawn) == model.MOST_DRAWN_OF_MANY
    assert asked == [model.MOST_PANELS_OF_MANY] * model.MOST_DRAWN_OF_MANY
    page = str(files["report.html"])
    assert page.count(": odd</li>") == 5
    assert f"and {len(results) - 5} more; scores.csv has every row" in page
    shown = 1000 // (len(lines) // 80)
    assert str(files["leaderboard.md"]).count("## task") == shown
    for text in (page, str(files["leaderboard.md"])):
        assert f"the first {shown} of 80 boards are shown; leaderboard.csv has the lines of all" in text
        assert f"figures are of the first {model.MOST_DRAWN_OF_MANY} boards" in text
        assert "task1, 40 demonstrations" not in text
