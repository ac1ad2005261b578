"""Settings of methods that derive from built-in ones, and warnings about their steps."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.judge import effort
from harness.records import Cell, CellResult, Row
from harness.registry import KNOWN, load_method, plugins
from methods import settings
from methods.settings import settings_for

SUBCLASSES = """
from dataclasses import dataclass, make_dataclass
from methods.adversarial import Game
from methods.bc import BehaviourCloning
from methods.gail import GAIL

@dataclass(frozen=True)
class Rate(GAIL):
    learning_rate: float = 1e-4

@dataclass(frozen=True)
class Long(GAIL):
    iterations: int = 30

class Plain(GAIL): ...

@dataclass(frozen=True)
class Mine(Game):
    def fit(self, demos, world, rng): ...

@dataclass(frozen=True)
class Unlike:
    iterations: int = 3
    def fit(self, demos, world, rng): ...

METHODS = {"rate": Rate, "long": Long, "plain": Plain, "game": Mine, "unlike": Unlike, "itself": GAIL,
           "made": make_dataclass("Made", [("batch", int, 7)], bases=(BehaviourCloning,), frozen=True)}
"""


@pytest.fixture(autouse=True)
def subclasses(here: None, tmp_path: Path) -> None:
    (tmp_path / "subclasses.py").write_text(SUBCLASSES)
    plugins.add([str(tmp_path / "subclasses.py")])


@pytest.mark.parametrize(("env", "budget"), [("swingup", "smoke"), ("gridworld", "quick")])
def test_what_derives_from_a_method_gets_its_settings(env: str, budget: str) -> None:
    gail, airl = settings_for("gail", env, budget), settings_for("airl", env, budget)
    expected = {
        **dict.fromkeys(("rate", "plain", "itself"), gail),
        "long": {name: value for name, value in gail.items() if name != "iterations"},
        "game": {name: value for name, value in gail.items() if airl.get(name) == value},
        "made": settings_for("bc", env, budget),
        "unlike": {},
    }
    found = {name: plugins.settings_for(name, env, budget) for name in KNOWN.of_plugins("method")}
    assert found == expected
    for name, values in found.items():
        load_method(name)(**values)
    more = effort.times_as_many("long", env, budget)
    assert (more > effort.MOST) == (budget == "smoke")
    assert effort.times_as_many("rate", env, budget) == effort.times_as_many("made", env, budget) == 1


def test_settings_of_the_original_and_variables_are_part_of_the_key(
    key: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("rate", "long", "unlike", "bc")
    before = [key(name) for name in names]
    more = (("gail", "gail_mean", "gail_mean_state"), settings.ANY, settings.ANY, {"iterations": 2})
    monkeypatch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
    after = [key(name) for name in names]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, True, True, True]
    monkeypatch.setenv("IRL_BENCH_RATE", "1")
    later = [key(name) for name in names]
    assert [a == b for a, b in zip(later, after, strict=True)] == [False, False, False, True]


def result(method: str, steps: int, like: list[str] | None = None, env: str = "swingup") -> CellResult:
    row = Row(env, method, 0, "pi_star", "absorbing", env_steps=steps, check_steps=100)
    return CellResult(Cell(env, method, 0), [row], like=like or [])


@pytest.mark.parametrize(
    ("results", "said"),
    [
        ([result("gail", 900), result("mine", 2900, ["gail"])], ""),
        (
            [result("gail", 900), result("mine", 2901, ["gail"])],
            "mine in swingup took 3,001 .* 1,000 of gail:",
        ),
        ([result("mine", 36_236, ["gail"])], ""),
        ([result("mine", 36_236)], "mine in swingup took 36,236 .* of RL at this budget:"),
        (
            [result("bc", 0), result("mine", 36_236, ["bc"])],
            "took 36,236 .* of RL at this budget:|100 of bc:",
        ),
        ([result("bc", 0, env="moon"), result("mine", 36_236, env="moon")], ""),
    ],
)
def test_a_method_that_takes_many_more_steps_is_told(results: list[CellResult], said: str) -> None:
    found = effort.warnings(results, "smoke")
    assert len(found) == bool(said)
    assert all(re.search(said, line) for line in found), found
