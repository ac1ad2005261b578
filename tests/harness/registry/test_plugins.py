"""Methods and tasks of others: named, broken, and never mistaken for one another."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from harness.cli.main import main
from harness.engines.compute import compute
from harness.engines.jobs import Job
from harness.judge import effort
from harness.process.environment import of_this_process
from harness.records import Cell, CellResult, Row
from harness.registry import (
    BUILT_IN,
    ENVS,
    KNOWN,
    METHODS,
    SPECS,
    BadInput,
    keys,
    load_method,
    loading,
    plugins,
)
from harness.registry.known import Offer, Plugin
from methods import settings
from methods.settings import settings_for
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import CONDITIONS, key_of

pytestmark = pytest.mark.usefixtures("here")
Capture = pytest.CaptureFixture[str]
OWN_PROCESS = loading.in_a_process


def test_a_files_methods_and_tasks_are_known_and_not_part_of_all(mine: Path) -> None:
    plugins.add([str(mine)])
    assert load_method("mine").__name__ == "Mine"
    assert KNOWN.chosen_methods("all") == (*METHODS,)
    assert KNOWN.chosen_methods("plugins") == ("mine",)
    assert KNOWN.chosen_envs("plugins") == ("moon",)
    assert KNOWN.chosen_envs("all") == (*ENVS,)
    assert KNOWN.chosen_envs("moon,driving,cartpole") == ("cartpole", "drive_state", "drive", "moon")
    assert plugins.needed(["mine"], []) == plugins.needed([], ["moon"]) == (Plugin(str(mine), str(mine)),)
    assert not plugins.needed(["bc"], ["swingup"])
    facts, spec = plugins.task("moon"), SPECS["moon"]
    assert isinstance(facts, Offer)
    for name in ("discrete", "rl_steps", "ddpg_steps", "solves"):
        assert getattr(facts, name) == getattr(spec, name)
    assert plugins.task("swingup") is SPECS["swingup"]


def test_every_task_can_be_made_by_gymnasium() -> None:
    code = "import gymnasium\nenv = gymnasium.make('irl_bench:irl_bench/Swingup-v0')\n"
    code += "print(*env.reset(seed=3)[0].tolist())\n"
    code += "print(sum(name.startswith('irl_bench/') for name in gymnasium.registry))"
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    *obs, count = done.stdout.split()
    assert np.array_equal([*map(float, obs)], SPECS["swingup"].make().reset(seed=3)[0].tolist())
    assert int(count) == len(BUILT_IN["env"])


def test_a_file_that_was_edited_is_read_anew(mine: Path) -> None:
    """As from a notebook, in one process."""
    plugins.add([str(mine)])
    assert SPECS["moon"].name == "moon"
    mine.write_text(MINE.replace("steps: int = 30", "steps: int = 40"))
    plugins.add([str(mine)])
    assert load_method("mine")().steps == 40


def test_a_plugin_that_is_edited_while_a_run_goes_on_computes_nothing_more(mine: Path) -> None:
    plugins.add([str(mine)])
    cell = Cell("swingup", "mine", 0)
    (key,) = keys.cell_keys([cell], CONDITIONS, of_this_process()).values()
    asked = Job((cell,), False, CONDITIONS, key, plugins.needed(["mine"], []))
    mine.write_text(f"{MINE}\nEDITED = 1\n")
    with pytest.raises(RuntimeError, match="are not those that the run began with"):
        compute("harness.process.cells", asked)


def test_what_a_plugin_prints_goes_to_standard_error_and_a_fit_that_exits_fails_its_check(
    mine: Path, capsys: Capture
) -> None:
    """Standard output may be read by a program."""
    fit = "    def fit(self, demos, world, rng):\n        raise SystemExit(0)"
    mine.write_text("print('hello')\n" + MINE.replace("    steps: int = 30", fit))
    assert main(["list", "--plugin", str(mine)]) == 0
    out, err = capsys.readouterr()
    assert ("hello" in out, err) == (False, "hello\n")
    assert main(["check", "mine", "--plugin", str(mine)]) == 1
    assert "FAILED  mine: " in capsys.readouterr().out


CLASS = "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass A:\n fit = print\n"
BROKEN = {
    "syntax": ("def broken(:", "cannot be loaded: SyntaxError"),
    "import": ("import nowhere_to_be_found", "can import what lies in its own folder"),
    "nothing": ("", "says neither METHODS nor ENVS"),
    "no fit": ("class A: ...\nMETHODS = {'mine': A}", "must be a class with a method fit"),
    "no default": (CLASS.replace(" fit", " rate: int\n fit") + "METHODS = {'mine': A}", "argument: 'rate'"),
    "shadows": (f"{CLASS}METHODS = {{'bc': A}}", "'bc': the name is this program's"),
    "odd name": (f"{CLASS}METHODS = {{'a__b': A}}", "'a__b' is no name of methods"),
    "other name": (MINE.replace('"moon": from', '"mars": from'), "the env mars must be an EnvSpec of that"),
    "our package": ("import envs.of_mine", "'envs' is this program's package: give yours another name"),
}
ENDING = {
    "keyboard": ("raise KeyboardInterrupt", "cannot be loaded: KeyboardInterrupt"),
    "leaves": ("import os\nos._exit(0)", "ended its process while it was loaded (0)"),
    "crashes": ("import ctypes\nctypes.string_at(0)", "ended its process while it was loaded (-11)"),
    "hangs": ("import time\ntime.sleep(1000)", "was not loaded within 2 s"),
}


def refused(words: list[str], why: str, capfd: Capture) -> None:
    """Assert that a run is refused in a line that says why, and writes nothing."""
    assert main(["run", "--methods", "bc", *words, "--out", "run"]) == 2
    err = capfd.readouterr().err
    assert why in err
    assert err.count("\n") == 1
    assert not Path("run").exists()


@pytest.mark.parametrize("how", [*BROKEN, *ENDING])
def test_a_plugin_that_cannot_be_loaded_is_one_line_and_nothing_is_written(
    how: str, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text, why = (BROKEN | ENDING)[how]
    (tmp_path / "odd.py").write_text(text)
    if how in ENDING:
        monkeypatch.setattr(loading, "in_a_process", OWN_PROCESS)
        monkeypatch.setattr(loading, "LONGEST", 2 if how == "hangs" else 100)
    refused(["--plugin", "odd.py"], why, capfd)


@pytest.mark.parametrize(
    ("option", "name", "why"),
    [
        ("--envs", "gym:NoSuchTask-v0", "NameNotFound"),
        ("--envs", "gym:Pendulum", "Pendulum names no version of the task"),
        ("--envs", "gym:Blackjack-v1", "no time limit; give one: --env-kwargs max_episode_steps=200"),
        ("--plugin", "nowhere.py", "there is no plug-in"),
        ("--plugin", "no_such_module", "cannot be loaded"),
        ("--plugin", "mine.txt", "does not end in .py"),
    ],
)
def test_what_is_no_plugin_or_no_task_of_gymnasium_is_refused_in_a_line(
    option: str, name: str, why: str, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.txt").write_text(MINE)
    refused([option, name], why, capfd)


def test_two_plugins_may_not_name_the_same(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "other.py").write_text(MINE.replace("moon", "mars"))
    twice = r"two plug-ins name a method 'mine': of .*mine\.py, and of .*other\.py"
    with pytest.raises(BadInput, match=twice):
        plugins.add([str(mine), str(tmp_path / "other.py")])


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


@pytest.fixture
def subclasses(here: None, tmp_path: Path) -> None:
    (tmp_path / "subclasses.py").write_text(SUBCLASSES)
    plugins.add([str(tmp_path / "subclasses.py")])


@pytest.mark.usefixtures("subclasses")
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


def test_settings_of_the_original_and_variables_are_part_of_the_key(
    subclasses: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("rate", "long", "unlike", "bc")
    before = [key_of(name) for name in names]
    more = (("gail", "gail_mean", "gail_mean_state"), settings.ANY, settings.ANY, {"iterations": 2})
    monkeypatch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
    after = [key_of(name) for name in names]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, True, True, True]
    monkeypatch.setenv("IRL_BENCH_RATE", "1")
    later = [key_of(name) for name in names]
    assert [a == b for a, b in zip(later, after, strict=True)] == [False, False, False, True]


@pytest.mark.usefixtures("subclasses")
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
