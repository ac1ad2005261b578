"""Measures, and how they are taken and printed; their samples are asserted nowhere."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from harness.benchmarks import growth, measure, scale, speed, spread
from harness.benchmarks.measure import SCORE, Measure
from harness.cli import main as cli
from harness.engines.jobs import Engine
from harness.engines.processes import Processes
from harness.records import Cell, CellResult, Conditions, Row
from harness.registry import SPECS


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


def test_both_ways_to_evaluate_take_whole_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "EPISODES", 20)
    spec = SPECS["highway"]
    idle = lambda obs: 0 * obs[:, : spec.act_size]  # noqa: E731
    assert 20 <= speed._together(spec, idle) <= 20 * spec.horizon
    assert 2 <= speed._one_by_one(spec, idle) <= 2 * spec.horizon


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


Compute = Callable[[list[Cell], Conditions, Engine], list[CellResult]]


def cells_that_took(seconds: list[dict[str, float]], fit_seconds: float, env_steps: int) -> Compute:
    def compute(cells: list[Cell], conditions: Conditions, engine: Engine) -> list[CellResult]:
        assert engine.workers == 1
        columns = {"fit_seconds": fit_seconds, "env_steps": env_steps}
        rows = [Row(c.env, c.method, c.seed, "pi_star", "absorbing", **columns) for c in cells]
        parts = zip(cells, rows, seconds, strict=True)
        return [CellResult(cell, [row], seconds=stages) for cell, row, stages in parts]

    return compute


def test_a_share_is_of_what_a_cell_took(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = [{"start": 1.0, "fit": 5.0 - i, "retrain": 2.0 + i, "score": 1.0 + i} for i in range(3)]
    monkeypatch.setattr(speed, "REPEATS", 2)
    monkeypatch.setattr(speed, "compute", cells_that_took(seconds, 0.0, 0))
    assert speed._beside_the_work() == pytest.approx([30, 100 * 4 / 11])


def test_a_fit_is_timed_with_the_steps_that_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "compute", cells_that_took([{}], 12.0, 8000))
    fit = speed._fit("swingup", "gail", bar=1.0)
    assert fit.name == "swingup, gail, fit, for each 100,000 of 8,000 environment steps"
    assert (fit.samples, fit.missed) == ([150.0], True)


@pytest.mark.parametrize(("seconds", "missed"), [({1: 60.0, 2: 40.0}, True), ({1: 60.0, 2: 30.0}, False)])
def test_two_nodes_are_compared_with_one(
    seconds: dict[int, float], missed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spread, "_seconds", seconds.get)
    (ratio,) = spread.measures()
    assert (ratio.samples, ratio.missed) == ([seconds[1] / seconds[2]] * spread.REPEATS, missed)


def hold(megabytes: int) -> int:
    held = bytearray(megabytes * measure.MEGABYTE)
    held[::4096] = b"x" * len(held[::4096])  # a byte of each page
    time.sleep(3 * measure.LOOK_EVERY)
    return megabytes


def test_the_peak_of_a_process_is_seen_after_its_end() -> None:
    with measure.watch() as idle:
        time.sleep(2 * measure.LOOK_EVERY)
    with measure.watch() as peak:
        assert measure.apart(hold, 1) == 1
        least, _ = peak
        assert measure.apart(hold, 300) == 300
    assert idle[0] < least  # Python's own helpers of other tests
    assert 250 < peak[0] - least < 350
    assert peak[1] > 300


def test_cells_of_one_process_are_measured_one_by_one() -> None:
    sizes = growth.cells_in_a_row(2)
    assert len(sizes) == 2
    assert min(sizes) > 100


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


def test_of_a_stopped_bench_nothing_is_kept(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop() -> Iterator[Measure]:
        raise KeyboardInterrupt

    monkeypatch.setattr(speed, "measures", stop)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        assert cli.main(["bench"]) == 130
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert capsys.readouterr().err == "\nstopped; nothing is kept\n"
