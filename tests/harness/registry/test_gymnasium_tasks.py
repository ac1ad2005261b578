"""Tasks of Gymnasium by their id, and this program's tasks in Gymnasium."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from harness.cli.main import main
from harness.registry import ENVS, SPECS, BadInput, gymnasium_tasks, plugins

Key = Callable[..., str]
pytestmark = pytest.mark.usefixtures("here")


def test_every_task_can_be_made_by_gymnasium() -> None:
    code = "import gymnasium\nenv = gymnasium.make('irl_bench:irl_bench/Swingup-v0')\n"
    code += "print(env.reset(seed=3)[0].tolist())\n"
    code += "print(sum(name.startswith('irl_bench/') for name in gymnasium.registry))"
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    obs, count = done.stdout.splitlines()
    assert np.array_equal(eval(obs), SPECS["swingup"].make().reset(seed=3)[0].tolist())
    assert int(count) == len(ENVS)


def test_a_key_is_of_what_a_task_is_registered_with(key: Key, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = "gymnasium.envs.classic_control:PendulumEnv"

    def key_with(horizon: int = 200, **kwargs: object) -> str:
        spec = EnvSpec("Heavy-v0", entry, max_episode_steps=horizon, kwargs=kwargs)
        monkeypatch.setitem(gymnasium.registry, "Heavy-v0", spec)
        return key("bc", gymnasium_tasks.task_or_name("gym:Heavy-v0"))

    assert len({key_with(g=10.0), key_with(g=2.0), key_with(horizon=100, g=2.0)}) == 3
    with pytest.raises(BadInput, match="registered with arguments that are neither numbers nor texts"):
        key_with(g=object())


@pytest.mark.parametrize("kind", ["plug-in", "gymnasium"])
def test_a_key_is_of_modules_that_a_task_is_registered_with(
    kind: str, tmp_path: Path, key: Key, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gymnasium's registry names them as text: nothing imports them."""
    texts = {
        "far_env": "from gymnasium.envs.classic_control import PendulumEnv as Far\nimport far_away",
        "far_wrap": "from gymnasium import Wrapper as Pay",
        "far_away": "",
        "far": "from irl_bench import from_gymnasium\nENVS = {'far': from_gymnasium('Far-v0', 'far')}",
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    wrappers = (WrapperSpec("Pay", "far_wrap:Pay", {}),)
    spec = EnvSpec("Far-v0", "far_env:Far", max_episode_steps=200, additional_wrappers=wrappers)
    monkeypatch.setitem(gymnasium.registry, "Far-v0", spec)

    def key_now() -> str:
        if kind == "plug-in":
            return key("bc", "far", tmp_path / "far.py")
        return key("bc", gymnasium_tasks.task_or_name("gym:Far-v0"))

    found = [key_now()]
    for name in ("far_env", "far_wrap", "far_away"):
        (tmp_path / f"{name}.py").write_text(f"{texts[name]}\nMORE = 1\n")
        found.append(key_now())
    assert len(set(found)) == 4


def test_a_task_of_gymnasium_needs_its_id_alone(key: Key) -> None:
    assert gymnasium_tasks.task_or_name("gym:Pendulum-v1") == "gym_Pendulum-v1"
    assert SPECS["gym_Pendulum-v1"].env_id == "Pendulum-v1"
    plugins.load([], ["gym_Pendulum-v1"])
    assert key("bc", "gym_Pendulum-v1") != key("bc", "swingup")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("gym:NoSuchTask-v0", "NameNotFound"),
        ("gym:Pendulum", "Pendulum names no version of the task"),
        ("gym:Blackjack-v1", "observations must be a flat box"),
        ("gym:../run-v0", "no id of Gymnasium"),
    ],
)
def test_why_a_task_cannot_be_derived_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, reason: str
) -> None:
    out = tmp_path / "run"
    assert main(["run", "--methods", "bc", "--envs", name, "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert re.search(reason, err), err
    assert err.count("\n") == 1
    assert not out.exists()
