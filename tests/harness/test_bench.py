"""What the comparisons of `bench` come to; the figures themselves are asserted nowhere."""

from __future__ import annotations

import time

import pytest

from envs import SPECS
from envs.highway_fast import FastHighwayEnv
from harness import bench


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
    assert 3 <= bench._drive(FastHighwayEnv) <= 3 * spec.horizon
