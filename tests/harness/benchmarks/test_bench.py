"""Measures, and how they are taken and printed; their samples are asserted nowhere."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

import pytest

from harness.benchmarks import growth, measure, scale, speed
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
    # A bar is for the median, at least or at most by the unit.
    assert Measure("a", "times", [2.9, 2.9, 3.2], 3.0).missed
    assert not Measure("a", "s", [0.4, 0.4, 0.9], 0.5).missed
    assert Measure("a", SCORE, [0.9, 0.94, 1.0], 0.95).missed


def test_the_memory_of_processes_is_measured_and_a_failed_cell_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(growth, "FULL", measure.SMOKE)
    assert 100 < growth.largest_process("cartpole") < 5000
    assert min(growth.cells_in_a_row(2)) > 100
    with pytest.raises(RuntimeError, match="no method named 'nothing'"):
        measure.compute([Cell("gridworld", "nothing", 0)], measure.SMOKE, Processes(1))


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
