"""A count of the jobs of a run: those done, those that run, and the expected time of the rest."""

from __future__ import annotations

import time
from collections.abc import Collection

NO_NUMBERS = "It counts what is done, for people."

TRUST = 0.1
"""Weight of the expected costs, as a share of all jobs. The first job includes the start of its process, so
its time alone would mislead."""
OVERDUE = 0.1
"""Share of its time so far that an overdue job is expected to take still."""


class Tally:
    """Progress of jobs, by name.

    `costs`: the expected seconds of each, or in any other unit.
    `preparing`: jobs that make what cells share. All others are cells, and only cells are counted.
    `workers`: jobs at a time.
    """

    def __init__(self, costs: dict[str, float], preparing: Collection[str] = (), workers: int = 1) -> None:
        self.costs = costs
        self.workers = workers
        self.waiting = dict(costs)
        self.running: dict[str, float] = {}
        """The start of each job, in seconds of `time.monotonic`."""
        self.cells = self.left = len(costs) - len(preparing)
        """Numbers of cells: all, and those that have not ended."""
        self.failed = 0
        self._preparing = frozenset(preparing)
        self._left = self._all = sum(costs.values())
        """Expected cost of the waiting jobs, and of all."""
        self._spent = self._done = 0.0
        self._start = time.monotonic()

    def begin(self, name: str) -> None:
        self._left -= self.waiting.pop(name, 0.0)
        self.running[name] = time.monotonic()

    def end(self, name: str, status: str) -> float | None:
        """Return the seconds that the job took; None if it never ran."""
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
        """The number of cells that have ended."""
        return self.cells - self.left

    @property
    def elapsed(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._start

    def eta(self) -> float:
        """Return the seconds that the rest may take, by what was expected and by the pace so far."""
        now, trusted = time.monotonic(), TRUST * self._all
        pace = (self._spent + trusted) / (self._done + trusted) if self._all else 1.0
        of_running = [
            max(self.costs[name] * pace - (now - start), OVERDUE * (now - start))
            for name, start in self.running.copy().items()
        ]
        return max([(max(self._left * pace, 0.0) + sum(of_running)) / self.workers, *of_running])

    def line(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        done = f"{self.done} of {self.cells} cells done{failed}, {clock(self.elapsed)} passed"
        return f"{done}, ETA {clock(self.eta())}" if self.waiting or self.running else done


def clock(seconds: float) -> str:
    """Return `seconds` as m:ss or h:mm:ss."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
