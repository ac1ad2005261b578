"""What a run tells of its progress costs the same however many tasks run."""

from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from harness.run import progress


def tally(running: int) -> progress._Tally:
    """Of 2,000 tasks of ten seconds, one of which is done and so many run."""
    found = progress._Tally({f"task{i}": 10.0 for i in range(2000)}, workers=1000)
    for i in range(running + 1):
        found.begin(f"task{i}")
    found.end("task0", "ok")
    return found


def test_of_many_running_tasks_the_time_left_is_reckoned_once_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    few, many = tally(progress.FEW), tally(1000)
    reckoned = {"few": 0, "many": 0}

    def counting(name: str, its: progress._Tally) -> None:
        reckon = its._reckon

        def counted(now: float) -> str:
            reckoned[name] += 1
            return reckon(now)

        monkeypatch.setattr(its, "_reckon", counted)

    counting("few", few)
    counting("many", many)
    for _ in range(300):
        now += 0.01
        few.eta()
        many.eta()
    assert reckoned == {"few": 300, "many": 3}


def test_the_time_left_is_right_again_where_few_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    found = progress._Tally({f"task{i}": 10.0 for i in range(100)}, workers=100)
    for name in found.costs:
        found.begin(name)
    now = 10.0
    for name in list(found.costs):
        found.end(name, "ok")
        found.eta()
    assert (found.left, found.eta()) == (0, "0:00")


def test_a_terminal_shows_as_many_tasks_as_it_has_room_for() -> None:
    asked: list[str] = []

    def doing(name: str) -> str:
        asked.append(name)
        return "fit"

    display = progress._Display(tally(1000), doing)
    display.console = Console(height=24, width=80, file=io.StringIO())
    asked.clear()
    display.console.print(display._render())
    assert isinstance(display.console.file, io.StringIO)
    lines = display.console.file.getvalue().splitlines()
    assert len(asked) == 20
    assert lines[20] == "  and 980 more"
    assert lines[-1].startswith("1 of 2000 done")
    assert len(lines) < 24
