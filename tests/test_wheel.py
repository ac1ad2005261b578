"""The wheel, installed into an empty environment, does the main job outside the checkout."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = ("envs", "methods", "harness", "irl_bench.py", "pyproject.toml", "README.md", "LICENSE")
EXPERTS = "results/reference/experts"


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an environment's programs: this program's wheel lies there, beside our dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    ignored = shutil.ignore_patterns("__pycache__")
    for name in (*SOURCES, EXPERTS):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / "source" / name, ignore=ignored)
        else:
            shutil.copy(ROOT / name, folder / "source" / name)
    pip = [sys.executable, "-m", "pip", "--quiet"]
    offline = ["--no-deps", "--no-index"]
    build = [
        *pip,
        "wheel",
        *offline,
        "--no-build-isolation",
        "--wheel-dir",
        str(folder),
        str(folder / "source"),
    ]
    subprocess.run(build, check=True)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", symlinks=os.name != "nt")
    paths = sysconfig.get_paths(vars={"base": str(folder / "env"), "platbase": str(folder / "env")})
    # A folder on the path: the .pth files there, such as those of editable installs, are not read.
    Path(paths["purelib"], "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    scripts = Path(paths["scripts"])
    subprocess.run([*pip, "--python", str(scripts / "python"), "install", *offline, str(wheel)], check=True)
    return scripts


def test_the_wheel_does_the_main_job_outside_the_checkout(scripts: Path, tmp_path: Path) -> None:
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    env["IRL_BENCH_CACHE"] = str(tmp_path / "cache")

    def told(*command: str) -> str:
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    where = "import irl_bench, envs, harness; print(irl_bench.__file__, envs.__file__, harness.__file__)"
    files = told(str(scripts / "python"), "-c", where).split()
    assert all(Path(file).is_relative_to(scripts.parent) for file in files)
    program = str(scripts / "irl-bench")
    asked = ("--methods", "bc,maxent", "--envs", "gridworld", "--budget", "smoke", "--out", "run")
    assert "10 ok" in told(program, "run", *asked)
    assert (tmp_path / "run/report.html").exists()
    assert "as it was written" in told(program, "verify", "run")
