"""The examples do what they say."""

import os
import re
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"
HARNESS = [sys.executable, "-m", "harness"]


def test_the_walk_through_goes_from_a_method_to_another_library(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / "walk_through.py"), "smoke", str(tmp_path)]
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}
    out = subprocess.run(command, cwd=tmp_path, env=env, check=True, capture_output=True, text=True).stdout
    assert re.search(r"^method +\nbc .*\nridge .*\n", out, re.MULTILINE)
    assert re.search(r"^ *swingup +ridge +-?\d\.\d+ ", out, re.MULTILINE)
    assert re.search(r"^ridge on cartpole returns \d+\.\d \+- \d+\.\d\n\Z", out, re.MULTILINE)
    assert (tmp_path / "exported/policy.safetensors").exists()


def test_the_example_of_a_reward_keeps_the_contract() -> None:
    words = ["check", "difference", "--plugin", str(EXAMPLES / "my_reward.py")]
    subprocess.run([*HARNESS, *words], cwd=EXAMPLES.parent, check=True)
