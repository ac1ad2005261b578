"""Live progress of a run: a display on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from itertools import islice
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Protocol, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.text import Text

from harness.cell.phases import Phase, returned
from harness.schedule.tally import Tally, clock
from harness.store.codec import printable

if TYPE_CHECKING:
    from harness.engines.jobs import Job
    from harness.records import Status

NO_NUMBERS = "It tells people how far a run is."

NOTHING: Mapping[str, float] = MappingProxyType({})
PREPARING = "expert and demonstrations"
"""Name of the phase in which a job makes what cells share."""


class Progress(Protocol):
    """Progress of a run, as a context manager. `returns`: the mean true return of each policy of a cell."""

    def started(self, job: Job) -> None: ...

    def finished(
        self, job: Job, status: Status, reason: str = "", returns: Mapping[str, float] = NOTHING
    ) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def progress_for(tally: Tally, doing: Callable[[str], Phase]) -> Progress:
    """Return the kind of progress that standard output can show.

    `doing`: a function from the name of a running job to its phase.
    """
    if sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM") != "dumb":
        return Display(tally, doing, Console(highlight=False))
    return Lines(tally)


def say(text: str) -> None:
    """Print lines on standard output, at once, and nothing that moves the cursor."""
    print(*map(printable, text.split("\n")), sep="\n", flush=True)


def tell(text: str) -> None:
    """Print lines on standard error: what must not be overlooked."""
    print(*map(printable, text.split("\n")), sep="\n", file=sys.stderr, flush=True)


class Lines:
    """One line when a job starts and one when it ends."""

    def __init__(self, tally: Tally) -> None:
        self.tally = tally

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def started(self, job: Job) -> None:
        self.tally.begin(job.name)
        say(f"start   {job.name}")

    def finished(
        self, job: Job, status: Status, reason: str = "", returns: Mapping[str, float] = NOTHING
    ) -> None:
        seconds = self.tally.end(job.name, status)
        took = "not run" if seconds is None else f"{seconds:.1f} s"
        more = f": {reason or returned(returns)}" if reason or returns else ""
        left = f"{self.tally.left} cell{'s' * (self.tally.left != 1)} left"
        say(f"{status:7} {job.name} ({took}; {left}, ETA {clock(self.tally.eta())}){more}")


class Display:
    """Running jobs and the state of the whole run, redrawn in place. Failures stay above.

    `console`: of the terminal, made while the environment says what that can show.
    """

    def __init__(self, tally: Tally, doing: Callable[[str], Phase], console: Console) -> None:
        self.tally, self.doing, self.console = tally, doing, console
        self._preparing: set[str] = set()
        self._last = ""
        self.live = Live(get_renderable=self._render, console=console, refresh_per_second=2, transient=True)

    def __enter__(self) -> Self:
        self.live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.live.stop()
        self.console.print(Text(self.tally.line()))

    def started(self, job: Job) -> None:
        if job.shared:
            self._preparing.add(job.name)
        self.tally.begin(job.name)

    def finished(
        self, job: Job, status: Status, reason: str = "", returns: Mapping[str, float] = NOTHING
    ) -> None:
        self.tally.end(job.name, status)
        if returns:
            self._last = f"{job.name}: {returned(returns)}"
        if reason:
            self.console.print(Text(printable(f"{status:7} {job.name}: {reason}")))

    def _render(self) -> RenderableType:
        width, height = self.console.size
        now, tasks = time.monotonic(), self.tally.running.copy()
        most = max(1, height - 5)  # Below are how many more there are, the bar, two lines, the cursor.
        lines = [self._line(name, now - start, width) for name, start in islice(tasks.items(), most)]
        lines += [f"  and {len(tasks) - most} more"] if len(tasks) > most else []
        # Of itself a bar ends without a new line.
        bar = Padding(ProgressBar(total=max(1, self.tally.cells), completed=self.tally.done), 0)
        below = [self.tally.line(), *([f"latest: {self._last}"] if self._last else [])]
        return Group(*map(_one_line, lines), bar, *map(_one_line, below))

    def _line(self, name: str, seconds: float, width: int) -> str:
        """Return the line of a job. A long name loses its middle, because both ends identify it."""
        phase = PREPARING if name in self._preparing else printable(str(self.doing(name)))
        doing = f"  {clock(seconds)}  {phase}"
        room = max(20, width - 2 - len(doing))
        if len(name) > room:
            name = f"{name[: room // 2 - 1]}…{name[len(name) - (room - room // 2) :]}"
        return f"  {name}{doing}".rstrip()


def _one_line(text: str) -> Text:
    return Text(text, no_wrap=True, overflow="ellipsis")
