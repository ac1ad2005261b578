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

from harness.engines.cell_environment import as_in_cells
from harness.engines.inline import Inline
from harness.engines.scratch import PREFIX, scratch_folder
from harness.engines.server import Server
from harness.process.environment import CACHE_VARIABLE, FIXED, SAME_INSTRUCTIONS
from harness.records import Cell
from harness.store.cache import COMPILED_VARIABLE, compiled_once
from tests.harness.fake_runs import compute, prepared

VARIABLES = """
import json, os

def prepare(cells, conditions):
    return {"variables": json.dumps(dict(os.environ)).encode()}
"""
COMPILES = """
def prepare(cells, conditions):
    import jax

    events = []
    jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
    jax.jit(lambda x: x * 3 + 1)(2.0)
    return {"loaded": b"yes" if "/jax/compilation_cache/cache_hits" in events else b"no"}
"""


def test_nothing_of_them_is_left(tmp_path: Path) -> None:
    before, others = os.environ.copy(), {*psutil.Process().children(recursive=True)}
    for deterministic in (True, False):
        variables = json.loads(prepared(tmp_path, VARIABLES, deterministic)["variables"])
        assert variables["XLA_FLAGS"] == (SAME_INSTRUCTIONS if deterministic else FIXED)["XLA_FLAGS"]
        assert not os.path.exists(variables["TMPDIR"])
        assert {*psutil.Process().children(recursive=True)} <= others
        assert os.environ == before


def test_what_one_process_compiles_the_next_run_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(COMPILED_VARIABLE, raising=False)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    assert [prepared(tmp_path, COMPILES)["loaded"] for _ in range(2)] == [b"no", b"yes"]
    before = {*os.environ}
    with Inline():
        assert os.environ[COMPILED_VARIABLE] == str(*(tmp_path / "cache").iterdir())
    assert {*os.environ} == before
    (tmp_path / "file").touch()
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    assert compiled_once(tmp_path / "spare")[COMPILED_VARIABLE] == str(tmp_path / "spare")
    monkeypatch.setenv(COMPILED_VARIABLE, "mine")
    assert compiled_once()[COMPILED_VARIABLE] == "mine"


def test_a_server_knows_how_its_workers_ended() -> None:
    with Server(os.environ, []) as server:
        for number in (9, 15):
            pid, connection = server.fork()
            psutil.Process(pid).send_signal(number)
            assert server.exit_code(pid) == -number
            connection.close()
        pid, connection = server.fork()
        connection.close()  # of which the worker hears that there is no job
        assert server.exit_code(pid) == 0
        assert server.exit_code(pid) is None
    with pytest.raises((OSError, EOFError)):
        server.fork()


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
    os.mkfifo(temporary / f"{PREFIX}pipe")
    (temporary / f"{PREFIX}link").symlink_to(temporary / "mine")
    before = sorted(temporary.rglob("*"))
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with scratch_folder():
        pass
    left = {path.name for path in temporary.iterdir()} - {path.name for path in before}
    assert all(name.startswith(PREFIX) for name in left)
    assert {*before} <= {*temporary.rglob("*")}


def test_bench_keeps_what_it_cannot_cache_in_its_own_folder(temporary: Path) -> None:
    with as_in_cells():
        assert Path(tempfile.gettempdir()).parents[1] == temporary
    assert tempfile.gettempdir() == str(temporary)
