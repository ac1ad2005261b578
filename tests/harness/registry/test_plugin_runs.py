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


def statuses(run: Path) -> dict[str, str]:
    """Return the statuses of pi* by method."""
    scores = irl_bench.load(run).scores
    stars = scores[scores.policy == "pi_star"]
    return dict(zip(stars.method, stars.status, strict=True))


def test_a_plugin_is_computed_beside_what_is_built_in(mine: Path) -> None:
    def run(*words: str, code: int = 0) -> str:
        return command(mine.parent, "run", "--envs", "swingup", *SMOKE, *words, code=code)

    assert "3 cells to run" in run("--plugin", "mine.py", "--methods", "bc,plugins")
    assert statuses(mine.parent / "results/latest") == {"bc": "ok", "mine": "ok"}
    # It is edited: its own cell is computed anew, and no other.
    mine.write_text(MINE.replace("30", "40"))
    told = run("--plugin", "mine.py", "--methods", "bc,mine")
    assert "1 cells to run, 2 kept from before" in told
    # Without the plug-in what it computed would be dropped from the board.
    before = (mine.parent / "results/latest/leaderboard.csv").read_bytes()
    assert "holds cells of mine, which is of a plug-in" in run("--methods", "bc", code=2)
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
    assert statuses(tmp_path / "results/latest") == {"linear": "ok", "bc": "ok"}


def test_a_package_that_is_installed_is_found_by_its_metadata_and_imported_when_asked_for(
    tmp_path: Path,
) -> None:
    site, source = tmp_path / "site", tmp_path / "source"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    install += ["--no-index", "--target", str(site), str(source)]
    source.mkdir()
    for file in SAMPLE.glob("*.*"):
        (source / file.name).write_bytes(file.read_bytes())
    subprocess.run(install, check=True, capture_output=True)
    path = f"{site}{os.pathsep}{ROOT}"
    listed = command(tmp_path, "list", PYTHONPATH=path)
    assert "  still" in listed.partition("methods of plug-ins:")[2]
    assert "of the package irl-bench-sample 0.3" in listed
    assert "not usable: irl-bench-sample 0.3: no plug-in may name its method 'bc'" in listed
    asked = ("--methods", "still", "--envs", "slow_swingup", *SMOKE, "--out", "run")
    assert "2 cells to run" in command(tmp_path, "run", *asked, PYTHONPATH=path)
    assert statuses(tmp_path / "run") == {"still": "ok"}
    broken = command(tmp_path, "run", "--methods", "broken", "--envs", "swingup", PYTHONPATH=path, code=2)
    assert "the method broken cannot be loaded: AttributeError" in broken
