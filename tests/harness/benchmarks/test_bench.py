"""Measures, and how they are taken and printed; their samples are asserted nowhere."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

import pytest

from harness.benchmarks import growth, measure, scale, speed, spread
from harness.benchmarks.measure import SCORE, Measure
from harness.cli import main as cli
from harness.engines.processes import Processes
from harness.records import Cell


def test_a_ratio_is_of_rates_taken_in_turn() -> None:
    calls: list[str] = []

    def work(name: str, done: int) -> int:
        calls.append(name)
        time.sleep(0.02)
        return done

    ratio = measure.compare("a", lambda: work("ours", 8), lambda: work("theirs", 1), 3, repeats=3)
    assert calls == ["theirs", "ours", "ours", "theirs"] * 2
    assert (ratio.unit, len(ratio.samples)) == ("times", 3)
    described = ratio.to_json()
    assert 2 < described["low"] <= described["median"] <= described["high"] < 32
    assert described["bar"] == 3


@pytest.mark.parametrize(
    ("unit", "samples", "bar", "missed"),
    [
        ("times", [2.9, 3.1, 3.2], 3.0, False),
        ("times", [2.9, 2.9, 3.2], 3.0, True),
        ("s", [0.4, 0.4, 0.9], 0.5, False),
        ("MB", [701.0], 700.0, True),
        (SCORE, [0.9, 0.94, 1.0], 0.95, True),
    ],
)
def test_a_bar_is_for_the_median(unit: str, samples: list[float], bar: float, missed: bool) -> None:
    assert Measure("a", unit, samples, bar).missed == missed


def test_a_solve_of_the_true_reward_is_scored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "SEEDS", range(100, 101))
    seconds, score = speed._solves("cartpole", bar=100)
    assert seconds.samples[0] > 0.1
    assert 0.95 < score.samples[0] < 1.05
    assert not score.missed


def test_the_memory_of_processes_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "FULL", measure.SMOKE)
    assert 100 < growth.largest_process("cartpole") < 5000
    assert min(growth.cells_in_a_row(2)) > 100


@pytest.mark.parametrize(("seconds", "missed"), [({1: 60.0, 2: 40.0}, True), ({1: 60.0, 2: 30.0}, False)])
def test_two_nodes_are_compared_with_one(
    seconds: dict[int, float], missed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spread, "_seconds", seconds.get)
    (ratio,) = spread.measures()
    assert (ratio.samples, ratio.missed) == ([seconds[1] / seconds[2]] * spread.REPEATS, missed)


def test_a_cell_that_fails_is_not_measured() -> None:
    with pytest.raises(RuntimeError, match="no method named 'nothing'"):
        measure.compute([Cell("gridworld", "nothing", 0)], measure.SMOKE, Processes(1))


def test_measures_are_printed_one_by_one_and_as_json_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ratio = Measure("RL", "times", [3, 1, 2.5], 3)
    memory = Measure("a worker", "MB", [1043.2], 2000)
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
    assert everything["cores"] >= 1
    assert everything["numpy"]
    assert cli.main(["bench", "growth"]) == 0
    assert capsys.readouterr().out == lines.splitlines()[1] + "\n"


def test_what_fails_is_a_line_and_what_was_measured_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> Iterator[Measure]:
        yield Measure("RL", "times", [3], 1)
        measure.command(["nonsense"])

    monkeypatch.setattr(speed, "measures", fail)
    assert cli.main(["bench", "--json"]) == 1
    output = capsys.readouterr()
    assert "FAILED: Command" in output.err
    assert len(json.loads(output.out)["measures"]) == 1
