"""Runs with methods and tasks of others, from the command line."""

import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import irl_bench
from tests.harness.plugged import MINE, SMOKE, command

ROOT = Path(__file__).parents[3]
SAMPLE = ROOT / "tests/sample_plugin"


def test_a_plugin_is_computed_beside_what_is_built_in(mine: Path) -> None:
    told = command(
        mine.parent, "run", "--plugin", "mine.py", "--methods", "bc,plugins", "--envs", "swingup", *SMOKE
    )
    assert "3 cells to run" in told
    frames = irl_bench.load(mine.parent / "results/latest")
    stars = frames.scores[frames.scores.policy == "pi_star"]
    assert dict(zip(stars.method, stars.status, strict=True)) == {"bc": "ok", "mine": "ok"}
    assert "methods of plug-ins:\n  mine " in command(mine.parent, "list", "--plugin", "mine.py")
    assert "ok      mine: it is a frozen dataclass" in command(
        mine.parent, "check", "mine", "--plugin", "mine.py"
    )
    # It is edited: its own cell is computed anew, and no other.
    mine.write_text(MINE.replace("30", "40"))
    told = command(
        mine.parent, "run", "--plugin", "mine.py", "--methods", "bc,mine", "--envs", "swingup", *SMOKE
    )
    assert "1 cells to run, 2 kept from before" in told
    # Without the plug-in what it computed would be dropped from the board.
    before = (mine.parent / "results/latest/leaderboard.csv").read_bytes()
    refused = command(mine.parent, "run", "--methods", "bc", "--envs", "swingup", *SMOKE, code=2)
    assert "holds cells of mine, which is of a plug-in" in refused
    assert (mine.parent / "results/latest/leaderboard.csv").read_bytes() == before


def recipe(page: str) -> tuple[str, str, str]:
    """The name of the page's file, what is in it, and the command that runs it."""
    text = (ROOT / page).read_text(encoding="utf-8")
    name, block = re.findall(r"<!-- the file (\S+) -->\n(.*?)<!-- end of the file -->", text, re.DOTALL)[0]
    (asked,) = re.findall(r"irl-bench (run --plugin my_method.py --methods linear,bc --envs swingup)\n", text)
    return name, block, asked


def test_the_recipe_works_word_for_word(tmp_path: Path) -> None:
    name, block, asked = recipe("README.md")
    assert recipe("docs/plugins.md") == (name, block, asked)
    (tmp_path / name).write_text(textwrap.dedent(block))
    assert sum(bool(line.strip()) for line in block.splitlines()) <= 10
    checked = command(tmp_path, "check", "linear", "--plugin", name)
    assert {line.split()[0] for line in checked.splitlines()} == {"ok"}
    command(tmp_path, *asked.split(), *SMOKE)
    scores = irl_bench.load(tmp_path / "results/latest").scores
    assert set(scores[scores.policy == "pi_star"].method) == {"linear", "bc"}
    assert set(scores[scores.policy == "pi_star"].status) == {"ok"}


def test_a_package_that_is_installed_is_found_by_its_metadata(tmp_path: Path) -> None:
    site = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    install += ["--no-index", "--target", str(site)]
    source = tmp_path / "source"
    source.mkdir()
    for file in SAMPLE.glob("*.*"):
        (source / file.name).write_bytes(file.read_bytes())
    subprocess.run([*install, str(source)], check=True, capture_output=True)
    path = f"{site}{os.pathsep}{ROOT}"
    listed = command(tmp_path, "list", PYTHONPATH=path)
    assert "still        " in listed.partition("methods of plug-ins:")[2] or "  still" in listed
    assert "of the package irl-bench-sample 0.3" in listed
    assert "not usable: irl-bench-sample 0.3: no plug-in may name its method 'bc'" in listed
    asked = ("--methods", "still", "--envs", "slow_swingup", *SMOKE, "--out", "run")
    told = command(tmp_path, "run", *asked, PYTHONPATH=path)
    assert "2 cells to run" in told
    scores = irl_bench.load(tmp_path / "run").scores
    assert set(scores[scores.policy == "pi_star"].status) == {"ok"}
    broken = command(tmp_path, "run", "--methods", "broken", "--envs", "swingup", PYTHONPATH=path, code=2)
    assert "the method broken cannot be loaded: AttributeError" in broken


def test_experts_of_a_task_of_gymnasium_are_trained_for_runs(tmp_path: Path) -> None:
    """A run finds the one that was trained, and trains none."""
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}

    def told(*words: str) -> str:
        command = [sys.executable, "-m", "harness", *words]
        return subprocess.run(command, env=env, check=True, capture_output=True, text=True).stdout

    out = told("experts", "train", "gym:Pendulum-v1", "--budget", "smoke", "--seeds", "1")
    assert re.fullmatch(
        r"gym_Pendulum-v1, seed 0: mean return -\d+\.\d\d, .*; 600 steps of RL in \d+ s\n", out
    )
    (trained,) = (tmp_path / "cache").glob("expert*")
    before = trained.stat().st_mtime_ns
    common = ("--envs", "gym:Pendulum-v1", "--budget", "smoke", "--no-retrain", "--record", "none")
    told("run", "--methods", "bc", *common, "--out", str(tmp_path / "run"))
    assert [*(tmp_path / "cache").glob("expert*")] == [trained]
    assert trained.stat().st_mtime_ns == before
