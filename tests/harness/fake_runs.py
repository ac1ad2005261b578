"""Runs of fake_cells.py: how tests start them, and what they leave."""

import json
import os
import sys
from pathlib import Path

from harness.judge.results import CONTROLS

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FAKE = [sys.executable, str(HERE / "fake_cells.py")]
FAKE_ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
SMOKE = ("run", "--budget", "smoke", "--envs", "cartpole")
PER_SEED = 1 + len(CONTROLS)


def faults(tmp_path: Path, **behaviour: str) -> None:
    (tmp_path / "faults.json").write_text(json.dumps(behaviour))


def computed(directory: Path) -> list[str]:
    return (directory / "computed.txt").read_text().split()[::2]


def scores(directory: Path) -> dict[str, str]:
    """What the stored cells hold, but for when they were stored."""
    found = {}
    for path in (directory / "cells").iterdir():
        stored = json.loads(path.read_text())["result"]
        found[path.name] = json.dumps({**stored, "finished": ""})
    return found
