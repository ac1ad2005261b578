"""Curves of running cells for TensorBoard and Weights & Biases, read by the owners of the formats."""

import time
from pathlib import Path
from typing import Any

import pytest

import irl_bench
from harness.cell.phases import Phase
from harness.records import Cell, CellResult
from harness.registry import LOGS, BadInput
from harness.rl.solving import OWN, TRUE
from harness.schedule import logs
from harness.schedule.logs import Logged
from tests.harness.fake_runs import Found
from tests.harness.made_results import make_row

ASKED = irl_bench.RunRequest(methods=["gail", "bc"], envs=["swingup"], budget="smoke", record="none")
CELL = Cell("swingup", "bc", 0)


def events(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Return the points of each curve in a folder of TensorBoard."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(folder))
    found.Reload()
    return {tag: [(p.step, p.value) for p in found.Scalars(tag)] for tag in found.Tags()["scalars"]}


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, irl_bench.Results]:
    folder = tmp_path_factory.mktemp("logged")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRL_BENCH_CACHE", str(folder / "cache"))
        return folder / "run", irl_bench.run(ASKED, irl_bench.Engine("inline", logs=LOGS), folder / "run")


def test_tensorboard_has_the_points_of_a_fit_and_of_rl(logged: tuple[Path, irl_bench.Results]) -> None:
    found = events(logged[0] / "tensorboard" / "swingup__gail__seed0")
    for name in ("loss", "accuracy", "entropy"):
        assert f"curves/discriminator's {name}" not in found
        assert len(found[f"fit/discriminator's {name}"]) == 1
    assert 0 <= found["fit/discriminator's accuracy"][0][1] <= 1
    assert 0 <= found["fit/discriminator's entropy"][0][1] <= 0.694
    steps = [step for step, _ in found["retrain/mean pay of a step"]]
    assert steps == sorted(steps)
    curves = logged[1].curves.query("method == 'gail'").groupby("curve")
    for name, curve in ((OWN, "pi_R"), (TRUE, "pi_R_true")):
        stored = curves.get_group(curve)
        live = found[f"retrain/{name}"]
        assert [step for step, _ in live] == stored["x"].tolist()
        assert [value for _, value in live] == pytest.approx(stored["y"].tolist(), rel=1e-5)
        assert f"fit/{name}" not in found, "methods' own agents do not see the true return"
    scores = logged[1].scores
    of_gail = scores[(scores["method"] == "gail") & (scores["policy"] == "pi_R")]
    assert found["return/pi_R"][0][1] == pytest.approx(float(of_gail["return_mean"].iloc[0]), rel=1e-5)
    losses = events(logged[0] / "tensorboard" / "swingup__bc__seed0")["curves/loss"]
    assert len(losses) > 10
    assert losses[-1][1] < losses[0][1]


def test_wandb_writes_an_offline_run_for_each_cell(logged: tuple[Path, irl_bench.Results]) -> None:
    cells = logged[1].scores[["method", "seed"]].drop_duplicates()
    runs = list((logged[0] / "wandb").glob("offline-run-*/run-*.wandb"))
    assert len(runs) == len(cells)
    assert all(run.stat().st_size > 0 for run in runs)


def test_points_can_be_seen_before_the_cell_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "FLUSH", 0)
    sink = Logged(Found(tmp_path), tmp_path, ["tensorboard"])
    for step in (10, 20):
        sink.heard(CELL.name, Phase("fit", step, values={"loss": 1 / step}))
    sink.heard(CELL.name, Phase("score"))
    ends = time.monotonic() + 30  # the library writes in a thread of its own
    while not (seen := events(tmp_path / "tensorboard" / CELL.name)) and time.monotonic() < ends:
        time.sleep(0.05)
    assert seen["fit/loss"][0] == (10, pytest.approx(0.1))
    sink.save(CellResult(CELL, [make_row("swingup", "bc", 0, "pi_star", return_mean=3.0)]), {})
    assert events(tmp_path / "tensorboard" / CELL.name)["return/pi_star"] == [(0, 3.0)]
    again = Logged(Found(tmp_path), tmp_path, ["tensorboard"])
    again.heard(CELL.name, Phase("fit", 5, values={"loss": 2.0}))
    again.save(CellResult(CELL, []), {})
    assert events(tmp_path / "tensorboard" / CELL.name) == {"fit/loss": [(5, 2.0)]}


def test_a_log_that_fails_fails_no_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: Any) -> Any:
        raise OSError("no space left")

    monkeypatch.setitem(logs.WRITERS, "tensorboard", broken)
    sink = Logged(found := Found(tmp_path), tmp_path, ["tensorboard"])
    sink.heard(CELL.name, Phase("fit", 1, values={"loss": 1.0, "accuracy": 1.0}))
    sink.save(result := CellResult(CELL, [], {"loss": [(1.0, 2.0)]}), {})
    assert found.results == [result]
    assert capsys.readouterr().err == "curves are logged no more: OSError: no space left\n"


def test_logs_that_cannot_be_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match="leave out --engine ray"):
        irl_bench.Engine("ray", logs=["wandb"])
    with pytest.raises(BadInput, match="logs are tensorboard and wandb, not 'mlflow'"):
        irl_bench.Engine(logs=["mlflow"])
    monkeypatch.setitem(logs.MODULES, "wandb", "nothing_of_that_name")
    with pytest.raises(BadInput, match=r"pip install 'irl-bench\[wandb\]'"):
        Logged(Found(tmp_path), tmp_path, ["wandb"])
    assert logs.WRITERS.keys() == logs.MODULES.keys() == {*LOGS}
