"""Live progress of a run: a display on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.text import Text

from harness.run.codec import printable

FEW, EVERY = 64, 1.0
"""Where more tasks run, how long the rest may take is reckoned once in so many seconds: each is looked at."""


class Progress(Protocol):
    """What a run tells as it goes; a context manager."""

    def started(self, name: str) -> None: ...

    def finished(self, name: str, status: str, reason: str = "") -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def progress_for(costs: dict[str, float], workers: int, doing: Callable[[str], str]) -> Progress:
    """The one that suits standard output. costs: what each task is expected to take, in any unit. doing: what
    a task that runs does, in a few words."""
    if sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM") != "dumb":
        return _Display(_Tally(costs, workers), doing)
    return _Lines(_Tally(costs, workers))


def say(text: str) -> None:
    """Prints a line on standard output, at once, and nothing that moves the cursor."""
    print(_shown(text), flush=True)


def tell(text: str) -> None:
    """Prints a line on standard error: what must not be overlooked."""
    print(_shown(text), file=sys.stderr, flush=True)


def _shown(text: str) -> str:
    return "\n".join(map(printable, text.split("\n")))


class _Tally:
    """What is done, what runs, and how long the rest may take."""

    def __init__(self, costs: dict[str, float], workers: int) -> None:
        self.costs = costs
        self.workers = workers
        self.waiting = dict(costs)
        self.running: dict[str, float] = {}
        """When each task started, in seconds of `time.monotonic`."""
        self.failed = 0
        self._left = sum(costs.values())
        """What is expected of those that wait."""
        self._spent = self._done = 0.0
        self._start = time.monotonic()
        self._eta, self._reckoned = "?", -math.inf

    def begin(self, name: str) -> None:
        self._left -= self.waiting.pop(name, 0.0)
        self.running[name] = time.monotonic()

    def end(self, name: str, status: str) -> float | None:
        """Seconds that the task took; None if it never ran."""
        self._left -= self.waiting.pop(name, 0.0)
        self.failed += status == "failed"
        if name not in self.running:
            return None
        seconds = time.monotonic() - self.running.pop(name)
        if status != "failed":
            self._spent += seconds
            self._done += self.costs[name]
        return seconds

    @property
    def left(self) -> int:
        return len(self.waiting) + len(self.running)

    @property
    def elapsed(self) -> float:
        return time.monotonic() - self._start

    def eta(self) -> str:
        """How long the rest may take, by the pace so far."""
        now = time.monotonic()
        if len(self.running) <= FEW or now - self._reckoned >= EVERY:
            self._eta, self._reckoned = self._reckon(now), now
        return self._eta

    def _reckon(self, now: float) -> str:
        if not self._done:
            return "?"
        pace = self._spent / self._done
        rest = max(self._left * pace, 0.0)
        of_running = [max(self.costs[name] * pace - now + start, 0.0) for name, start in self.running.items()]
        return clock(max([(rest + sum(of_running)) / self.workers, *of_running]))

    def line(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        done = len(self.costs) - self.left
        return f"{done} of {len(self.costs)} done{failed}, {clock(self.elapsed)} passed, ETA {self.eta()}"


def clock(seconds: float) -> str:
    """`seconds` as m:ss or h:mm:ss."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"


class _Lines:
    """One line when a task starts and one when it ends."""

    def __init__(self, tally: _Tally) -> None:
        self.tally = tally

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def started(self, name: str) -> None:
        self.tally.begin(name)
        say(f"start   {name}")

    def finished(self, name: str, status: str, reason: str = "") -> None:
        seconds = self.tally.end(name, status)
        took = "not run" if seconds is None else f"{seconds:.1f} s"
        why = f": {reason}" if reason else ""
        say(f"{status:7} {name} ({took}; {self.tally.left} left, ETA {self.tally.eta()}){why}")


class _Display:
    """What runs and how far the whole is, redrawn in place; failures stay above it."""

    def __init__(self, tally: _Tally, doing: Callable[[str], str]) -> None:
        self.tally, self.doing = tally, doing
        self.console = Console()
        self.live = Live(
            get_renderable=self._render, console=self.console, refresh_per_second=2, transient=True
        )

    def __enter__(self) -> Self:
        self.live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.live.stop()
        self.console.print(Text(self.tally.line()))

    def started(self, name: str) -> None:
        self.tally.begin(name)

    def finished(self, name: str, status: str, reason: str = "") -> None:
        self.tally.end(name, status)
        if reason:
            self.console.print(Text(f"{status:7} {name}: {reason}"))

    def _render(self) -> RenderableType:
        now = time.monotonic()
        tasks = list(self.tally.running.items())
        most = max(
            1, self.console.height - 4
        )  # beside how many more there are, the bar, the line, the cursor
        running = [
            Text(f"  {name}  {clock(now - t)}  {printable(self.doing(name))}".rstrip())
            for name, t in tasks[:most]
        ]
        if len(tasks) > most:
            running.append(Text(f"  and {len(tasks) - most} more"))
        total = len(self.tally.costs)
        return Group(
            *running, ProgressBar(total=total, completed=total - self.tally.left), Text(self.tally.line())
        )
