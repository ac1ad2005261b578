"""The processes that cells run in: their environment, what they share, and what is left of them."""

import json
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from harness.engines.scratch import PREFIX, scratch_folder
from harness.process.environment import FIXED, SAME_INSTRUCTIONS
from harness.records import Cell
from tests.harness.fake_runs import compute, prepared

VARIABLES = """
import json, os

def prepare(cells, conditions):
    return {"variables": json.dumps(dict(os.environ)).encode()}
"""


def test_numbers_are_fixed_by_the_environment_and_nothing_of_a_process_is_left(tmp_path: Path) -> None:
    before, others = os.environ.copy(), {*psutil.Process().children(recursive=True)}
    for deterministic in (True, False):
        variables = json.loads(prepared(tmp_path, VARIABLES, deterministic)["variables"])
        assert variables["XLA_FLAGS"] == (SAME_INSTRUCTIONS if deterministic else FIXED)["XLA_FLAGS"]
        assert not os.path.exists(variables["TMPDIR"])
        assert {*psutil.Process().children(recursive=True)} <= others
        assert os.environ == before


def test_cells_of_one_process_find_it_as_it_was(tmp_path: Path) -> None:
    """A cell that draws from generators that all share, or leaves a thread, disturbs no other."""
    (tmp_path / "run").mkdir()
    cells = [Cell("cartpole", "draws", seed) for seed in range(2)] + [Cell("cartpole", "leaves_a_thread", 2)]
    compute(tmp_path / "run", [*cells, Cell("cartpole", "good", 3)])
    processes = (tmp_path / "run/computed.txt").read_text().split()[1::2]
    assert processes[0] == processes[1] == processes[2] != processes[3]
    draws = (tmp_path / "run/run.log").read_text().split("drawn: ")[1:]
    assert len({draw.partition("\n")[0] for draw in draws}) == 1
    assert str(random.random()) not in draws[0]


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for temporary files."""
    with tempfile.TemporaryDirectory(prefix="t-") as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


KILLED = """
import os, sys, tempfile
from harness.engines.scratch import scratch_folder

tempfile.tempdir = sys.argv[1]
with scratch_folder() as folder:
    (folder / "file").write_text("")
    print(folder, flush=True)
    input()
"""


def test_the_folder_of_a_live_run_is_left_alone_and_that_of_a_killed_one_deleted(temporary: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(temporary)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        folder = Path(process.stdout.readline().strip())
        with scratch_folder() as another:
            assert {*temporary.iterdir()} == {folder, another}
        process.kill()
    assert (folder / "file").exists()
    with scratch_folder() as another:
        assert {*temporary.iterdir()} == {another}
    assert list(temporary.iterdir()) == []


def test_anything_that_is_no_folder_of_this_user_is_left_alone(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("irl-bench-2026-results", "mine", f"{PREFIX}another-users"):
        (temporary / name).mkdir()
    (temporary / f"{PREFIX}file").write_text("mine")
    (temporary / f"{PREFIX}link").symlink_to(temporary / "mine")
    before = {*temporary.iterdir()}
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with scratch_folder() as folder:
        pass
    assert {*temporary.iterdir()} - {folder} == before
