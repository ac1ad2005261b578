"""Tasks by their id in Gymnasium: who registers them, their arguments, and variables that plug-ins read."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest

from harness.api.request import RunRequest, resolve
from harness.cli.main import main
from harness.records import Cell, Conditions
from harness.registry import KNOWN, BadInput, keys, packing, plugins
from harness.registry.gymnasium_tasks import task_or_name
from harness.registry.packages import to_install
from harness.store.request import Request, command_of
from tests.harness.plugged import SMOKE, command
from tests.harness.registry.conftest import key_of
from tests.harness.registry.test_plugins import refused

HELPER = "import os\nLENGTH = int(os.environ['CORRIDOR_LENGTH']) if {reads} else 5\n"
CORRIDOR = """
import gymnasium, numpy
from gymnasium import spaces
from its_helper_of_tasks import LENGTH

class Corridor(gymnasium.Env):
    observation_space = spaces.Dict(
        {"place": spaces.Discrete(LENGTH), "speed": spaces.Box(-1, 1, (1,))}
    )
    action_space = spaces.MultiDiscrete([2, 2])

    def __init__(self, price=1.0):
        self.price = price

    def seen(self):
        return {"place": self.place, "speed": numpy.zeros(1, numpy.float32)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = int(self.np_random.integers(LENGTH))
        return self.seen(), {}

    def step(self, action):
        self.place = int(numpy.clip(self.place + action[0] - action[1], 0, LENGTH - 1))
        return self.seen(), numpy.array([self.place - self.price]), False, False, {}

gymnasium.register("tests/Corridor-v0", Corridor)
"""
NAME, LIMITED = "gym_tests+Corridor-v0", {"max_episode_steps": 10}


@pytest.fixture(autouse=True)
def corridor(tmp_path: Path) -> Iterator[Path]:
    """A plug-in that registers a task, imports a file beside it, and has no METHODS and ENVS."""
    before, path = {*gymnasium.registry}, [*sys.path]
    (tmp_path / "its_helper_of_tasks.py").write_text(HELPER.format(reads=False))
    (tmp_path / "theirs_tasks.py").write_text(CORRIDOR)
    yield tmp_path / "theirs_tasks.py"
    sys.path[:] = path
    for name in gymnasium.registry.keys() - before:
        del gymnasium.registry[name]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("by", ["plugin", "id"])
def test_a_task_is_computed_with_the_plugin_that_registers_it(
    by: str, corridor: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(corridor.parent) if by == "id" else str(tmp_path / "elsewhere"))
    plugins.give(LIMITED, [])
    named, env = (
        ([str(corridor)], "gym:tests/Corridor-v0")
        if by == "plugin"
        else ([], "gym:theirs_tasks:tests/Corridor-v0")
    )
    plugins.add(named, [env])
    assert task_or_name(env) == NAME
    (needed,) = plugins.needed(["bc"], [NAME])
    assert needed.name == (str(corridor) if by == "plugin" else "theirs_tasks")
    spec = KNOWN.specs[NAME]
    assert (spec.obs_size, spec.act_size, spec.horizon) == (6, 4, 10)
    sources = plugins.sources("env", NAME).digests
    assert any(one.startswith("its_helper_of_tasks.py ") for one in sources), sources
    (tmp_path / "far").mkdir()
    copied = tmp_path / "far" / packing.packed(tmp_path / "far")[needed].place
    assert (copied if copied.is_dir() else copied.parent / "its_helper_of_tasks.py").exists()


def test_arguments_are_in_keys_conditions_and_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(**kwargs: object) -> tuple[Request, str]:
        with KNOWN.for_now():
            request, _ = resolve(
                RunRequest(methods=["bc"], envs=["gym:Pendulum-v1"], env_kwargs=kwargs), True
            )
            return request, keys.cell_keys(
                [Cell("gym_Pendulum-v1", "bc", 0)], request.conditions, {}
            ).popitem()[1]

    results = [asked(), asked(g=2.0), asked(g=3.0), asked(max_episode_steps=7)]
    assert len({key for _, key in results}) == 4
    assert json.loads(results[1][0].conditions.env_kwargs) == {"g": 2.0}
    assert "--envs gym_Pendulum-v1 " in command_of(results[1][0])
    assert "--env-kwargs g=2.0" in command_of(results[1][0])


@pytest.mark.usefixtures("here")
def test_arguments_reach_the_task_and_its_experts() -> None:
    plugins.give({"g": 2.0, "max_episode_steps": 7}, [])
    name = task_or_name("gym:Pendulum-v1")
    env = KNOWN.specs[name].make()
    assert (env.unwrapped.g, KNOWN.specs[name].horizon) == (2.0, 7)  # type: ignore[attr-defined]
    before = keys.expert_key(name, [])
    plugins.give({}, [])
    task_or_name("gym:Pendulum-v1")
    assert KNOWN.specs[name].horizon == 200
    assert keys.expert_key(name, []) != before


REFUSED = {
    "--envs gym:Pendulum-v1 --env-kwargs g=1 --env-kwargs g=2": "--env-kwargs g is given twice",
    "--envs gym:Pendulum-v1 --env-kwargs g=null": 'gym_Pendulum-v1 with {"g": null} cannot be loaded: Type',
    "--envs swingup --env-var LENGTH=4": "set it before the command, and give its name alone",
    "--envs swingup --env-kwargs g=1": "arguments of tasks gym:ID, not of swingup",
    "--envs gym:Pendulum-v1 --env-kwargs g": "'g' is not NAME=VALUE",
    "--envs gym:Pendulum-v1 --env-kwargs gg=1": "--env-kwargs are arguments of the task's class",
    "--envs gym:CliffWalking-v1": "has no time limit; give one: --env-kwargs max_episode_steps=200",
    "--envs gym:Nowhere/Task-v0": "name the module that registers the task: gym:MODULE:ID",
    "--envs gym:no_such_module:Task-v0": "No module named 'no_such_module'",
    "--envs gym:Taxi-v3": "Please use `Taxi-v4` instead",
    "--envs swingup --env-var NO_SUCH_VARIABLE": "NO_SUCH_VARIABLE: the environment has no such variable",
    "--envs swingup --env-var OMP_NUM_THREADS": "cells have OMP_NUM_THREADS already, or set it themselves",
    "--envs swingup --env-var HOME": "cells have HOME already",
}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_given_is_refused_in_a_line(
    words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(words.split(), REFUSED[words], capfd)


OLD = {
    "no seed": (
        "(self, *, seed=None, options=None):\n        super().reset(seed=seed)",
        "(self):\n        pass",
        "argument 'seed'; reset must take seed= and options=, as of Gymnasium 0.26",
    ),
    "no info": (
        "return self.seen(), {}",
        "return self.seen()",
        "reset must return an observation and a dict",
    ),
    "four values": (
        ", False, False, {}",
        ", False, {}",
        "and step an observation, a reward, whether it term",
    ),
    "other numbers": (
        "numpy.zeros(1, numpy.float32)",
        "numpy.float32(numpy.random.rand(1))",
        "something else after a reset with the same seed; call super().reset(seed=seed) in reset",
    ),
}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("what", OLD)
def test_a_task_that_does_not_reset_and_step_as_gymnasium_is_refused_with_what_to_change(
    what: str, corridor: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(corridor.parent)
    now, then, why = OLD[what]
    assert now in CORRIDOR
    corridor.write_text(CORRIDOR.replace(now, then))
    words = ["--plugin", str(corridor), "--envs", "gym:tests/Corridor-v0"]
    refused([*words, "--env-kwargs", "max_episode_steps=10"], why, capfd)


@pytest.mark.parametrize(
    "command",
    [
        "check swingup",
        "check bc",
        "list bc --env swingup",
        "list",
        "experts check swingup",
        "demos inspect x.npz --env swingup",
    ],
)
def test_every_command_refuses_arguments_for_tasks_of_its_own(
    command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), "--env-kwargs", "g=1"]) == 2
    assert "--env-kwargs are arguments of tasks gym:ID, not of" in capfd.readouterr().err


@pytest.mark.parametrize("task", ["highway-v0", "parking-v0"])
def test_highway_envs_tasks_are_found_without_its_module(task: str) -> None:
    code = "import gymnasium; from harness.registry.gymnasium_tasks import find\n"
    code += f"before = {task!r} in gymnasium.registry; find({task!r})\n"
    code += f"print(before, {task!r} in gymnasium.registry)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


@pytest.mark.usefixtures("here")
def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "Box2D", None)
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.box2d")]:
        monkeypatch.delitem(sys.modules, name)  # other tests may have imported it
    with pytest.raises(BadInput, match=re.escape("pip install 'irl-bench[box2d]'")):
        plugins.add([], ["gym:LunarLander-v3"])
    with pytest.raises(BadInput, match=re.escape("carracing needs Box2D: pip install 'irl-bench[box2d]'")):
        resolve(RunRequest(methods=["bc"], envs=["carracing"]), True)


def test_an_extra_without_a_wheel_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 13, 9))
    assert to_install("box2d") == "pip install 'irl-bench[box2d]'"
    monkeypatch.setattr(sys, "version_info", (3, 14, 0))
    assert to_install("box2d") == "pip install 'irl-bench[box2d]', which needs swig and a C++ compiler"
    assert to_install("ray") == "pip install 'irl-bench[ray]'"


def test_a_variable_is_in_keys_and_reaches_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CORRIDOR_LENGTH", "7")
    with KNOWN.for_now():
        request, _ = resolve(RunRequest(methods=["bc"], envs=["swingup"], env_vars=["CORRIDOR_LENGTH"]), True)
    stored = request.conditions.env_vars
    assert json.loads(stored) == {"CORRIDOR_LENGTH": "7"}
    assert "--env-var CORRIDOR_LENGTH" in command_of(request)
    monkeypatch.delenv("CORRIDOR_LENGTH")
    plugins.in_cells([], ["bc"], ["swingup"], "", stored)
    assert os.environ["CORRIDOR_LENGTH"] == "7"
    cell = Cell("swingup", "bc", 0)
    seven, eight = (
        keys.cell_keys([cell], Conditions("smoke", "absorbing", "sbx", env_vars=text), {})[cell]
        for text in (stored, stored.replace("7", "8"))
    )
    assert len({seven, eight, key_of("bc")}) == 3


def test_a_task_that_reads_a_variable_runs_by_its_id(corridor: Path) -> None:
    """It registers itself, reads a file beside it, and its observations and actions have parts."""
    (corridor.parent / "its_helper_of_tasks.py").write_text(HELPER.format(reads=True))
    words = ["run", "--plugin", corridor.name, "--envs", "gym:tests/Corridor-v0", "--methods", "bc", *SMOKE]
    words += ["--env-kwargs", "max_episode_steps=10", "--env-kwargs", "price=2.5"]
    told = command(corridor.parent, *words, code=2, CORRIDOR_LENGTH="4")
    assert "KeyError: 'CORRIDOR_LENGTH'; cells get few variables: add --env-var CORRIDOR_LENGTH" in told
    words += ["--env-var", "CORRIDOR_LENGTH"]
    assert "2 cells to run" in command(corridor.parent, *words, CORRIDOR_LENGTH="4")
    assert "0 cells to run, 2 kept" in command(corridor.parent, *words, CORRIDOR_LENGTH="4")
    told = command(corridor.parent, *words, code=2, CORRIDOR_LENGTH="5")
    assert 'holds a run with env_vars {"CORRIDOR_LENGTH": "4"}, not {"CORRIDOR_LENGTH": "5"}' in told
    report = (corridor.parent / "results/latest/leaderboard.md").read_text()
    assert 'arguments of the tasks {"max_episode_steps": 10, "price": 2.5}' in report
