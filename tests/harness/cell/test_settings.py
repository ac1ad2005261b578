"""The settings of a cell, as its result, scores.csv and `irl-bench list` have them."""

import json
from dataclasses import fields, replace

import pytest

from harness.cell.settings import settings_of
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
