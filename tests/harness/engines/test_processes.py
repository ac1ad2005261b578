"""The processes that cells run in: their environment, what they share, and what is left of them."""

import json
import os
import random
from pathlib import Path

import psutil
import pytest

from harness.engines.inline import Inline
from harness.engines.server import Server
from harness.process.environment import CACHE_VARIABLE, FIXED, SAME_INSTRUCTIONS
from harness.records import Cell
from harness.registry import BadInput
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
    before, folders = os.environ.copy(), set()
    others = {*psutil.Process().children(recursive=True)}  # such as a browser of other tests
    for deterministic in (True, False):
        variables = json.loads(prepared(tmp_path, VARIABLES, deterministic)["variables"])
        assert variables["XLA_FLAGS"] == (SAME_INSTRUCTIONS if deterministic else FIXED)["XLA_FLAGS"]
        folders.add(variables["TMPDIR"])
        assert {*psutil.Process().children(recursive=True)} <= others
        assert os.environ == before
    assert len(folders) == 2
    assert not any(map(os.path.exists, folders))


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
    monkeypatch.setenv(COMPILED_VARIABLE, "mine")
    assert compiled_once()[COMPILED_VARIABLE] == "mine"


def test_where_the_cache_cannot_be_written_to_a_run_compiles_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(COMPILED_VARIABLE, raising=False)
    (tmp_path / "cache").write_text("a file")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    assert compiled_once(tmp_path / "spare")[COMPILED_VARIABLE] == str(tmp_path / "spare")
    assert compiled_once() == {}


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


def test_where_processes_cannot_be_forked_one_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "fork")
    with pytest.raises(BadInput, match="this system cannot fork processes; add --engine inline"):
        Server(os.environ, [])


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
