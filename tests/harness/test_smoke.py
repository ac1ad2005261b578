"""The real thing: every method in every environment, and the same seed gives the same scores."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[2]


def scores(directory: Path, *options: str) -> pd.DataFrame:
    command = [sys.executable, "-m", "harness", "run", "--budget", "smoke", "--out", str(directory / "run")]
    env = {**os.environ, "IRL_BENCH_CACHE": str(directory / "cache")}
    done = subprocess.run(
        [*command, *options], cwd=ROOT, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return pd.read_csv(directory / "run" / "scores.csv", dtype=str).drop(columns="fit_seconds")


def test_everything_runs_and_scores_do_not_depend_on_what_runs_beside(tmp_path: Path) -> None:
    every = scores(tmp_path / "every", "--methods", "all", "--envs", "all")
    assert set(every["status"]) == {"ok", "skipped"}
    alone = scores(tmp_path / "alone", "--methods", "maxmargin", "--envs", "cartpole", "--workers", "1")
    same = every[(every["env"] == "cartpole") & every["method"].isin(alone["method"])]
    pd.testing.assert_frame_equal(alone, same.reset_index(drop=True), check_exact=True)
