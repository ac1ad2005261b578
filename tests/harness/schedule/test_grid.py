"""The grid keeps what is a job's own, whatever its engine gives back."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from harness.engines.inline import Inline
from harness.engines.jobs import Job, Outcome
from harness.process.environment import CACHE_VARIABLE
from harness.records import LEARNED, Cell, CellResult, Conditions, Row, policies_of
from harness.schedule import grid
from harness.schedule.costs import Costs
from harness.schedule.grid import Grid, Schedule
from harness.schedule.plan import Silent, Simulated
from harness.store.codec import encode
from harness.store.files import sha256_of
from harness.store.names import recording_of
from tests.harness.fake_runs import Found

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
CELLS = [Cell("cartpole", method, seed) for seed in (0, 1) for method in ("bc", "shaped")]


def result(cell: Cell) -> CellResult:
    rows = [Row(cell.env, cell.method, cell.seed, policy, "absorbing") for policy in policies_of(cell)]
    return CellResult(cell, rows, learned=sha256_of(b"x"), seconds={"fit": 0.0})


def anothers(job: Job) -> Outcome:
    file = recording_of(CELLS[1], "pi_star", "median")
    recorded = dataclasses.replace(result(job.cells[0]), recordings={file: sha256_of(b"y")})
    return Outcome(encode(recorded), {LEARNED: b"x", f"recordings/{file}": b"y"})


class Scripted(Inline):
    """Gives back what the script says for a cell, and notes what it was given."""

    def __init__(self, script: Callable[[Job], Outcome]) -> None:
        super().__init__()
        self.script = script
        self.given: list[Job] = []

    def submit(self, job: Job) -> None:
        self.given.append(job)
        shared = Outcome(files={"shared": f"{job.cells[0].seed}".encode()}, log=b"made\n")
        self._ended.append((job, shared if job.shared else self.script(job)))


def run(
    tmp_path: Path, script: Callable[[Job], Outcome], cells: Sequence[Cell] = CELLS
) -> tuple[Scripted, Found]:
    engine, found = Scripted(script), Found(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
        Grid(CONDITIONS, found, engine).run(cells)
    return engine, found


def good(job: Job) -> Outcome:
    (cell,) = job.cells
    return Outcome(encode(result(cell)), {LEARNED: b"x"}, b"said\n")


def test_cells_are_given_what_they_share_and_nothing_of_others(tmp_path: Path) -> None:
    engine, found = run(tmp_path, good)
    for job in engine.given:
        inputs: Mapping[str, bytes] = {} if job.shared else {"shared": f"{job.cells[0].seed}".encode()}
        assert job.inputs == inputs
    assert [job.cells for job in engine.given if job.shared] == [tuple(CELLS[:2]), tuple(CELLS[2:])]
    assert sorted(r.cell for r in found.results) == sorted(CELLS)
    assert found.files == {f"{cell.name} {LEARNED}": b"x" for cell in CELLS}
    assert (tmp_path / "run.log").read_text() == "made\nsaid\nsaid\n" * 2
    for kept in found.results:
        assert set(kept.seconds) == {"start", "fit"}
        assert kept.seconds["start"] >= 0


def test_what_goes_on_from_another_cell_waits_for_it_and_is_given_what_it_learned(tmp_path: Path) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("control_clone", "shaped", "bc")]
    engine, _ = run(tmp_path, good, cells)
    order = [job.cells[0].method for job in engine.given if not job.shared]
    assert order.index("bc") < order.index("control_clone")
    given = {job.cells[0].method: job.inputs.get(LEARNED) for job in engine.given if not job.shared}
    assert given == {"bc": None, "shaped": None, "control_clone": b"x"}
    for name in ("alone", "failed"):
        (tmp_path / name).mkdir()
    alone, _ = run(tmp_path / "alone", good, cells[:1])  # where nothing is known of the other one
    assert LEARNED not in alone.given[-1].inputs
    failed, kept = run(
        tmp_path / "failed",
        lambda job: Outcome(error="no luck") if job.cells[0].method == "bc" else good(job),
        cells,
    )
    assert LEARNED not in failed.given[-1].inputs
    assert len(kept.results) == len(cells)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda job: dataclasses.replace(good(job), files={}),
        lambda job: dataclasses.replace(good(job), files={**good(job).files, "../run.sqlite": b"{}"}),
        anothers,
        lambda job: dataclasses.replace(good(job), files={"recordings/../../b.rrd": b"x"}),
        lambda job: dataclasses.replace(good(job), result=encode(result(Cell("cartpole", "bc", 7)))),
    ],
)
def test_what_is_not_the_cells_is_a_failed_row(tmp_path: Path, wrong: Callable[[Job], Outcome]) -> None:
    _, found = run(tmp_path, lambda job: wrong(job) if job.cells[0].method == "bc" else good(job))
    status = {r.cell: {row.status for row in r.rows} for r in found.results}
    assert status == {cell: {"failed"} if cell.method == "bc" else {"ok"} for cell in CELLS}
    assert set(found.files) == {f"{cell.name} {LEARNED}" for cell in CELLS if cell.method == "shaped"}
    failed = next(r for r in found.results if r.cell.method == "bc")
    assert failed.rows[0].reason == "what came back is not the cell's"


def test_a_job_that_is_lost_is_tried_once_more_alone(tmp_path: Path) -> None:
    tries: dict[Cell, int] = {}

    def script(job: Job) -> Outcome:
        (cell,) = job.cells
        tries[cell] = tries.get(cell, 0) + 1
        lost = Outcome(error="its server died", lost=True)
        return lost if cell == CELLS[0] or (cell == CELLS[1] and tries[cell] == 1) else good(job)

    _, found = run(tmp_path, script)
    assert tries == {CELLS[0]: 2, CELLS[1]: 2, CELLS[2]: 1, CELLS[3]: 1}
    failed = [r.cell for r in found.results if r.rows[0].status == "failed"]
    assert failed == [CELLS[0]]
    assert len(found.results) == len(CELLS)


class Together(Scripted):
    """Does so many jobs at a time, all of which are lost where one of them is the culprit."""

    def __init__(self, workers: int, culprit: Cell) -> None:
        super().__init__(good)
        self.workers, self.culprit = workers, culprit
        self.tries: Counter[Cell] = Counter()
        self.rounds = 0

    def completed(self) -> list[tuple[Job, Outcome]]:
        ended = super().completed()
        self.rounds += 1
        mine = [job.cells[0] for job, _ in ended if not job.shared]
        self.tries.update(mine)
        lost = Outcome(error="its node is gone", lost=True)
        return [(job, lost) for job, _ in ended] if self.culprit in mine else ended


def test_of_many_that_are_lost_together_the_culprit_is_found_by_halves(tmp_path: Path) -> None:
    cells = [Cell("cartpole", "shaped", seed) for seed in range(200)]
    engine, found = Together(64, cells[10]), Found(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
        Grid(CONDITIONS, found, engine).run(cells)
    assert sorted(result.cell for result in found.results) == cells
    assert [r.cell for r in found.results if r.rows[0].status == "failed"] == [cells[10]]
    assert engine.rounds < 40, "and not one for each of the 63 that were lost with it"
    assert engine.tries[cells[10]] == 1 + 6  # with 64, 32, 16, 8, 4, 2 and alone
    assert engine.tries.total() < 200 + 2 * 64 + 7


@pytest.mark.parametrize("size", [1, 3000])
def test_what_cells_share_is_made_for_as_many_groups_as_there_is_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    """Where that is next to nothing, as large as thought, or more than there is room for."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(grid, "MOST_SHARED", 1000)
    monkeypatch.setattr(grid, "USUAL_SHARED", 100)
    cells = [Cell("cartpole", method, seed) for seed in range(60) for method in ("bc", "shaped")]
    held, started = [], Counter[bool]()

    def does(job: Job) -> tuple[float, Outcome]:
        started[job.shared] += 1
        held.append(schedule.bytes + 100 * schedule.preparing)
        return 1.0, Outcome(files={"x": b"x" * size}) if job.shared else Outcome(error="no matter")

    silent, costs = Silent(), Costs(CONDITIONS)
    its = Grid(CONDITIONS, silent, Simulated(500, does))
    schedule = Schedule(its, its.jobs(cells, costs), silent, costs)
    schedule.run()
    assert started == {True: 60, False: 120}
    assert max(held) <= max(1000, 10 * size)
    assert (schedule.bytes, schedule.preparing) == (0, 0)
