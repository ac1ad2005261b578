"""A search of hyper-parameters: equal trials, tuning seeds alone, and the same trials after any stop."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from harness.api import tuning
from harness.api.preparing import Prepared
from harness.api.request import RunRequest
from harness.cli.main import main
from harness.records import CONTROLS, Cell, CellResult
from harness.registry import KNOWN, BadInput, plugins
from harness.registry.configured import settings_in
from harness.registry.names import SAMPLERS, Sampler
from tests.harness.made_results import make_row

pytestmark = pytest.mark.usefixtures("_for_now")
optuna = pytest.importorskip("optuna")
NullPool = pytest.importorskip("sqlalchemy.pool").NullPool
ASKED = RunRequest(methods=["gail", "csil"], envs=["swingup"], seeds=[100, 101], budget="smoke")
BEST = 2e-3


@pytest.fixture
def _for_now() -> Any:
    with KNOWN.for_now():
        yield


class Fakes:
    """Cells whose score falls with the distance of their learning rate from the best one."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, ...]] = []
        self.fails_at = math.inf

    def __call__(self, prepared: Prepared, watch: object) -> Mapping[Cell, CellResult]:
        if len(self.asked) >= self.fails_at:
            raise KeyboardInterrupt
        self.asked.append(prepared.request.methods)
        assert not {cell.method for cell in prepared.request.cells} & {*CONTROLS}
        results = dict[Cell, CellResult]()
        for cell in prepared.request.cells:
            returns = {"expert": 1.0, "random": 0.0} if cell.method == "reference" else {}
            if cell.method in prepared.request.methods:
                rate = float(settings_in(cell.method).get("learning_rate", 1.0))  # type: ignore[arg-type]
                star = 1 - abs(math.log10(rate / BEST))
                returns = {"pi_star": star, "pi_R": star - 0.1 * (cell.seed - 100)}
            rows = [
                make_row(cell.env, cell.method, cell.seed, name, return_mean=value)
                for name, value in returns.items()
            ]
            if settings_in(cell.method).get("layers") == (256, 256):
                rows = [make_row(cell.env, cell.method, cell.seed, "pi_star", status="failed", reason="x")]
            results[cell] = CellResult(cell, rows)
        return results


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Fakes:
    faked = Fakes()
    monkeypatch.setattr(tuning, "cells", faked)
    return faked


def names(found: Mapping[str, Sequence[tuning.Trial]]) -> dict[str, list[str]]:
    return {method: [one.name for one in trials] for method, trials in found.items()}


def test_each_method_gets_the_same_number_of_trials_and_itself_as_it_is(fakes: Fakes, tmp_path: Path) -> None:
    found = tuning.tune(ASKED, 7, tmp_path / "a.db")
    assert [one.number for one in found["gail"]] == [one.number for one in found["csil"]] == [-1, *range(7)]
    assert found["gail"][0].name == "gail"
    for method, trials in found.items():
        space = plugins.searched(method)
        for one in trials[1:]:
            values = settings_in(one.name)
            assert values.keys() == space.keys()
            assert 1e-4 <= values["learning_rate"] <= 0.1  # type: ignore[operator]
            if not math.isnan(one.score):
                star = 1 - abs(math.log10(values["learning_rate"] / BEST))  # type: ignore[operator]
                assert np.allclose([one.pi_star, one.pi_R, one.score], [star, star - 0.05, star - 0.025])
    table = pd.read_csv(tmp_path / "a.db.csv")
    assert list(table["trial"]) == [-1, *range(7)] * 2
    assert {"method", "trial", "name", "score", "pi_star", "pi_R", "seconds"} == set(table.columns)
    kept = optuna.storages.RDBStorage(f"sqlite:///{tmp_path}/a.db", engine_kwargs={"poolclass": NullPool})
    study = optuna.load_study(study_name="gail", storage=kept)
    assert len(study.trials) == 7
    assert study.best_value == max(one.score for one in found["gail"][1:] if not math.isnan(one.score))


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_search_that_is_stopped_goes_on_to_the_same_trials(
    fakes: Fakes, tmp_path: Path, sampler: Sampler
) -> None:
    whole = tuning.tune(ASKED, 22, tmp_path / "whole.db", sampler)
    fakes.fails_at = len(fakes.asked) + 2
    with pytest.raises(KeyboardInterrupt):
        tuning.tune(ASKED, 22, tmp_path / "parts.db", sampler)
    fakes.fails_at = math.inf
    tuning.tune(ASKED, 13, tmp_path / "parts.db", sampler)
    assert names(tuning.tune(ASKED, 22, tmp_path / "parts.db", sampler)) == names(whole)
    assert names(tuning.tune(ASKED, 22, tmp_path / "parts.db", sampler)) == names(whole)
    rates = {float(settings_in(one.name)["learning_rate"]) for one in whole["gail"][1:]}  # type: ignore[arg-type]
    assert len(rates) > 15


def test_methods_do_not_change_each_others_trials(fakes: Fakes, tmp_path: Path) -> None:
    both = tuning.tune(ASKED, 12, tmp_path / "both.db")
    alone = tuning.tune(RunRequest(**(vars(ASKED) | {"methods": ["csil"]})), 12, tmp_path / "alone.db")
    assert names(alone)["csil"] == names(both)["csil"]


def test_tpe_learns_from_earlier_trials(fakes: Fakes, tmp_path: Path) -> None:
    found = tuning.tune(RunRequest(**(vars(ASKED) | {"methods": ["csil"]})), 40, tmp_path / "a.db")
    errors = [
        abs(math.log10(float(settings_in(one.name)["learning_rate"]) / BEST))  # type: ignore[arg-type]
        for one in found["csil"][1:]
    ]
    assert np.mean(errors[20:]) < 0.8 * np.mean(errors[:10])


def test_the_best_is_told_as_options_that_make_the_same_row(fakes: Fakes, tmp_path: Path) -> None:
    found = tuning.tune(ASKED, 5, tmp_path / "a.db")
    for method, line in zip(found, tuning.best_of(found), strict=True):
        best = max(found[method][1:], key=lambda one: -1 if math.isnan(one.score) else one.score)
        start, _, options = line.partition(": --set ")
        assert start.startswith(f"{method}: best of 5 trials {best.score:.3f}, as it is ")
        values = [word for word in f"--set {options}".split() if word != "--set"]
        settings = {field: value for field, _, value in (one.partition("=") for one in values)}
        assert settings.keys() == {f"{method}.{field}" for field in settings_in(best.name)}
        words = [word for value in values for word in ("--set", value)]
        from harness.api.request import resolve
        from harness.cli.arguments import parser
        from harness.cli.runs import request_of

        args = parser().parse_args(["run", "--methods", method, "--envs", "swingup", *words])
        assert resolve(request_of(args), False)[0].methods == (best.name,)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"seeds": [100, 7]}, "seed 7 is no tuning seed"),
        ({"seeds": 2}, "seed 0 is no tuning seed"),
        ({"seeds": [200]}, "seed 200 is no tuning seed"),
        ({"methods": ["sqil"]}, "sqil has no settings that are searched"),
        ({"methods": ["gail(mean=True)"]}, r"gail\+mean-True has no settings that are searched"),
        ({"budget": "quick"}, "holds a search of gail with other budget"),
        ({"envs": ["cartpole"]}, "holds a search of gail with other envs"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    fakes: Fakes, tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    tuning.tune(ASKED, 1, tmp_path / "a.db")
    with pytest.raises(BadInput, match=why):
        tuning.tune(RunRequest(**(vars(ASKED) | changes)), 1, tmp_path / "a.db")


def test_a_file_of_another_kind_is_refused(
    fakes: Fakes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.db").write_text("some notes, which are longer than a header of sqlite " * 20)
    words = ["--methods", "gail", "--envs", "swingup", "--trials", "1", "--storage", str(tmp_path / "a.db")]
    assert main(["tune", *words]) == 2
    error = capsys.readouterr().err
    assert "holds no search" in error
    assert error.count("\n") == 1
    assert (tmp_path / "a.db").read_text().startswith("some notes")


@pytest.mark.usefixtures("own_cache")
def test_real_trials_are_cells_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--methods", "bc", "--envs", "swingup", "--trials", "2", "--storage", str(tmp_path / "a.db")]
    words += ["--seeds", "100-100", "--budget", "smoke", "--no-retrain", "--engine", "inline"]
    assert main(["tune", *words]) == 0
    assert "bc: best of 2 trials" in capsys.readouterr().out
    assert main(["report", str(tmp_path / "a.db.cells")]) == 0
    scores = pd.read_csv(tmp_path / "a.db.cells" / "scores.csv")
    table = pd.read_csv(tmp_path / "a.db.csv")
    of_run = scores[scores["policy"] == "pi_star"].set_index("method")["normalized_score"]
    assert np.allclose(of_run[list(table["name"])], table["score"])
