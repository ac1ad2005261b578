"""A plan of a run: its schedule on an engine in simulated time, before any cell is computed."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Self

import psutil

from harness.cell.phases import Phase
from harness.cell.sharing import before, takes_one_solve
from harness.engines.jobs import Job, Outcome
from harness.process.environment import cache_folder
from harness.records import REFERENCE, Cell, CellResult, Conditions, Status
from harness.schedule.costs import FILE, SHARED, Costs, name_of
from harness.schedule.grid import Grid, Schedule
from harness.schedule.interactions import Interactions, by_env
from harness.schedule.progress import NOTHING
from harness.schedule.tally import clock

CORES = (2, 64, 1000)
LARGEST_PROCESS, FIRST_PROCESS, ANOTHER_PROCESS = 980, 1063, 505
"""MB, measured: a cell of `shaped` at full, a whole run with one worker at smoke, and a second worker."""


class Simulated:
    """An engine in simulated time.

    `does`: a function from a job to its seconds and its outcome. `now`: seconds since the beginning.
    """

    def __init__(
        self,
        workers: int,
        does: Callable[[Job], tuple[float, Outcome]],
        variables: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.workers, self.variables = workers, variables
        self.now = 0.0
        self._does = does
        self._started = 0
        self._running: list[tuple[float, int, Job, Outcome]] = []

    def submit(self, job: Job) -> None:
        seconds, outcome = self._does(job)
        self._started += 1
        heapq.heappush(self._running, (self.now + seconds, self._started, job, outcome))

    def completed(self) -> list[tuple[Job, Outcome]]:
        if not self._running:
            return []
        self.now, _, job, outcome = heapq.heappop(self._running)
        return [(job, outcome)]

    def doing(self, name: str) -> Phase:
        return Phase()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...


class Silent:
    """A display that shows nothing, and a sink that stores nothing."""

    def started(self, job: Job) -> None: ...

    def finished(
        self, job: Job, status: Status, reason: str = "", returns: Mapping[str, float] = NOTHING
    ) -> None: ...

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None: ...

    def log(self, printed: bytes) -> None: ...

    def handed_on(self, cell: Cell) -> Mapping[str, bytes]:
        return {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...


@dataclass(frozen=True)
class Line:
    """Jobs that differ by their seed only, with their number and the seconds of each."""

    name: str
    jobs: int
    seconds: float
    measured: bool


@dataclass(frozen=True)
class Plan:
    """The seconds of cells, by task and method.

    `wall`: the wall time by the number of cores.
    `chain`: the longest chain of jobs that wait for each other, which no number of cores shortens.
    `solves`: numbers of RL solves of a learned reward, which take `retraining` seconds.
    `interactions`: those of all cells, by environment.
    """

    lines: tuple[Line, ...]
    wall: dict[int, float]
    chain: tuple[tuple[str, float], ...]
    solves: tuple[int, ...]
    retraining: float
    interactions: dict[str, Interactions]


def plan(
    cells: Sequence[Cell], conditions: Conditions, variables: Mapping[str, str], cores: Sequence[int] = CORES
) -> Plan:
    """Return the plan of these cells. `variables`: those of the engine that would compute them."""
    costs, silent = Costs(conditions), Silent()
    jobs = Grid(conditions, silent, Simulated(1, lambda job: (0.0, Outcome()), variables)).jobs(cells, costs)
    counts = Counter(map(name_of, jobs))
    first = {name_of(job): job for job in jobs}
    seconds = {name: costs.of(job) for name, job in first.items()}
    lines = [Line(name, counts[name], seconds[name], costs.known(first[name])) for name in sorted(first)]
    learned = [job for job in jobs if not (job.shared or takes_one_solve(job.cells[0]))]
    solves = {costs.solves(job) for job in learned if conditions.retrain}

    def does(job: Job) -> tuple[float, Outcome]:
        # A failed cell releases the same cells as any other, and has no result to be read.
        return seconds[name_of(job)], Outcome() if job.shared else Outcome(error="only planned")

    wall = {}
    for count in cores:
        engine = Simulated(count, does, variables)
        Schedule(Grid(conditions, silent, engine), jobs, silent, costs).run()
        wall[count] = engine.now
    chain = _longest_chain(jobs, {job.name: seconds[name_of(job)] for job in jobs})
    retraining = sum(map(costs.retraining, learned))
    return Plan(tuple(lines), wall, chain, tuple(sorted(solves)), retraining, by_env(cells, conditions))


def _longest_chain(jobs: Sequence[Job], seconds: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Return the jobs, with their seconds, that take longest one after the other."""
    shared = {job.group: job.name for job in jobs if job.shared}

    def chain(cell: Cell) -> list[str]:
        source = before(cell)
        start = chain(source) if source and source.name in seconds else [shared[cell.env, cell.seed]]
        return [*start, cell.name]

    chains = [chain(job.cells[0]) for job in jobs if not job.shared]
    longest = max(chains, key=lambda names: sum(seconds[name] for name in names), default=[])
    return tuple((name, seconds[name]) for name in longest)


def as_lines(plan: Plan) -> list[str]:
    """Return the plan as text, a line each."""
    if not plan.lines:
        return []
    width = max(len(line.name) for line in plan.lines)
    total = sum(line.jobs * line.seconds for line in plan.lines)
    guessed = sum(line.jobs * line.seconds for line in plan.lines if not line.measured)
    solves = " or ".join(map(str, plan.solves))
    marks = ["" if line.measured else "  a guess" for line in plan.lines]
    chain = ", ".join(f"{name} {clock(seconds)}" for name, seconds in plan.chain)
    memory = psutil.virtual_memory()
    return [
        f"{'job':{width}}    jobs  seconds each",
        *(
            f"{line.name:{width}}  {line.jobs:6,}  {line.seconds:12,.1f}{mark}"
            for line, mark in zip(plan.lines, marks, strict=True)
        ),
        f"'{SHARED}' makes what the cells of a seed share; '{REFERENCE}' scores expert and random policy",
        f"measured: what it took last on this machine ({cache_folder() / FILE}); a guess: the median of the "
        "task's cells here, what another machine took, or by its steps of RL",
        f"work: {clock(total)} of one core, {guessed / total:.0%} of it guessed",
        *[f"{solves} solves of a learned reward (--solves) take {clock(plan.retraining)}"] * bool(solves),
        *(f"interactions of {env}: {its}" for env, its in plan.interactions.items()),
        f"interactions in all: {sum(plan.interactions.values(), Interactions())}",
        "fits count by their methods' settings: their rollouts and checks come on top, and a fit that ends "
        "early takes less; experts and scores are not counted",
        *(f"wall time with {count:,} cores: {clock(took)}" for count, took in plan.wall.items()),
        f"no number of cores takes less than {clock(sum(s for _, s in plan.chain))}: {chain}",
        f"memory of a process: {LARGEST_PROCESS} MB at most where that was measured, cells of shaped at full "
        f"(docs/costs.md); most of it libraries that processes share: at smoke one worker took "
        f"{FIRST_PROCESS:,} MB in all, a second one {ANOTHER_PROCESS} more",
        f"its limit: what the machine has left as it begins, now {memory.available >> 20:,} of "
        f"{memory.total >> 20:,} MB",
    ]
