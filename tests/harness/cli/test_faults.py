"""Whatever breaks, whenever: every cell is accounted for, and nothing is left lying about."""

import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.records import CONTROLS, Cell
from tests.harness.fake_runs import compute, scores
from tests.harness.small_runs import names

HERE = Path(__file__).parents[1]
ENV = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
WORKERS = 2


@pytest.fixture
def temporary() -> Iterator[Path]:
    """A folder for temporary files, with a path short enough for sockets."""
    with tempfile.TemporaryDirectory(prefix="t-") as folder:
        yield Path(folder)


def test_a_run_killed_twenty_times_ends_as_an_unbroken_one(tmp_path: Path, temporary: Path) -> None:
    env = {**ENV, "TMPDIR": str(temporary)}
    seeds, kills, rng = 8, 20, np.random.default_rng(0)
    cells = [f"cartpole__{m}__seed{s}" for m in ("reference", *CONTROLS, "bc") for s in range(seeds)]
    (tmp_path / "faults.json").write_text(json.dumps(dict.fromkeys(cells, "brief")))
    options = ["--methods", "bc", "--envs", "cartpole", "--seeds", str(seeds), "--workers", str(WORKERS)]
    command = [sys.executable, str(HERE / "fake_cells.py"), "run", "--budget", "smoke", *options, "--out"]

    finished = 0
    for number in range(kills):
        process = subprocess.Popen(
            [*command, str(tmp_path / "killed")], env=env, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        lines = 2 * (number % 5 > 0) + int(rng.integers(1, 9))  # of an expert and, mostly, of cells
        for _ in range(lines):
            assert process.stdout.readline()
        time.sleep(float(rng.uniform(0, 0.2)))
        process.kill()
        process.communicate(timeout=10)
        found = names(tmp_path / "killed") if (tmp_path / "killed/run.sqlite").exists() else []
        assert len(found) >= finished
        finished = len(found)
    assert 0 < finished < len(cells)
    (tmp_path / "faults.json").write_text("{}")  # None need wait for a kill any more.
    for name in ("killed", "unbroken"):
        subprocess.run([*command, str(tmp_path / name)], env=env, check=True, capture_output=True)
    assert scores(tmp_path / "killed") == scores(tmp_path / "unbroken")
    computed = (tmp_path / "killed/computed.txt").read_text().split()[::2]
    assert set(computed) == set(cells)
    assert len(computed) <= len(cells) + kills * WORKERS
    left = [path for path in (tmp_path / "killed").rglob(".*") if path.name != ".lock"]
    assert left == []
    assert list(temporary.iterdir()) == []


def test_two_hundred_cells_with_faults_are_all_accounted_for(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    (tmp_path / "run").mkdir()
    cells = [Cell("cartpole", "bc", seed) for seed in range(200)]
    behaviours = ["raise"] * 20 + ["kill"] * 10 + ["sleep"] * 10 + ["good"] * 160
    np.random.default_rng(0).shuffle(behaviours)
    faults = {cell.name: behaviour for cell, behaviour in zip(cells, behaviours, strict=True)}
    (tmp_path / "faults.json").write_text(json.dumps(faults))
    # What is opened once, such as the server that forks, is open after the first.
    compute(tmp_path / "run", cells[:2], WORKERS, timeout=5)
    open_files = len(os.listdir("/proc/self/fd"))
    found = compute(tmp_path / "run", cells, WORKERS, timeout=5).results
    assert len(os.listdir("/proc/self/fd")) <= open_files
    assert list(temporary.iterdir()) == []
    assert multiprocessing.active_children() == []
    assert sorted(result.cell for result in found) == cells
    reasons = {"raise": "ValueError", "kill": "its process was killed by SIGKILL", "sleep": "it was stopped"}
    for result in found:
        expected = reasons.get(faults[result.cell.name])
        for row in result.rows:
            assert row.status == ("failed" if expected else "ok")
            assert row.reason.startswith(expected or "")
