"""What of a run is done, what runs, and how long the rest may take."""

from __future__ import annotations

import math
import time
from collections.abc import Collection

NO_NUMBERS = "It counts what is done, for people."

FEW, EVERY = 64, 1.0
"""Where more jobs run, how long the rest may take is reckoned once in so many seconds: each is looked at."""
TRUST = 0.1
"""What is expected of all jobs counts as much as having seen this share of them: the first job that ends,
seconds of which are its process's start, does not say how long all others will take."""
OVERDUE = 0.1
"""A job that takes longer than expected is expected to take this share of its time so far, besides."""


class Tally:
    """Of jobs by name.

    costs: seconds that each is expected to take, or in any unit. preparing: those that make what cells share;
    all others are cells, which alone are counted. workers: how many run at a time.
    """

    def __init__(self, costs: dict[str, float], preparing: Collection[str] = (), workers: int = 1) -> None:
        self.costs = costs
        self.workers = workers
        self.waiting = dict(costs)
        self.running: dict[str, float] = {}
        """When each job started, in seconds of `time.monotonic`."""
        self.cells = self.left = len(costs) - len(preparing)
        """How many cells there are, and how many have not ended."""
        self.failed = 0
        self._preparing = frozenset(preparing)
        self._left = self._all = sum(costs.values())
        """What is expected of those that wait, and of all."""
        self._spent = self._done = 0.0
        self._start = time.monotonic()
        self._eta, self._reckoned = math.nan, -math.inf

    def begin(self, name: str) -> None:
        self._left -= self.waiting.pop(name, 0.0)
        self.running[name] = time.monotonic()

    def end(self, name: str, status: str) -> float | None:
        """Seconds that the job took; None if it never ran."""
        self._left -= self.waiting.pop(name, 0.0)
        if name not in self._preparing:
            self.left -= 1
            self.failed += status == "failed"
        if name not in self.running:
            return None
        seconds = time.monotonic() - self.running.pop(name)
        if status != "failed":
            self._spent += seconds
            self._done += self.costs[name]
        return seconds

    @property
    def done(self) -> int:
        """Cells that have ended."""
        return self.cells - self.left

    @property
    def elapsed(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._start

    def eta(self) -> float:
        """Seconds that the rest may take, by what was expected and by the pace so far."""
        now = time.monotonic()
        if len(self.running) <= FEW or now - self._reckoned >= EVERY:
            self._eta, self._reckoned = self._reckon(now), now
        return self._eta

    def _reckon(self, now: float) -> float:
        trusted = TRUST * self._all
        pace = (self._spent + trusted) / (self._done + trusted) if self._all else 1.0
        rest = max(self._left * pace, 0.0)
        of_running = [
            max(self.costs[name] * pace - (now - start), OVERDUE * (now - start))
            for name, start in self.running.items()
        ]
        return max([(rest + sum(of_running)) / self.workers, *of_running])

    def line(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        told = f"{self.done} of {self.cells} cells done{failed}, {clock(self.elapsed)} passed"
        return f"{told}, ETA {clock(self.eta())}" if self.waiting or self.running else told


def clock(seconds: float) -> str:
    """`seconds` as m:ss or h:mm:ss."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
