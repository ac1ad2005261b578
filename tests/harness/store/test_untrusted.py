"""A run's directory from somebody else: nothing in it is executed, nothing outside it is written."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors import SafetensorError, safe_open

from harness.judge.results import Cell, CellResult, Conditions, Request, Row
from harness.run.environment import CACHE_VARIABLE
from harness.store.cache import Kept, cache_file, kept
from harness.store.codec import encode
from harness.store.opening import open_for_run
from harness.store.sums import SUMS

ROOT = Path(__file__).parents[3]
CONDITIONS = Conditions("smoke", "absorbing", "sbx")
OUTSIDE = ("../outside", "../../outside", "/tmp/irl-bench-outside", "..", "a/../../../outside")


class Payload:
    """Whoever unpickles it makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.marker,)


@pytest.fixture
def payload(tmp_path: Path) -> bytes:
    data = pickle.dumps(Payload(tmp_path / "executed"))
    pickle.loads(data)
    (tmp_path / "executed").unlink()  # raises if it had done nothing
    return data


def result(env: str = "cartpole", method: str = "bc") -> CellResult:
    row = Row(env, method, 0, "pi_star", "absorbing", episodes=1, return_mean=1.0, length_mean=1.0)
    return CellResult(Cell(env, method, 0), [row])


def harness(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "harness", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_strangers_run_is_read_and_never_executed(tmp_path: Path, payload: bytes) -> None:
    run = tmp_path / "deep/run"
    with open_for_run(run, Request(("bc",), ("cartpole",), (0,), CONDITIONS)) as opened:
        opened.save(result())
    bad = ["cartpole__pickle__seed0.json"]
    (run / "cells" / bad[0]).write_bytes(payload)
    for number, name in enumerate(OUTSIDE):
        for kind, stranger in (("env", result(env=name)), ("method", result(method=name))):
            bad.append(f"cartpole__{kind}{number}__seed0.json")
            (run / "cells" / bad[-1]).write_text(encode(stranger))
    for name in ("cells/cell.pkl", "recordings/a.rrd", "figures/a.png", "run.log", "model.pt"):
        (run / name).parent.mkdir(exist_ok=True)
        (run / name).write_bytes(payload)
    reported = harness("report", str(run))
    assert reported.returncode == 1
    assert all(name in reported.stderr for name in bad)
    assert "a plain name" in reported.stderr
    assert "it is no stored cell" in reported.stderr
    assert (run / "leaderboard.md").read_text().count("| bc |") == 2  # scores, and costs
    (run / SUMS).write_text("".join(f"{'0' * 64}  {name}\n" for name in OUTSIDE))
    verified = harness("verify", str(run))
    assert verified.returncode == 1
    assert all(name in verified.stdout for name in (*bad, "scores.csv", *OUTSIDE[:2]))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deep"]
    assert sorted(path.name for path in (tmp_path / "deep").iterdir()) == ["run"]
    assert not Path(OUTSIDE[2]).exists()


def test_a_strangers_expert_is_no_expert(
    tmp_path: Path, payload: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    path = cache_file("expert", "cartpole", "smoke")
    path.parent.mkdir()
    path.write_bytes(payload)
    with pytest.raises(SafetensorError), safe_open(path, framework="numpy"):
        pass
    mine = Kept({"x": np.ones(3)}, {})
    assert kept("expert", "cartpole", "smoke", lambda: mine) is mine
    assert os.listdir(tmp_path) == ["cache"]
