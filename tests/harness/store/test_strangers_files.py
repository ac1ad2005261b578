"""What a stranger's run may hold, and what every command that reads one makes of it."""

import dataclasses
import json
import math
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import irl_bench
from harness.api import exported
from harness.cli.main import main
from harness.recordings import viewer as view
from harness.records import LEARNED, Cell
from harness.registry import BadInput
from harness.store.artifacts import artifact
from harness.store.files import SUMS, sha256_of
from harness.store.opening import open_for_run
from methods.network import Network
from tests.harness.small_runs import (
    CONDITIONS,
    NAME,
    RECORDING,
    REQUEST,
    damage,
    delete,
    execute,
    recorded,
    result,
    run,
    snapshot,
    store,
    stored,
)

__all__ = ["run"]

ROOT = Path(__file__).parents[3]
OUTSIDE = ("../outside", "/tmp/irl-bench-outside", "..")
CELL = Cell("cartpole", "bc", 0)
OTHER = "cartpole__gail__seed0"
BOTH = dataclasses.replace(REQUEST, methods=("bc", "gail"))


@pytest.fixture
def unreported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run with a recording, without a report, and with a stand-in for rerun's page, which is 43 MB."""
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "widget.js").write_text(f"a {view.OPEN} b {view.CLOSE} c")
    (parts / "re_viewer_bg.wasm").write_text("wasm")
    monkeypatch.setattr(view, "_parts", lambda: parts)
    path = tmp_path / "recorded"
    with open_for_run(path, REQUEST) as directory:
        directory.save(*recorded())
    return path


def test_a_recording_that_is_no_file_of_the_run_is_neither_copied_nor_served(
    unreported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "serve", lambda *its: pytest.fail("it is served"))
    secret, folder = b"a private key", unreported / "recordings"
    (tmp_path / RECORDING).write_bytes(secret)
    store(unreported, stored(unreported) | {"recordings": {RECORDING: sha256_of(secret)}})
    (folder / RECORDING).unlink()
    (folder / RECORDING).symlink_to(tmp_path / RECORDING)
    for behind_a_folder in (False, True):
        if behind_a_folder:
            shutil.rmtree(folder)
            folder.symlink_to(tmp_path)
        for words in (["--export", str(tmp_path / "new/page")], ["--web"]):
            assert main(["view", str(unreported), *words]) == 2
            assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_only_recordings_as_they_were_written_are_exported_and_never_through_a_link(
    unreported: Path, tmp_path: Path
) -> None:
    export = ["view", str(unreported), "--export"]
    assert main([*export, str(tmp_path / "page")]) == 0
    assert (tmp_path / "page/recordings" / RECORDING).read_bytes() == b"a recording"
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "empty")
    before = snapshot(tmp_path)
    assert main([*export, str(tmp_path / "link")]) == 2
    assert snapshot(tmp_path) == before
    (unreported / "recordings" / RECORDING).write_bytes(b"another one")
    assert main([*export, str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


def of_policy(cell: Cell, level: float) -> bytes:
    layers = (np.full((4, 1), level),), (np.zeros(1),)
    policy = Network(np.zeros(4), np.ones(4), *layers, tanh=True)
    return artifact(cell, CONDITIONS, {"pi_star": policy, "reward": None})[0]


@pytest.fixture
def learned(tmp_path: Path) -> Path:
    """A run of two cells with artifacts."""
    path = tmp_path / "learned"
    with open_for_run(path, BOTH) as directory:
        for method, level in (("bc", 1.0), ("gail", 2.0)):
            found = result(method)
            data = of_policy(found.cell, level)
            directory.save(dataclasses.replace(found, learned=sha256_of(data)), {LEARNED: data})
    return path


def artifact_of_another_cell(run: Path) -> None:
    ((data,),) = execute(run, "SELECT data FROM learned WHERE name = ?", OTHER)
    store(run, data, NAME, "learned")


def artifact_without_numbers(run: Path) -> None:
    store(run, of_policy(CELL, math.nan), NAME, "learned")


def cell_with_another_artifact(run: Path) -> None:
    """Even its own checksums are right."""
    artifact_of_another_cell(run)
    store(run, stored(run) | {"learned": stored(run, OTHER)["learned"]})


def cell_of_another_name(run: Path) -> None:
    store(run, stored(run, OTHER), NAME)


@pytest.mark.parametrize(
    "harm",
    [
        artifact_of_another_cell,
        artifact_without_numbers,
        cell_with_another_artifact,
        cell_of_another_name,
        damage,
    ],
)
def test_what_is_not_as_it_was_written_is_not_exported(
    learned: Path, harm: Callable[[Path], None], tmp_path: Path
) -> None:
    exported.export(learned, "cartpole", "bc", to=tmp_path / "before")
    harm(learned)
    with pytest.raises(BadInput) as told:
        exported.export(learned, "cartpole", "bc", to=tmp_path / "to")
    assert "\n" not in str(told.value)
    assert not (tmp_path / "to").exists()


def test_tables_that_are_not_as_they_were_written_are_not_loaded(run: Path) -> None:
    assert len(irl_bench.load(run).scores) == 1
    for name in ("scores.csv", "leaderboard.csv"):
        whole = (run / name).read_bytes()
        (run / name).write_bytes(whole.replace(b"1.0", b"9.0"))
        with pytest.raises(BadInput, match=f"{name}: its checksum does not match"):
            irl_bench.load(run)
        (run / name).write_bytes(whole)
    delete(run, "report", "run")
    with pytest.raises(BadInput, match=r"scores\.csv: it has no checksum"):
        irl_bench.load(run)


def test_parts_of_two_exports_are_no_export(learned: Path, tmp_path: Path) -> None:
    one, other = (exported.export(learned, "cartpole", m, to=tmp_path / m) for m in ("bc", "gail"))
    exported.load_learned(one)
    shutil.copyfile(other / "policy.safetensors", one / "policy.safetensors")
    with pytest.raises(BadInput, match="is not the one that was exported with it"):
        exported.load_learned(one)
    facts = json.loads((other / exported.FACTS).read_text())
    (other / exported.FACTS).write_text(json.dumps(facts | {"env": "swingup"}))
    with pytest.raises(BadInput, match=r"learned\.json is not as it was written"):
        exported.load_learned(other)


def test_verify_names_each_damage_once_and_what_no_checksum_covers(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, mine = run / "recordings" / RECORDING, [run / "notes.txt", run / "recordings/mine.rrd"]
    for file in mine:
        file.write_text("mine")
    uncovered = [f"{file}: covered by no checksum" for file in mine]
    capsys.readouterr()
    assert main(["verify", str(run)]) == 0
    whole = f"{run}: every file that has a checksum is as it was written"
    assert capsys.readouterr().out.splitlines() == [*uncovered, whole]
    recording.write_text("{")
    for name in ("scores.csv", SUMS):
        (run / name).unlink()
    assert main(["verify", str(run)]) == 1
    damaged = [f"{recording}: its checksum does not match"]
    damaged += [f"{run / name}: missing" for name in ("scores.csv", SUMS)]
    told = capsys.readouterr().out.splitlines()
    assert (sorted(told[:-2]), told[-2:]) == (sorted(damaged), uncovered)


class Payload:
    """Whoever unpickles it makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.marker,)


def test_a_strangers_run_is_read_and_never_executed(run: Path, tmp_path: Path) -> None:
    payload = pickle.dumps(Payload(tmp_path / "executed"))
    pickle.loads(payload)
    (tmp_path / "executed").unlink()  # raises if it had done nothing
    for number, name in enumerate(OUTSIDE):
        store(run, payload, name)
        store(run, payload, name, "learned")
        for kind in ("env", "method"):
            cell = stored(run)
            cell["cell"][kind] = cell["rows"][0][kind] = name
            store(run, cell, f"cartpole__{kind}{number}__seed0")
    execute(run, "UPDATE cells SET data = ? WHERE name = '..'", "[" * 100_000)
    for name in ("cell.pkl", "recordings/a.rrd", "run.log", "model.pt"):
        (run / name).write_bytes(payload)
    before = snapshot(tmp_path).keys()
    for words, code in ((["report"], 1), (["verify"], 1), (["compare", str(run)], 0)):
        command = [sys.executable, "-m", "harness", *words, str(run)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == code
        assert all(name in done.stderr + done.stdout for name in ("a plain name", "no JSON of a run"))
    assert (run / "leaderboard.md").read_text().count("| bc |") == 2  # scores, and costs
    assert snapshot(tmp_path).keys() == before
    assert not Path(OUTSIDE[1]).exists()
