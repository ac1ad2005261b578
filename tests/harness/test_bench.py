"""What the comparisons of `bench` come to; the figures themselves are asserted nowhere."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator

import pytest

from harness import bench, cli, growth, scale, spread
from harness.engines.jobs import Engine
from harness.engines.ray import Ray
from harness.judge.results import Cell, CellResult, Conditions, Row
from harness.registry import SPECS, Library


def test_a_ratio_is_of_rates_taken_in_turn() -> None:
    calls: list[str] = []

    def work(name: str, seconds: float, done: int) -> int:
        calls.append(name)
        time.sleep(seconds)
        return done

    found = bench.compare("a", lambda: work("ours", 0.02, 8), lambda: work("theirs", 0.02, 1), 3, repeats=3)
    assert calls == ["theirs", "ours", "ours", "theirs"] * 2
    assert found.unit == "times"
    assert len(found.values) == 3
    described = found.to_json()
    assert 2 < described["low"] <= described["median"] <= described["high"] < 32
    assert described["bar"] == 3


def test_both_ways_to_evaluate_take_whole_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "EPISODES", 20)
    spec = SPECS["highway"]
    idle = lambda obs: 0 * obs[:, : spec.act_size]  # noqa: E731
    assert 20 <= bench._together(spec, idle) <= 20 * spec.horizon
    assert 2 <= bench._one_by_one(spec, idle) <= 2 * spec.horizon
    assert 3 <= bench._drive_upstream() <= 3 * spec.horizon
    assert bench._drive() == bench.BLOCK * spec.horizon


def test_a_share_is_of_what_a_cell_took(monkeypatch: pytest.MonkeyPatch) -> None:
    def compute(cells: list[Cell], conditions: Conditions, engine: Engine) -> list[CellResult]:
        assert engine.workers == 1
        row = Row("cartpole", "shaped", 0, "pi_star", "absorbing")
        seconds = [{"start": 1.0, "fit": 5.0 - i, "retrain": 2.0 + i, "score": 1.0 + i} for i in range(3)]
        return [CellResult(cell, [row], seconds=its) for cell, its in zip(cells, seconds, strict=True)]

    monkeypatch.setattr(bench, "REPEATS", 2)
    monkeypatch.setattr(bench, "compute", compute)
    assert bench._beside_the_work() == pytest.approx([30, 100 * 4 / 11])


@pytest.mark.parametrize(
    ("unit", "values", "bar", "missed"),
    [
        ("times", [2.9, 3.1, 3.2], 3.0, False),
        ("times", [2.9, 2.9, 3.2], 3.0, True),
        ("s", [0.4, 0.4, 0.9], 0.5, False),
        ("MB", [701.0], 700.0, True),
        ("%", [9.0], None, False),
        (bench.SCORE, [0.9, 0.94, 1.0], 0.95, True),
    ],
)
def test_a_bar_is_for_the_median(unit: str, values: list[float], bar: float | None, missed: bool) -> None:
    assert bench.Measure("a", unit, values, bar).missed == missed


@pytest.mark.parametrize("library", ["sbx", "sb3"])
def test_a_solve_of_the_true_reward_is_scored(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "SEEDS", range(100, 101))
    seconds, score = bench._solves("cartpole", library, bar=None)
    assert seconds.values[0] > 0.1
    assert 0.95 < score.values[0] < 1.05
    assert not score.missed


def test_figures_are_told_one_by_one_and_as_json_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ratio = bench.Measure("RL", "times", [3, 1, 2.5], 3)
    memory = bench.Measure("a worker", "MB", [1043.2], None)
    monkeypatch.setattr(bench, "bench", lambda: iter([ratio]))
    monkeypatch.setattr(growth, "growth", lambda: iter([memory]))
    monkeypatch.setattr(scale, "scale", lambda: iter([]))
    lines = "RL: 2.5 times (1 to 3), bar 3 MISSED\na worker: 1043 MB (1043 to 1043)\n"
    assert cli.main(["bench"]) == 1
    assert capsys.readouterr().out == lines
    assert cli.main(["bench", "--json"]) == 1
    told = capsys.readouterr()
    assert told.err == lines
    everything = json.loads(told.out)
    assert everything["measures"] == [ratio.to_json(), memory.to_json()]
    assert everything["cores"] >= 1
    assert everything["numpy"]
    assert cli.main(["bench", "growth"]) == 0
    assert capsys.readouterr().out == lines.splitlines()[1] + "\n"


def test_what_fails_is_a_line_and_what_was_measured_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> Iterator[bench.Measure]:
        yield bench.Measure("RL", "times", [3], None)
        bench.command(["nonsense"])

    monkeypatch.setattr(bench, "bench", fail)
    assert cli.main(["bench", "--json"]) == 1
    told = capsys.readouterr()
    assert "FAILED: Command" in told.err
    assert len(json.loads(told.out)["measures"]) == 1


def test_of_a_stopped_bench_nothing_is_kept(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop() -> Iterator[bench.Measure]:
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "bench", stop)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        assert cli.main(["bench"]) == 130
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert capsys.readouterr().err == "\nstopped; nothing is kept\n"


def test_two_nodes_are_compared_with_one_and_a_cluster_with_this_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(spread, "_seconds", {1: 60.0, 2: 40.0}.get)
    monkeypatch.setattr(spread, "_for_each", lambda engine: 1.5 if isinstance(engine, Ray) else 1.25)
    pytest.importorskip("ray", reason="of the extra irl-bench[ray]")
    nodes, added = spread.spread()
    assert (nodes.values, nodes.missed) == ([1.5] * spread.FEW, True)
    assert (added.values, added.unit) == ([250.0] * spread.REPEATS, "ms")


def test_a_fit_is_timed_with_the_steps_that_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    def compute(cells: list[Cell], conditions: Conditions, engine: Engine) -> list[CellResult]:
        assert not conditions.retrain
        steps = {"gail": 8000, "bc": 0}
        rows = [
            Row(c.env, c.method, 0, "pi_star", "absorbing", fit_seconds=12.0, env_steps=steps[c.method])
            for c in cells
        ]
        return [CellResult(cell, [row]) for cell, row in zip(cells, rows, strict=True)]

    monkeypatch.setattr(bench, "compute", compute)
    found = bench._fit("swingup", "gail", each=1000, bar=1.0)
    assert (found.name, found.values) == (
        "swingup, gail, fit, for each 1,000 of 8,000 environment steps",
        [1.5],
    )
    assert found.missed
    assert bench._fit("swingup", "bc", each=1000, bar=None).values == [12.0]
