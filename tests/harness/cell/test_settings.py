"""The settings of a cell, as its result, scores.csv and `irl-bench list` have them."""

import json
from dataclasses import fields, replace

import pytest

from harness.cell.settings import settings_of
from harness.cli.main import main
from harness.judge.leaderboard import scored_rows
from harness.records import CONTROLS, REFERENCE, Conditions
from harness.registry import METHODS, SPECS, load_method
from harness.store.codec import decode, encode
from methods.settings import settings_for
from tests.harness.small_runs import result

QUICK = Conditions("quick", "absorbing", "sbx")


@pytest.mark.parametrize("method", METHODS)
def test_a_result_has_every_setting_that_its_cell_has(method: str) -> None:
    settings = settings_of(method, "hopper", QUICK)
    its = load_method(method)(**settings_for(method, "hopper", "quick"))
    assert settings["method"].keys() == {field.name for field in fields(its)}  # type: ignore[arg-type]
    assert settings["budget"]["rl_steps"] == SPECS["hopper"].rl_steps["quick"]
    assert {"name": "PPO", "epochs": 10}.items() <= settings["learner"].items()
    there = replace(result(), settings=settings)
    (row,) = scored_rows([decode(encode(there))])
    assert json.loads(row.settings) == json.loads(json.dumps(settings))
    assert "\n" not in row.settings


def test_conditions_and_controls_count() -> None:
    asked = replace(QUICK, learner="ddpg", solves=3)
    settings = settings_of("control_clone", "hopper", asked)
    assert settings["method"] == settings_of("bc", "hopper", QUICK)["method"]
    assert (settings["learner"]["name"], settings["budget"]["solves"]) == ("DDPG", 3)
    assert settings_of("bc", "gridworld", QUICK)["learner"] == {"name": "exact"}
    for method in (REFERENCE, CONTROLS[0]):
        assert "method" not in settings_of(method, "hopper", QUICK)


def test_list_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "gail", "--env", "hopper", "--budget", "smoke"]) == 0
    said = capsys.readouterr().out
    assert all(part in said for part in ("method:\n", "learner:\n", "budget:\n", "  iterations    1\n"))
    for words, why in (
        (["gail"], "irl-bench list METHOD --env ENV"),
        (["--env", "hopper"], "irl-bench list METHOD --env ENV"),
        (["gail,bc", "--env", "hopper"], "one method is needed"),
        (["gial", "--env", "hopper"], "did you mean 'gail'"),
    ):
        assert main(["list", *words]) == 2
        err = capsys.readouterr().err
        assert why in err
        assert err.count("\n") == 1
