"""What a run tells of its progress: true, within a terminal's width, and at the same cost however many jobs
run."""

from __future__ import annotations

import io
import time
from collections.abc import Callable

import pyte
import pytest
from rich.console import Console

from harness.cell.phases import Phase, short
from harness.engines.jobs import Job
from harness.records import Cell, Conditions
from harness.schedule import progress, tally

CONDITIONS = Conditions("smoke", "absorbing", "sb3")


def job(method: str, env: str = "cartpole", shared: bool = False) -> Job:
    return Job((Cell(env, method, 0),), shared, CONDITIONS, "key")


def name_of(method: str) -> str:
    return job(method).name


def tally_of(running: int) -> tally.Tally:
    """Of 2,000 jobs of ten seconds, one of which is done and so many run."""
    found = tally.Tally({f"job{i}": 10.0 for i in range(2000)}, workers=1000)
    for i in range(running + 1):
        found.begin(f"job{i}")
    found.end("job0", "ok")
    return found


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the time, in seconds."""
    now = 0.0

    def set_to(seconds: float) -> None:
        nonlocal now
        now = seconds

    monkeypatch.setattr(time, "monotonic", lambda: now)
    return set_to


def test_the_time_left_is_known_before_anything_ended_and_a_slow_first_job_does_not_multiply_it(
    at: Callable[[float], None],
) -> None:
    """What cells share was expected to take a second, and takes four, most of it its process's start."""
    found = tally.Tally({"shared": 1.0} | {f"cell{i}": 60.0 for i in range(20)}, {"shared"}, workers=2)
    assert found.eta() == pytest.approx(1201 / 2)
    found.begin("shared")
    at(4.0)
    found.end("shared", "ok")
    assert 600 <= found.eta() < 620


def test_the_time_left_follows_a_pace_that_is_not_what_was_expected(at: Callable[[float], None]) -> None:
    found = tally.Tally({f"cell{i}": 10.0 for i in range(20)})
    for i in range(10):
        found.begin(f"cell{i}")
        at(30.0 * (i + 1))
        found.end(f"cell{i}", "ok")
    assert found.eta() == pytest.approx(300, rel=0.2)  # ten more of thirty seconds


def test_a_job_that_takes_longer_than_expected_is_never_said_to_end_now(at: Callable[[float], None]) -> None:
    found = tally.Tally({"cell": 10.0})
    found.begin("cell")
    at(100.0)
    assert found.eta() == pytest.approx(10.0)


def test_cells_alone_are_counted_as_the_run_counts_them(capsys: pytest.CaptureFixture[str]) -> None:
    jobs = [job("reference", shared=True), job("bc"), job("shaped")]
    lines = progress.Lines(tally.Tally(dict.fromkeys([one.name for one in jobs], 1.0), {jobs[0].name}))
    with lines:
        for one, status, reason in zip(jobs, ("ok", "ok", "failed"), ("", "", "no luck"), strict=True):
            lines.started(one)
            lines.finished(one, status, reason, {} if reason or one.shared else {"pi_star": 480.123})
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "start   cartpole__expert__seed0"
    assert "2 cells left" in out[1]
    assert "1 cell left" in out[3]
    assert out[3].endswith("): pi_star 480.1")
    assert "0 cells left" in out[5]
    assert out[5].endswith("): no luck")
    assert lines.tally.line().startswith("2 of 2 cells done, 1 failed, ")
    assert "ETA" not in lines.tally.line()


@pytest.mark.parametrize(
    ("phase", "shown"),
    [
        (Phase(), ""),
        (Phase("fit"), "fit"),
        (Phase("fit", 12_000), "fit step 12k"),
        (Phase("retrain", 12_000, 40_000), "RL step 12k of 40k"),
        (
            Phase("record", returns={"pi_star": 66.1, "pi_R": -0.25}),
            "recording; pi_star 66.1, pi_R -0.25",
        ),
        (Phase("something new"), "something new"),
    ],
)
def test_a_phase_is_shown_in_few_words(phase: Phase, shown: str) -> None:
    assert str(phase) == shown


def test_steps_are_short() -> None:
    counts = (0, 999, 1000, 12_345, 999_499, 999_500, 1_200_000)
    assert list(map(short, counts)) == ["0", "999", "1k", "12.3k", "999k", "1M", "1.2M"]


class Terminal:
    """A display on a terminal of this size, and what is seen there."""

    def __init__(self, width: int, height: int, doing: Callable[[str], Phase], its: tally.Tally) -> None:
        self.screen = pyte.Screen(width, height)
        self.stream = pyte.Stream(self.screen)
        self.file = io.StringIO()
        self.console = Console(
            file=self.file, force_terminal=True, width=width, height=height, highlight=False, _environ={}
        )
        self.display = progress.Display(its, doing, self.console)
        self.display.live.auto_refresh = False

    def seen(self) -> list[str]:
        """Its lines, after the display was drawn anew."""
        self.display.live.refresh()
        self.written = self.file.getvalue()
        self.file.seek(0)
        self.file.truncate()
        self.stream.feed(self.written.replace("\n", "\r\n"))
        return [line.rstrip() for line in self.screen.display if line.strip()]

    def resize(self, width: int, height: int) -> None:
        self.screen.resize(height, width)
        self.console.width, self.console.height = width, height


@pytest.mark.parametrize("width", [60, 80, 200])
def test_a_terminal_shows_a_line_for_each_running_cell_and_one_for_the_whole(
    width: int, at: Callable[[float], None]
) -> None:
    long = job("maxmargin_projection", "cartpole_swingup")
    jobs = [job("reference", shared=True), job("shaped"), long, job("bc")]
    phases = {
        job("shaped").name: Phase("retrain", 12_000, 40_000),
        long.name: Phase("retrain", 9_000, 40_000),
    }
    its = tally.Tally(dict.fromkeys([one.name for one in jobs], 100.0), {jobs[0].name}, 2)
    shown = Terminal(width, 24, lambda name: phases.get(name, Phase()), its)
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
        assert lines[4] == "latest: cartpole__bc__seed0: pi_star 480.0"
        assert len(lines) == 5


def test_a_failure_stays_above_what_is_redrawn() -> None:
    its = tally.Tally(dict.fromkeys([name_of("bc"), name_of("shaped")], 100.0))
    shown = Terminal(80, 24, lambda name: Phase("fit"), its)
    with shown.display:
        for method in ("bc", "shaped"):
            shown.display.started(job(method))
        shown.seen()
        shown.display.finished(job("bc"), "failed", "no luck")
        for _ in range(3):
            lines = shown.seen()
        assert lines[0] == "failed  cartpole__bc__seed0: no luck"
        assert [line.split()[0] for line in lines[1:2]] == ["cartpole__shaped__seed0"]
        assert len(lines) == 4


def test_colours_are_for_terminals_that_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(**variables: str) -> str:
        file = io.StringIO()
        console = Console(file=file, force_terminal=True, width=80, height=24, _environ=variables)
        display = progress.Display(tally_of(10), lambda name: Phase("fit"), console)
        display.console.print(display._render())
        return file.getvalue()

    assert "\x1b[" in drawn(TERM="xterm-256color")
    assert "\x1b[38" not in drawn(TERM="xterm-256color", NO_COLOR="1")
    for is_terminal, variables, kind in (
        (True, {"TERM": "xterm"}, progress.Display),
        (True, {"TERM": "dumb"}, progress.Lines),
        (False, {"TERM": "xterm"}, progress.Lines),
    ):
        monkeypatch.setattr("sys.stdout.isatty", lambda is_terminal=is_terminal: is_terminal, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        assert type(progress.progress_for(tally_of(1), lambda name: Phase())) is kind


def test_a_terminal_shows_as_many_jobs_as_it_has_room_for() -> None:
    asked: list[str] = []

    def doing(name: str) -> Phase:
        asked.append(name)
        return Phase("fit")

    shown = Terminal(80, 24, doing, tally_of(1000))
    with shown.display:
        asked.clear()
        lines = shown.seen()
        assert len(asked) == 19
    assert lines[19] == "  and 981 more"
    assert lines[-1].startswith("1 of 2000 cells done")
    assert len(lines) < 24
