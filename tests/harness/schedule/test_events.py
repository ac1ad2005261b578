"""Progress for programs: lines of JSON of known types."""

from __future__ import annotations

import contextlib
import io
import json
import math
import time

import msgspec
import pytest

from harness.cell.phases import Phase
from harness.engines.jobs import Job
from harness.records import Cell, Conditions, Shown
from harness.schedule import events
from harness.schedule.events import AnyEvent, Begun, Computed, Doing, Ended, Events, Started
from harness.schedule.tally import Tally

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
SHARED = Job((Cell("cartpole", "bc", 3),), True, CONDITIONS, "key")
BC = Job((Cell("cartpole", "bc", 3, Shown(5, 20, "noisy"), "flipped"),), False, CONDITIONS, "key")


def decoded(text: str) -> list[AnyEvent]:
    """Every line, of a known type; nothing is in it that no type has."""
    found = [msgspec.json.decode(line, type=AnyEvent) for line in text.splitlines()]
    assert [json.loads(line) for line in text.splitlines()] == [msgspec.to_builtins(event) for event in found]
    return found


def test_what_happens_is_told_in_order_and_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "LOOK_EVERY", 0.01)
    stream, phase = io.StringIO(), Phase("retrain", 12_000, 40_000, {"pi_star": 66.125, "pi_R": math.nan})
    tally = Tally({SHARED.name: 1.0, BC.name: 10.0}, {SHARED.name}, workers=2)
    with Events(tally, lambda name: phase if name == BC.name else Phase(), stream) as told:
        told.started(SHARED)
        told.finished(SHARED, "ok")
        told.started(BC)
        while "doing" not in stream.getvalue():
            time.sleep(0.005)
        time.sleep(0.05)
        told.finished(BC, "ok", returns={"pi_star": 66.125, "pi_R": math.nan})
    begun, shared, made, started, doing, ended, computed = decoded(stream.getvalue())
    assert isinstance(begun, Begun)
    assert (begun.format, begun.cells, begun.workers, begun.eta) == (1, 1, 2, pytest.approx(5.5, abs=5))
    assert isinstance(shared, Started)
    assert (shared.job.name, shared.job.method, shared.job.demos) == ("cartpole__expert__seed3", None, None)
    assert isinstance(made, Ended)
    assert (made.name, made.cells_done, made.cells_left) == ("cartpole__expert__seed3", 0, 1)
    assert isinstance(started, Started)
    its = started.job
    assert (its.env, its.dynamics, its.method, its.seed) == ("cartpole", "flipped", "bc", 3)
    assert (its.demos, its.every, its.demonstrator) == (5, 20, "noisy")
    assert isinstance(doing, Doing)
    assert (doing.name, doing.phase, doing.step, doing.of) == (BC.name, "retrain", 12_000, 40_000)
    assert doing.returns == {"pi_star": 66.125}
    assert isinstance(ended, Ended)
    assert (ended.status, ended.reason, ended.returns) == ("ok", "", {"pi_star": 66.125})
    assert (ended.cells_done, ended.cells_left, ended.cells_failed) == (1, 0, 0)
    assert ended.took is not None
    assert isinstance(computed, Computed)
    assert (computed.cells_done, computed.stopped) == (1, False)


def test_what_failed_or_never_ran_and_a_stop_are_told() -> None:
    stream = io.StringIO()
    told = Events(Tally({BC.name: 1.0, "other": 1.0}), lambda name: Phase(), stream)
    with contextlib.suppress(KeyboardInterrupt), told:
        told.finished(BC, "failed", "no expert: no gradient")
        raise KeyboardInterrupt
    _, ended, computed = decoded(stream.getvalue())
    assert isinstance(ended, Ended)
    assert (ended.status, ended.took, ended.reason) == ("failed", None, "no expert: no gradient")
    assert isinstance(computed, Computed)
    assert (computed.cells_failed, computed.cells_left, computed.stopped) == (1, 1, True)
