"""Runs on a Ray cluster: what is lost with a node or a driver is computed again, and all is as on one
machine."""

import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pandas as pd
import psutil
import pytest

from harness.benchmarks.local_cluster import LocalCluster, local_cluster
from harness.records import Cell, CellResult
from harness.store.codec import decode
from harness.store.database import FILE
from tests.harness.small_runs import execute

pytest.importorskip("ray", reason="of the extra irl-bench[ray]")
PLUGIN = Path(__file__).parents[1] / "odd_methods.py"
PATIENCE = 240.0
ASKED = ["--envs", "cartpole", "--budget", "smoke", "--no-retrain", "--record", "none"]


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with local_cluster(2) as started:
        yield started


def start(out: Path, *more: str) -> subprocess.Popen:
    return command("run", "--plugin", str(PLUGIN), *ASKED, "--out", str(out), *more)


def command(*words: str) -> subprocess.Popen:
    program, pipe = [sys.executable, "-m", "harness"], subprocess.PIPE
    environment = {**os.environ, "RAY_AUTH_MODE": "disabled"}
    return subprocess.Popen(
        [*program, *words], env=environment, stdout=pipe, stderr=subprocess.STDOUT, text=True
    )


def finish(process: subprocess.Popen, code: int) -> str:
    """Return what it printed, when it has ended with this exit code."""
    printed, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, printed
    return str(printed)


def wait_for(truth: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not truth():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def stored(out: Path) -> dict[Cell, CellResult]:
    """Return the stored results, without times."""
    if not (out / FILE).is_file():
        return {}
    try:
        results = [decode(data) for (data,) in execute(out, "SELECT data FROM cells")]
    except sqlite3.OperationalError:  # it has no tables yet
        return {}
    timeless = [[replace(row, fit_seconds=0.0) for row in result.rows] for result in results]
    pairs = zip(results, timeless, strict=True)
    return {it.cell: replace(it, rows=rows, seconds={}, finished="") for it, rows in pairs}


def test_a_lost_node_and_a_lost_driver_lose_no_row(cluster: LocalCluster, tmp_path: Path) -> None:
    """8 cells. The driver is killed after a quarter of them and started again, and after half of them a node
    is killed without grace; all are as on this machine, bit for bit."""
    asked = ["--methods", "line", "--seeds", "4"]
    on_ray = [*asked, "--engine", "ray", "--address", cluster.address]
    first = start(tmp_path / "there", *on_ray)
    wait_for(lambda: len(stored(tmp_path / "there")) >= 2)
    first.kill()
    first.communicate()
    kept = len(stored(tmp_path / "there"))
    second = start(tmp_path / "there", *on_ray)
    wait_for(lambda: len(stored(tmp_path / "there")) >= 4)
    cluster.kill_node()
    assert f"{8 - kept} cells to run, {kept} kept from before" in finish(second, 0)
    finish(start(tmp_path / "here", *asked), 0)
    assert len(stored(tmp_path / "there")) == 8
    there, here = (sorted(map(repr, stored(tmp_path / name).values())) for name in ("there", "here"))
    assert there == here  # NaN equals NaN


def test_a_search_has_the_same_trials_as_on_this_machine(cluster: LocalCluster, tmp_path: Path) -> None:
    asked = ["--methods", "bc", "--envs", "cartpole", "--seeds", "100-100", "--trials", "1"]
    asked += ["--budget", "smoke", "--no-retrain"]
    tables = []
    for name, engine in (("there", ["--engine", "ray", "--address", cluster.address]), ("here", [])):
        storage = tmp_path / f"{name}.db"
        finish(command("tune", *asked, "--storage", str(storage), *engine), 0)
        tables.append(pd.read_csv(f"{storage}.csv").drop(columns="seconds"))
    assert tables[0]["trial"].tolist() == [-1, 0]
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_a_cell_that_hangs_is_a_failed_row(cluster: LocalCluster, tmp_path: Path) -> None:
    asked = ["--methods", "line,hangs", "--cell-timeout", "10"]
    finish(start(tmp_path / "run", *asked, "--engine", "ray", "--address", cluster.address), 1)
    rows = {cell.method: result.rows[0] for cell, result in stored(tmp_path / "run").items()}
    status = {"reference": "ok", "line": "ok", "hangs": "failed"}
    assert {name: row.status for name, row in rows.items()} == status
    assert rows["hangs"].reason == "it was stopped after 10 s"


@pytest.fixture
def hanging(tmp_path: Path) -> Iterator[tuple[subprocess.Popen, list[psutil.Process]]]:
    """A run whose last cell hangs, on a cluster of its own, and its processes."""
    run = start(tmp_path / "run", "--methods", "hangs", "--engine", "ray", "--workers", "2")
    wait_for(lambda: len(stored(tmp_path / "run")) == 1)
    yield run, psutil.Process(run.pid).children(recursive=True)
    if run.poll() is None:
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=PATIENCE)


def test_a_cluster_of_this_machine_listens_on_loopback_and_goes_with_its_run(
    hanging: tuple[subprocess.Popen, list[psutil.Process]],
) -> None:
    run, descendants = hanging
    listening = set()
    for process in descendants:
        with suppress(psutil.NoSuchProcess):
            connections = process.net_connections("inet")
            listening |= {one.laddr.ip for one in connections if one.status == psutil.CONN_LISTEN}
    assert listening <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}
    assert listening
    run.send_signal(signal.SIGINT)
    assert "Traceback" not in finish(run, 130)
    _, alive = psutil.wait_procs(descendants, timeout=30)
    assert not alive


def test_a_lost_head_ends_the_run_with_a_line_its_report_and_nothing_left(
    tmp_path: Path, hanging: tuple[subprocess.Popen, list[psutil.Process]]
) -> None:
    run, descendants = hanging
    (head,) = [process for process in descendants if process.name() == "gcs_server"]
    head.kill()
    printed = finish(run, 1)
    line = r"^the head of the Ray cluster at .* is lost; .*the same command goes on$"
    assert len(re.findall(line, printed, re.M)) == 1
    assert "not computed yet, or gone: cartpole__hangs__seed0" in printed
    assert "Traceback" not in printed
    assert (tmp_path / "run" / "scores.csv").exists()
    _, alive = psutil.wait_procs(descendants, timeout=5)
    assert not alive


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("127.0.0.1:1", "no Ray cluster answers at 127.0.0.1:1: "),
        ("nonsense:words", "--address is HOST:PORT of the head of a Ray cluster"),
    ],
)
def test_an_address_without_a_cluster_is_refused_in_a_line(address: str, said: str, tmp_path: Path) -> None:
    asked = ["--methods", "line", "--engine", "ray", "--address", address]
    printed = finish(start(tmp_path / "run", *asked), 2)
    assert printed.startswith(f"irl-bench: error: {said}")
    assert printed.endswith("(docs/cluster.md)\n")
    assert printed.count("\n") == 1
    assert not (tmp_path / "run").exists()
