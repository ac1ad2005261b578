"""Progress: the time that is left, lines and a live display for people, and JSON for programs."""

import contextlib
import io
import json
import math
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pyte
import pytest
from rich.console import Console

from harness.cell.phases import Phase
from harness.engines.jobs import Job
from harness.records import Cell, Shown
from harness.schedule import events, progress
from harness.schedule.events import AnyEvent, Events
from harness.schedule.tally import Tally
from tests.harness.fake_runs import CONDITIONS

SHARED = Job((Cell("cartpole", "bc", 3),), True, CONDITIONS, "key")
BC = Job((Cell("cartpole", "bc", 3, Shown(5, 20, "noisy"), "flipped"),), False, CONDITIONS, "key")


def job(method: str, env: str = "cartpole", shared: bool = False) -> Job:
    return Job((Cell(env, method, 0),), shared, CONDITIONS, "key")


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the time, in seconds."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return lambda seconds: now.__setitem__(0, seconds)


def test_the_time_left_follows_the_pace_and_is_never_none_of_a_job_that_runs(
    at: Callable[[float], None],
) -> None:
    found = Tally({f"cell{i}": 10.0 for i in range(20)})
    for i in range(10):
        found.begin(f"cell{i}")
        at(30.0 * (i + 1))
        found.end(f"cell{i}", "ok")
    assert found.eta() == pytest.approx(300, rel=0.2)  # ten more of thirty seconds
    overdue = Tally({"cell": 10.0})
    overdue.begin("cell")
    at(400.0)
    assert overdue.eta() == pytest.approx(10.0)


class Terminal:
    """A display on a terminal of 24 lines, and what is seen there."""

    def __init__(self, width: int, doing: Callable[[str], Phase], its: Tally) -> None:
        self.screen = pyte.Screen(width, 24)
        self.stream = pyte.Stream(self.screen)
        self.file = io.StringIO()
        size = {"width": width, "height": 24}
        console = Console(file=self.file, force_terminal=True, highlight=False, _environ={}, **size)
        self.display = progress.Display(its, doing, console)
        self.display.live.auto_refresh = False

    def seen(self) -> list[str]:
        """Return its lines, after the display was drawn anew."""
        self.display.live.refresh()
        self.stream.feed(self.file.getvalue().replace("\n", "\r\n"))
        self.file.seek(0)
        self.file.truncate()
        return [line.rstrip() for line in self.screen.display if line.strip()]


@pytest.mark.parametrize("width", [60, 200])
def test_a_terminal_shows_a_line_for_each_running_cell_and_one_for_the_whole(
    width: int, at: Callable[[float], None]
) -> None:
    long = job("maxmargin_projection", "cartpole_swingup")
    jobs = [job("reference", shared=True), job("shaped"), long, job("bc")]
    phases = {
        job("shaped").name: Phase("retrain", 12_000, 40_000),
        long.name: Phase("retrain", 9_000, 40_000),
    }
    its = Tally(dict.fromkeys([one.name for one in jobs], 100.0), {jobs[0].name}, 2)
    shown = Terminal(width, lambda name: phases.get(name, Phase()), its)
    with shown.display:
        shown.display.started(jobs[0])
        assert shown.seen()[0].endswith("  expert and demonstrations")
        for one in jobs[1:]:
            shown.display.started(one)
        shown.display.finished(jobs[0], "ok")
        shown.display.finished(jobs[3], "ok", returns={"pi_star": 480.0})
        at(65.0)
        lines = shown.seen()
    assert lines[0] == "  cartpole__shaped__seed0  1:05  RL step 12k of 40k"
    whole = "  cartpole_swingup__maxmargin_projection__seed0  1:05  RL step 9k of 40k"
    assert lines[1] == whole or (len(lines[1]) <= width == 60 and "…" in lines[1])
    assert lines[1].endswith("seed0  1:05  RL step 9k of 40k")
    assert set(lines[2]) <= set("━╸╺")
    assert lines[3].startswith("1 of 3 cells done, 1:05 passed, ETA 0:")
    assert lines[4:] == ["latest: cartpole__bc__seed0: pi_star 480.0"]


def decoded(stream: io.StringIO) -> list[dict[str, Any]]:
    """Return every line, of a known type, which has every field of the line."""
    lines = stream.getvalue().splitlines()
    found = [json.loads(line) for line in lines]
    assert found == [msgspec.to_builtins(msgspec.json.decode(line, type=AnyEvent)) for line in lines]
    return found


def test_what_happens_is_told_in_order_and_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "LOOK_EVERY", 0.01)
    returns = {"pi_star": 66.125, "pi_R": math.nan}
    stream, phase = io.StringIO(), Phase("retrain", 12_000, 40_000, returns)
    tally = Tally({SHARED.name: 1.0, BC.name: 10.0}, {SHARED.name}, workers=2)
    with Events(tally, lambda name: phase if name == BC.name else Phase(), stream) as told:
        told.started(SHARED)
        told.finished(SHARED, "ok")
        told.started(BC)
        while "doing" not in stream.getvalue():
            time.sleep(0.005)
        time.sleep(0.05)
        told.finished(BC, "ok", returns=returns)
    shared = {"name": "cartpole__expert__seed3", "env": "cartpole", "seed": 3, "method": None, "demos": None}
    own = {"method": "bc", "dynamics": "flipped", "demos": 5, "every": 20, "demonstrator": "noisy"}
    finite = {"returns": {"pi_star": 66.125}}
    expected: list[dict[str, Any]] = [
        {"format": 1, "cells": 1, "workers": 2, "eta": pytest.approx(5.5, abs=5)},
        shared,
        {"name": shared["name"], "cells_done": 0, "cells_left": 1},
        shared | {"name": BC.name} | own,
        {"name": BC.name, "phase": "retrain", "step": 12_000, "of": 40_000} | finite,
        {"status": "ok", "reason": "", "cells_done": 1, "cells_left": 0, "cells_failed": 0} | finite,
        {"cells_done": 1, "stopped": False},
    ]
    found = decoded(stream)
    order = ["begun", "started", "ended", "started", "doing", "ended", "computed"]
    assert [event["event"] for event in found] == order
    assert found[5]["took"] is not None
    for event, wanted in zip(found, expected, strict=True):
        its = event.get("job", event)
        assert {name: its[name] for name in wanted} == wanted


def test_what_failed_or_never_ran_and_a_stop_are_told() -> None:
    stream = io.StringIO()
    told = Events(Tally({BC.name: 1.0, "other": 1.0}), lambda name: Phase(), stream)
    with contextlib.suppress(KeyboardInterrupt), told:
        told.finished(BC, "failed", "no expert: no gradient")
        raise KeyboardInterrupt
    _, ended, computed = decoded(stream)
    assert (ended["status"], ended["took"], ended["reason"]) == ("failed", None, "no expert: no gradient")
    assert (computed["cells_failed"], computed["cells_left"], computed["stopped"]) == (1, 1, True)
