"""A user's own packages called as this program's, beside a script."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FIRST = """
import envs, methods.deep
"""
RUN = """
import irl_bench
asked = irl_bench.RunRequest(methods=["bc"], envs=["gridworld"], budget="smoke", retrain=False, record="none")
done = irl_bench.run(asked, irl_bench.Engine(workers=1), "run")
assert len(done.scores) and done.failed.empty
spec = irl_bench.from_gymnasium("Pendulum-v1", "moon")
assert irl_bench.make("swingup").step and irl_bench.load("run").scores.equals(done.scores)
"""
THEN = """
import envs.late, methods
print(envs.OWN, envs.late.OWN, methods.deep.OWN if hasattr(methods, "deep") else methods.OWN)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for package in ("envs", "methods"):
        (tmp_path / package).mkdir()
        for name in ("__init__", "deep", "late"):
            (tmp_path / package / f"{name}.py").write_text("OWN = 'theirs'\n")
    return tmp_path


def run(folder: Path, *words: str, **variables: str) -> str:
    env = {**os.environ, "IRL_BENCH_CACHE": str(folder / "cache"), **variables}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("first", [FIRST, ""])
def test_a_script_has_its_own_packages_and_a_run_this_programs(folder: Path, first: str) -> None:
    (folder / "script.py").write_text(first + RUN + THEN)
    assert run(folder, "script.py").splitlines()[-1] == "theirs theirs theirs"


def test_the_command_line_takes_no_package_of_the_current_folder(folder: Path) -> None:
    path = os.pathsep.join([".", *filter(None, [os.environ.get("PYTHONPATH")])])
    code = "import irl_bench, sys; sys.argv[0] = 'irl-bench'; sys.exit(irl_bench.start())"
    words = [
        "run",
        "--methods",
        "bc",
        "--envs",
        "gridworld",
        "--budget",
        "smoke",
        "--no-retrain",
        "--record",
        "none",
    ]
    assert "2 cells to run" in run(folder, "-c", code, *words, PYTHONPATH=path)


@pytest.mark.parametrize("words", [["-m", "harness"], ["-c", "import irl_bench"]])
def test_windows_is_refused_in_a_line_with_the_way_out(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.platform = 'win32'\n")
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[3])])
    env = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, *words], env=env, capture_output=True, text=True, check=False)
    assert done.returncode
    assert "irl-bench needs Linux or macOS; on Windows run it in WSL" in done.stderr.splitlines()[-1]
