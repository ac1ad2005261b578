"""A run is shown beside cells of others where those can be compared, and nowhere else."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from harness.cli import runs
from harness.cli.main import main
from harness.process.environment import numeric
from harness.records import Cell, CellResult, Shown, policies_of
from harness.registry import KNOWN, BadInput, keys
from harness.store import baseline
from harness.store.opening import open_for_run
from harness.store.request import Request
from harness.store.store import Store
from tests.harness.made_results import REQUEST, make_results, make_row
from tests.harness.small_runs import damage, names, store, stored

MINE = dataclasses.replace(REQUEST, methods=("gail",), envs=("cartpole",))
VARIABLES = numeric(True)


def made(path: Path, results: list[CellResult] | None = None, request: Request = REQUEST) -> Path:
    """Return a run of these results."""
    with open_for_run(path, request) as run:
        for result in make_results() if results is None else results:
            run.save(result)
    return path


@pytest.fixture
def board(tmp_path: Path) -> Path:
    return made(tmp_path / "board/one").parent


def computed(seeds: tuple[int, ...], score: float = 470.0, method: str = "gail") -> list[CellResult]:
    cells = [Cell("cartpole", method, seed) for seed in seeds]
    policy = policies_of(cells[0])[0]
    return [CellResult(c, [make_row(c.env, method, c.seed, policy, return_mean=score)]) for c in cells]


def edited(board: Path, change: Callable[[dict], None], task: str = "") -> None:
    """Change what the board's cells hold, of one task or all, and their checksums."""
    for file in board.glob("*/run.sqlite"):
        for name in names(file.parent):
            if name.startswith(task):
                result = stored(file.parent, name)
                change(result)
                store(file.parent, result, name)


def of_another_task(result: dict) -> None:
    """As a key is where other packages are installed."""
    result["key"] = f"other:{keys.method_of(result['key'])}"


def of_another_method(result: dict) -> None:
    if result["cell"]["method"] == "bc":
        result["key"] = f"{keys.task_of(result['key'])}:other"


def test_what_can_be_compared_is_taken_and_the_rest_is_left_out_by_name(board: Path) -> None:
    found, _ = baseline.comparable([board], MINE, VARIABLES)
    fine = [r.cell for r in make_results(("cartpole",)) if all(row.status != "failed" for row in r.rows)]
    assert [result.cell for result in found] == sorted(fine)
    assert {row.source for result in found for row in result.rows} == {"baseline one"}
    shown = dataclasses.replace(MINE, shown=(Shown(5),))
    found, left_out = baseline.comparable([board], shown, VARIABLES)
    assert {"bc", "shaped"}.isdisjoint(result.cell.method for result in found)
    told = "methods in one were shown as many demonstrations as the budget says, and here 5 demonstrations"
    assert any(line.startswith(told) for line in left_out)
    edited(board, of_another_method)
    found, left_out = baseline.comparable([board], MINE, VARIABLES)
    assert "shaped" in {result.cell.method for result in found}
    assert "bc" not in {result.cell.method for result in found}
    assert "bc in one is of another version of the method" in left_out


def test_seeds_of_two_versions_of_a_method_are_not_mixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [made(tmp_path / f"{i}/{i}", computed(seeds), MINE) for i, seeds in enumerate([(0, 1), (1, 2)])]
    edited(tmp_path / "1", lambda result: result.update(key=result["key"] + "0"))
    # As of a plug-in, which nobody knows here.
    monkeypatch.setattr(KNOWN, "entries", {"method": {}, "env": KNOWN.entries["env"]})
    found, left_out = baseline.comparable(runs, MINE, VARIABLES)
    assert [result.cell.seed for result in found] == [0, 1]
    assert left_out == ["gail in 1 is of another version than in 0"]


def test_trained_experts_of_another_machine_are_no_experts_of_this_one(board: Path) -> None:
    trained = dataclasses.replace(MINE.conditions, experts="trained")
    made(board / "two", request=dataclasses.replace(REQUEST, conditions=trained))
    edited(board, of_another_task)
    with pytest.raises(BadInput, match="two is of another version of the task, its experts"):
        baseline.comparable([board / "two"], dataclasses.replace(MINE, conditions=trained), VARIABLES)
    assert baseline.comparable([board / "one"], MINE, VARIABLES)


def test_rows_of_another_machine_are_taken_and_marked(board: Path) -> None:
    edited(board, of_another_task)
    edited(board, lambda result: result["origin"].update(processor="another", torch="1.0", scipy="1.0"))
    fast = dataclasses.replace(MINE.conditions, deterministic=False)
    found, _ = baseline.comparable([board], dataclasses.replace(MINE, conditions=fast), VARIABLES)
    (source,) = {row.source for result in found for row in result.rows}
    others = "another machine and other packages (scipy, torch) and other instructions"
    assert source == f"baseline one, of {others}"


def test_no_run_other_conditions_and_damage_are_refused_by_name(board: Path, tmp_path: Path) -> None:
    def refused(why: str, folder: Path = board, envs: tuple[str, ...] = MINE.envs, **change: object) -> None:
        conditions = dataclasses.replace(MINE.conditions, **change)  # type: ignore[arg-type]
        with pytest.raises(BadInput, match=why):
            baseline.comparable([folder], Request(MINE.methods, envs, MINE.seeds, conditions), VARIABLES)

    (tmp_path / "empty").mkdir()
    refused("empty holds no run", tmp_path / "empty")
    refused("no swingup that can be compared: none", envs=("cartpole", "swingup"))
    refused("one has rl sbx, not sb3, experts shipped, not trained", rl="sb3", experts="trained")
    refused("one has solves by task and budget, not 3", solves=3)
    for name in names(board / "one"):
        damage(board / "one", name)
    refused(r"no cartpole that can be compared: .*/cartpole__\w+: its checksum")


class Computes:
    """A grid whose cells are there at once."""

    asked: list[Cell]

    def __init__(self, conditions: object, sink: Store, *more: object) -> None:
        self.sink = sink

    def run(self, cells: list[Cell]) -> None:
        Computes.asked = list(cells)
        for cell in cells:
            self.sink.save(*computed((cell.seed,), method=cell.method))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    monkeypatch.setattr("harness.schedule.grid.Grid", Computes)
    monkeypatch.setattr(runs, "handle_signals", lambda: None)
    monkeypatch.chdir(tmp_path)
    return lambda *words: main(["run", "--methods", "gail", "--envs", "cartpole", "--seeds", "3", *words])


def test_only_what_the_baseline_lacks_is_computed_and_all_is_shown(
    run: Callable[..., int], board: Path, tmp_path: Path
) -> None:
    assert run("--baseline", str(board), "--out", "run") == 0
    assert {cell.method for cell in Computes.asked} == {"gail", "control_shuffled", "control_clone"}
    scores = pd.read_csv(tmp_path / "run/scores.csv", keep_default_na=False)
    assert set(scores[scores.method == "gail"].source) == {""}
    assert set(scores[scores.method == "shaped"].source) == {"baseline one"}
    leaderboard = pd.read_csv(tmp_path / "run/leaderboard.csv")
    gail = leaderboard[(leaderboard.method == "gail") & (leaderboard.policy == "pi_star")]
    assert gail.score_mean.item() == pytest.approx((470 - 20) / 480)
    assert (leaderboard[leaderboard.method == "shaped"].note == "baseline one").all()
    made = (tmp_path / "run/leaderboard.md").read_text()
    assert "seeds 0 to 2 (of the baseline: seeds 0 to 2)" in made
    assert " --baseline DIR" in made
    assert main(["verify", "run"]) == 0
    before = (tmp_path / "run/leaderboard.csv").read_bytes()
    assert main(["report", "run"]) == 0  # which needs the baseline no more
    assert (tmp_path / "run/leaderboard.csv").read_bytes() == before
    for earlier, later in (("run", "second"), ("second", "third")):  # of a baseline's rows alone
        assert run("--baseline", earlier, "--out", later) == 0
        assert not Computes.asked
    damage(tmp_path / "run", "cartpole__shaped__seed0", "baseline")
    assert main(["verify", "run"]) == 1
    assert main(["report", "run"]) == 1


def test_a_refused_baseline_writes_nothing_and_one_of_another_version_by_now_is_not_mixed(
    run: Callable[..., int],
    board: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run("--baseline", str(board), "--budget", "full", "--out", "run") == 2
    assert "budget quick, not full" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert run("--baseline", str(board), "--out", "run") == 0
    monkeypatch.setattr(baseline, "task_version", lambda env: "newer")
    monkeypatch.setattr(baseline, "task_of", lambda key: key)
    assert run("--out", "run") == 2
