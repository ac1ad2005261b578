"""The real thing, twice: the same seed gives the same scores, whatever the number of workers."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[2]


def scores(directory: Path, workers: int) -> pd.DataFrame:
    command = [sys.executable, "-m", "harness", "run", "--methods", "maxmargin", "--envs", "cartpole"]
    command += ["--budget", "smoke", "--workers", str(workers), "--out", str(directory / "run")]
    env = {**os.environ, "IRL_BENCH_CACHE": str(directory / "cache")}
    subprocess.run(command, cwd=ROOT, env=env, check=True, capture_output=True)
    return pd.read_csv(directory / "run" / "scores.csv").drop(columns="fit_seconds")


def test_scores_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    one, two = (scores(tmp_path / str(workers), workers) for workers in (1, 2))
    assert (one["status"] == "ok").all()
    pd.testing.assert_frame_equal(one, two, check_exact=True)
