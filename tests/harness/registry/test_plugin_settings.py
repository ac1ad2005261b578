"""Settings of methods that derive from built-in ones, and warnings about their steps."""

import re
from pathlib import Path

import pytest

from harness.judge import effort
from harness.records import Cell, CellResult, Row
from harness.registry import KNOWN, load_method, plugins
from methods import settings
from methods.settings import settings_for
from tests.harness.registry.conftest import key_of

SUBCLASSES = """
from dataclasses import dataclass
from methods.adversarial import Game
from methods.gail import GAIL

@dataclass(frozen=True)
class Rate(GAIL):
    learning_rate: float = 1e-4

@dataclass(frozen=True)
class Long(GAIL):
    iterations: int = 30

@dataclass(frozen=True)
class Mine(Game):
    def fit(self, demos, world, rng): ...

@dataclass(frozen=True)
class Unlike:
    iterations: int = 3
    def fit(self, demos, world, rng): ...

METHODS = {"rate": Rate, "long": Long, "game": Mine, "unlike": Unlike, "itself": GAIL}
"""


@pytest.fixture(autouse=True)
def subclasses(here: None, tmp_path: Path) -> None:
    (tmp_path / "subclasses.py").write_text(SUBCLASSES)
    plugins.add([str(tmp_path / "subclasses.py")])


@pytest.mark.parametrize(("env", "budget"), [("swingup", "smoke"), ("gridworld", "quick")])
def test_what_derives_from_a_method_gets_its_settings(env: str, budget: str) -> None:
    gail, airl = settings_for("gail", env, budget), settings_for("airl", env, budget)
    found = {name: plugins.settings_for(name, env, budget) for name in KNOWN.of_plugins("method")}
    assert found == {
        **dict.fromkeys(("rate", "itself"), gail),
        "long": {name: value for name, value in gail.items() if name != "iterations"},
        "game": {name: value for name, value in gail.items() if airl.get(name) == value},
        "unlike": {},
    }
    for name, values in found.items():
        load_method(name)(**values)
    assert (effort.times_as_many("long", env, budget) > effort.MOST) == (budget == "smoke")


def test_settings_of_the_original_and_variables_are_part_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("rate", "long", "unlike", "bc")
    before = [key_of(name) for name in names]
    more = (("gail", "gail_mean", "gail_mean_state"), settings.ANY, settings.ANY, {"iterations": 2})
    monkeypatch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
    after = [key_of(name) for name in names]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, True, True, True]
    monkeypatch.setenv("IRL_BENCH_RATE", "1")
    later = [key_of(name) for name in names]
    assert [a == b for a, b in zip(later, after, strict=True)] == [False, False, False, True]


@pytest.mark.parametrize(
    ("steps", "said"), [(2900, ""), (2901, "mine in swingup took 3,001 .* 1,000 of gail:")]
)
def test_a_method_that_takes_many_more_steps_than_its_original_is_told(steps: int, said: str) -> None:
    results = []
    for method, took in (("gail", 900), ("mine", steps)):
        row = Row("swingup", method, 0, "pi_star", "absorbing", env_steps=took, check_steps=100)
        results.append(CellResult(Cell("swingup", method, 0), [row], like=["gail"]))
    found = effort.warnings(results, "smoke")
    assert len(found) == bool(said)
    assert all(re.search(said, line) for line in found), found
