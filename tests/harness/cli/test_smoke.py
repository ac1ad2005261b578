"""The real thing: every method with real numbers, with choices, and where the model is known; two methods
everywhere else; and the same seed gives the same scores. Most cells are computed in one process, which
imports and compiles once; that isolated ones are equal is said of a method with controls."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd

from harness.process.environment import numeric
from harness.registry import ENVS, METHODS
from methods.parts import BEGINS_WITH

ROOT = Path(__file__).parents[3]
EVERY_METHOD = ("cartpole", "cartpole_discrete", "gridworld")
"""One task of real numbers, one of choices, and one whose model is known."""
SMALL = "cartpole_discrete"


def harness(directory: Path, *arguments: str) -> str:
    """What the command line prints, in the environment that isolated cells have."""
    env = {**os.environ, **numeric(deterministic=True), "IRL_BENCH_CACHE": str(directory / "cache")}
    command = [sys.executable, "-m", "harness", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def scores(directory: Path, *options: str) -> pd.DataFrame:
    harness(directory, "run", "--budget", "smoke", "--out", str(directory / "run"), *options)
    assert "every file is as it was written" in harness(directory, "verify", str(directory / "run"))
    return pd.read_csv(directory / "run" / "scores.csv", dtype=str).drop(columns=["fit_seconds", "finished"])


def test_everything_runs_and_scores_do_not_depend_on_what_runs_before_or_beside(tmp_path: Path) -> None:
    methods, envs = "all,airl,dagger,gail_mean", ",".join(EVERY_METHOD)
    inline = ("--engine", "inline", "--record", "worst")
    every = scores(tmp_path / "every", "--methods", methods, "--envs", envs, *inline)
    assert set(every["status"]) == {"ok", "skipped"}
    assert {*METHODS, "airl", "dagger", "gail_mean"} <= {*every["method"]}
    unsuitable = every[(every["policy"] == "pi_star") & (every["status"] != "ok")]
    assert list(zip(unsuitable["env"], unsuitable["method"], strict=True)) == [("cartpole_discrete", "csil")]
    stars = every[every["policy"] == "pi_star"].pivot(index="method", columns="env", values="return_mean")
    for method, same in BEGINS_WITH.items():
        assert stars.loc[method].equals(stars.loc[same])
    others = ",".join(name for name in ENVS if name not in EVERY_METHOD)
    short = ("--no-retrain", "--set", "bc.steps=20")
    two = scores(tmp_path / "others", "--methods", "maxent,bc", "--envs", others, *inline, *short)
    assert set(two.loc[two["policy"] == "pi_star", "status"]) == {"ok"}
    assert set(two["status"]) <= {"ok", "skipped"}
    begun = "maxmargin,shaped_ml,gail_mean"
    alone = scores(tmp_path / "alone", "--methods", begun, "--envs", SMALL)
    same = every[(every["env"] == SMALL) & every["method"].isin(alone["method"])]
    pd.testing.assert_frame_equal(alone, same.reset_index(drop=True), check_exact=True)
    recording = tmp_path / f"alone/run/recordings/{SMALL}__maxmargin__seed0__pi_R.worst.rrd"
    recording.write_bytes(recording.read_bytes()[:-1])
    again = scores(tmp_path / "alone", "--methods", begun, "--envs", SMALL)
    pd.testing.assert_frame_equal(again, alone, check_exact=True)
