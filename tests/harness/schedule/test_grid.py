"""The grid keeps what is a job's own, whatever its engine gives back."""

import dataclasses
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from harness.engines.inline import Inline
from harness.engines.jobs import Job, Outcome
from harness.records import LEARNED, Cell, CellResult, Row, policies_of
from harness.schedule.costs import Costs
from harness.schedule.grid import Grid
from harness.store.codec import encode
from harness.store.files import sha256_of
from harness.store.names import recording_of
from tests.harness.fake_runs import CONDITIONS, Found, compute

CELLS = [Cell("cartpole", method, seed) for seed in (0, 1) for method in ("bc", "shaped")]

pytestmark = pytest.mark.usefixtures("own_cache")


def result(cell: Cell) -> CellResult:
    rows = [Row(cell.env, cell.method, cell.seed, policy, "absorbing") for policy in policies_of(cell)]
    return CellResult(cell, rows, learned=sha256_of(b"x"), seconds={"fit": 0.0})


def good(job: Job) -> Outcome:
    return Outcome(encode(result(job.cells[0])), {LEARNED: b"x"}, b"said\n")


class Scripted(Inline):
    """Gives back what the script says for a cell, and notes what it was given."""

    def __init__(self, script: Callable[[Job], Outcome] = good, workers: int = 1) -> None:
        super().__init__()
        self.script, self.workers = script, workers
        self.given: list[Job] = []

    def submit(self, job: Job) -> None:
        self.given.append(job)
        shared = Outcome(files={"shared": f"{job.cells[0].seed}".encode()}, log=b"made\n")
        self._ended.append((job, shared if job.shared else self.script(job)))

    def run(self, tmp_path: Path, cells: Sequence[Cell] = CELLS) -> Found:
        found = Found(tmp_path)
        Grid(CONDITIONS, found, self).run(cells)
        return found


def test_cells_are_given_what_they_share_and_nothing_of_others(tmp_path: Path) -> None:
    engine = Scripted()
    found = engine.run(tmp_path)
    for job in engine.given:
        assert job.inputs == ({} if job.shared else {"shared": f"{job.cells[0].seed}".encode()})
    assert [job.cells for job in engine.given if job.shared] == [tuple(CELLS[:2]), tuple(CELLS[2:])]
    assert sorted(r.cell for r in found.results) == sorted(CELLS)
    assert found.files == {f"{cell.name} {LEARNED}": b"x" for cell in CELLS}
    assert (tmp_path / "run.log").read_text() == "made\nsaid\nsaid\n" * 2
    assert all(r.seconds.keys() == {"start", "fit"} and r.seconds["start"] >= 0 for r in found.results)


@pytest.mark.parametrize(
    ("methods", "error", "expected"),
    [
        (("control_clone", "shaped", "bc"), "", b"x"),
        (("control_clone", "shaped", "bc"), "no luck", None),
        (("control_clone",), "", None),  # where nothing is known of the other one
    ],
)
def test_what_goes_on_from_another_cell_waits_for_it_and_is_given_what_it_learned(
    tmp_path: Path, methods: tuple[str, ...], error: str, expected: bytes | None
) -> None:
    cells = [Cell("cartpole", method, 0) for method in methods]
    failing = Scripted(
        lambda job: Outcome(error=error) if error and job.cells[0].method == "bc" else good(job)
    )
    assert len(failing.run(tmp_path, cells).results) == len(cells)
    given = {job.cells[0].method: job.inputs.get(LEARNED) for job in failing.given if not job.shared}
    assert given == dict.fromkeys(methods) | {"control_clone": expected}
    order = list(given)
    assert "bc" not in order or order.index("bc") < order.index("control_clone")


def anothers(job: Job) -> Outcome:
    file = recording_of(CELLS[1], "pi_star", "median")
    recorded = dataclasses.replace(result(job.cells[0]), recordings={file: sha256_of(b"y")})
    return Outcome(encode(recorded), {LEARNED: b"x", f"recordings/{file}": b"y"})


@pytest.mark.parametrize(
    "wrong",
    [
        lambda job: dataclasses.replace(good(job), files={}),
        lambda job: dataclasses.replace(good(job), files={**good(job).files, "../run.sqlite": b"{}"}),
        anothers,
        lambda job: dataclasses.replace(good(job), result=encode(result(Cell("cartpole", "bc", 7)))),
    ],
)
def test_what_is_not_the_cells_is_a_failed_row(tmp_path: Path, wrong: Callable[[Job], Outcome]) -> None:
    found = Scripted(lambda job: wrong(job) if job.cells[0].method == "bc" else good(job)).run(tmp_path)
    status = {r.cell: {row.status for row in r.rows} for r in found.results}
    assert status == {cell: {"failed"} if cell.method == "bc" else {"ok"} for cell in CELLS}
    assert set(found.files) == {f"{cell.name} {LEARNED}" for cell in CELLS if cell.method == "shaped"}
    failed = next(r for r in found.results if r.cell.method == "bc")
    assert failed.rows[0].reason == "what came back is not the cell's"


def test_of_many_that_are_lost_together_the_culprit_is_found_by_halves(tmp_path: Path) -> None:
    cells = [Cell("cartpole", "shaped", seed) for seed in range(200)]
    tries, rounds = Counter[Cell](), []

    class Together(Scripted):
        """Loses all jobs that it does at a time, where one of them is the culprit."""

        def completed(self) -> list[tuple[Job, Outcome]]:
            ended = super().completed()
            mine = [job.cells[0] for job, _ in ended if not job.shared]
            rounds.append(mine)
            tries.update(mine)
            lost = Outcome(error="its node is gone", lost=True)
            return [(job, lost) for job, _ in ended] if cells[10] in mine else ended

    found = Together(workers=64).run(tmp_path, cells)
    assert sorted(result.cell for result in found.results) == cells
    assert [r.cell for r in found.results if r.rows[0].status == "failed"] == [cells[10]]
    assert len(rounds) < 40, "and not one for each of the 63 that were lost with it"
    assert tries[cells[10]] == 1 + 6  # with 64, 32, 16, 8, 4, 2 and alone
    assert tries.total() < 200 + 2 * 64 + 7


REASONS = {
    "raise": "ValueError: two lines; in faked (fake_cells.py:",
    "kill": "its process was killed by SIGKILL (out of memory?)",
    "vanish": "its process ended without a result, exit code 0",
    "exit": "SystemExit: gave up; in faked",
    "hungry": "out of memory: MemoryError: Unable to allocate 1.00 GiB",
    "nan": "FloatingPointError: pi_star: return_mean is nan; in ",
    "other": "ValueError: asked for cartpole__other__seed0, got 2 rows of cartpole__bc__seed99",
    "unstorable": "TypeError: complex is no JSON; in _as_builtin (codec.py:",
}


@pytest.fixture
def directory(tmp_path: Path, own_cache: None) -> Iterator[Path]:
    (tmp_path / "run").mkdir()
    yield tmp_path / "run"
    assert multiprocessing.active_children() == []


def run(directory: Path, cells: list[Cell], workers: int = 1) -> dict[Cell, CellResult]:
    results = compute(directory, cells, workers).results
    assert len({result.cell for result in results}) == len(results)
    return {result.cell: result for result in results}


def test_every_way_to_fail_is_told_and_takes_no_other_cell_with_it(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("good", *REASONS, "fine")]
    results = run(directory, cells, workers=2)
    assert set(results) == set(cells)
    for cell, result in results.items():
        expected = REASONS.get(cell.method)
        assert [row.policy for row in result.rows] == ["pi_star", "pi_R"]
        for row in result.rows:
            assert row.status == ("failed" if expected else "ok")
            assert row.reason.startswith(expected or "")
            assert "\n" not in row.reason
    log = (directory / "run.log").read_text()
    assert "a cell speaks; pytest here: False" in log
    assert "Traceback" in log
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 * (len(cells) + 1)
    assert "; 0 cells left" in lines[-1]


def test_the_number_of_workers_changes_no_result(directory: Path) -> None:
    cells = [Cell("cartpole", "good", seed) for seed in range(3)]
    one, three = run(directory, cells, workers=1), run(directory, cells, workers=3)
    for cell, result in one.items():
        assert encode(result) == encode(dataclasses.replace(three[cell], seconds=result.seconds))


def test_experts_come_first_and_then_what_takes_longest(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [Cell("cartpole", method, 0) for method in ("brief", "good", "slow")]
    for expected in (["brief", "good", "slow"], ["slow", "brief", "good"]):  # unmeasured, then measured
        run(directory, cells)
        lines = capsys.readouterr().out.splitlines()
        assert [line.split("__")[1] for line in lines if line.startswith("start")] == ["expert", *expected]
    guess = Costs(dataclasses.replace(CONDITIONS, budget="full")).of  # of which nothing was measured
    short, other, long = (
        Job((Cell(env, method, 0),), False, CONDITIONS, "")
        for env, method in (("cartpole", "bc"), ("cartpole", "maxent"), ("highway", "bc"))
    )
    assert guess(short) == guess(other) < guess(long)


def test_cells_share_a_process_until_one_fails_or_it_has_done_its_share(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def processes(*methods: str) -> list[str]:
        (directory / "computed.txt").unlink(missing_ok=True)
        run(directory, [Cell("cartpole", method, seed) for seed, method in enumerate(methods)])
        return (directory / "computed.txt").read_text().split()[1::2]

    assert len(set(processes("good", "good", "good"))) == 1
    for fault in ("raise", "kill"):
        assert len(set(processes(fault, "good"))) == 2
    monkeypatch.setattr("harness.engines.processes.MOST_JOBS", 1)
    assert len(set(processes("good", "good", "good"))) == 3
