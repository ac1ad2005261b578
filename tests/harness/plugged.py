"""A plug-in, and the command line with it."""

import os
import subprocess
import sys
from pathlib import Path

MINE = """
from dataclasses import dataclass
from irl_bench import Learned, from_gymnasium
from methods.bc import BehaviourCloning

@dataclass(frozen=True)
class Mine(BehaviourCloning):
    steps: int = 30

METHODS = {"mine": Mine}
ENVS = {"moon": from_gymnasium("Pendulum-v1", "moon", kwargs={"g": 1.62})}
"""
SMOKE = ("--budget", "smoke", "--no-retrain", "--record", "none")


def command(folder: Path, *words: str, code: int = 0, **variables: str) -> str:
    """Return what the command line prints, run in a folder."""
    env = {**os.environ, "IRL_BENCH_CACHE": str(folder / "cache"), **variables}
    program = [sys.executable, "-c", "from harness.cli.main import main; import sys; sys.exit(main())"]
    done = subprocess.run(
        [*program, *words], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr
