"""A task that cannot be right is refused by every command in the same words, before anything is written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest

from harness.cli.main import main
from harness.registry import KNOWN

ODD = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs import EnvSpec, from_gymnasium

class Odd(gym.Env):
    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.{space}
    steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(2, np.float32), {{}}

    def step(self, action):
        self.steps += 1
        return np.zeros(2, np.float32), {pay}, False, False, {{}}

gym.register("irl_bench_tests/{name}-v0", Odd, max_episode_steps=20, disable_env_checker={quiet})
ENVS = {{"odd": {spec}}}
"""
FLOAT, WHOLE = "Box(-1, 1, (2,))", "Box(0, 9, (2,), np.int32)"
NAN = "float('nan') if self.steps == 7 else np.ones(1)"
WRITTEN = "EnvSpec('odd', 'irl_bench_tests/{name}-v0', 2, 2, (1.0, 1.0), 20)"
DERIVED = "from_gymnasium('irl_bench_tests/{name}-v0', 'odd')"
REASONS = {"100 combinations": (WHOLE, "1.0"), "gives nan as reward of step 7": (FLOAT, NAN)}


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """What is made known here is forgotten again."""
    before = {*gymnasium.registry}
    with KNOWN.for_now():
        yield
    for name in gymnasium.registry.keys() - before:
        del gymnasium.registry[name]


@pytest.mark.parametrize("quiet", [True, False])
@pytest.mark.parametrize("how", ["written", "derived"])
@pytest.mark.parametrize("why", REASONS)
def test_a_task_is_refused_by_every_command_in_the_same_words(
    why: str, how: str, quiet: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str], recwarn: object
) -> None:
    """quiet: whether Gymnasium's own checker, which warns, is left out."""
    space, pay = REASONS[why]
    name = f"{how}{space[:3]}{quiet}{len(why)}"
    spec = (WRITTEN if how == "written" else DERIVED).format(name=name)
    file, out = tmp_path / "odd.py", tmp_path / "run"
    file.write_text(ODD.format(space=space, pay=pay, name=name, spec=spec, quiet=quiet))
    named = ["--plugin", str(file)]
    said = []
    for command in (
        ["list"],
        ["check", "odd"],
        ["run", "--envs", "odd", "--methods", "bc", "--out", str(out)],
        ["run", "--plan", "--envs", "odd", "--methods", "bc", "--out", str(out)],
    ):
        assert main([*command, *named]) == 2
        printed = capfd.readouterr()
        assert printed.out == ""
        said.append(printed.err)
    assert len(set(said)) == 1
    assert why in said[0]
    assert said[0].count("\n") == 1
    assert not out.exists()
