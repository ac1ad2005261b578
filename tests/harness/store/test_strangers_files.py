"""What a stranger's run may hold, and what every command that reads one makes of it."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import irl_bench
from harness.api import exported
from harness.cli.main import main
from harness.process.environment import numeric
from harness.recordings import viewer as view
from harness.records import LEARNED, Cell
from harness.registry import BadInput
from harness.store import baseline
from harness.store.artifacts import artifact
from harness.store.files import sha256_of
from harness.store.opening import open_for_run, open_to_verify
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
SECRET = b"a private key"
PARTS = {
    "widget.js": f"a {view.OPEN} b {view.CLOSE} c",
    "re_viewer_bg.wasm": "wasm",
}


@pytest.fixture
def viewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for rerun's page, which is 43 MB."""
    parts = tmp_path / "parts"
    parts.mkdir()
    for name, text in PARTS.items():
        (parts / name).write_text(text)
    monkeypatch.setattr(view, "_parts", lambda: parts)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    file = tmp_path / "secret"
    file.write_bytes(SECRET)
    return file


@pytest.fixture
def unreported(tmp_path: Path) -> Path:
    """A run with a recording, and without a report."""
    path = tmp_path / "recorded"
    with open_for_run(path, REQUEST) as directory:
        directory.save(*recorded())
    return path


def leads_away(run: Path, secret: Path, kind: str) -> None:
    """A recording of the run is something else, which its cell calls right."""
    recording = run / "recordings" / RECORDING
    recording.unlink()
    match kind:
        case "link":
            recording.symlink_to(secret)
        case "pipe":
            os.mkfifo(recording)
        case "large":
            with recording.open("wb") as file:
                file.truncate((1 << 30) + 1)
        case "folder of links":
            shutil.move(run / "recordings", secret.parent / "elsewhere")
            (secret.parent / "elsewhere" / RECORDING).write_bytes(SECRET)
            (run / "recordings").symlink_to(secret.parent / "elsewhere")
    store(run, stored(run) | {"recordings": {RECORDING: sha256_of(SECRET)}})


@pytest.mark.parametrize("kind", ["link", "pipe", "large", "folder of links"])
@pytest.mark.usefixtures("viewer")
def test_a_recording_that_is_no_file_of_the_run_is_neither_copied_nor_served(
    unreported: Path,
    secret: Path,
    kind: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(view, "serve", lambda *its: pytest.fail("it is served"))
    leads_away(unreported, secret, kind)
    new = secret.parent / "new"
    for words in (["--export", str(new / "page")], ["--web"]):
        assert main(["view", str(unreported), *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not new.exists()


@pytest.mark.usefixtures("viewer")
def test_only_recordings_as_they_were_written_are_exported(unreported: Path, tmp_path: Path) -> None:
    assert main(["view", str(unreported), "--export", str(tmp_path / "page")]) == 0
    assert (tmp_path / "page/recordings" / RECORDING).read_bytes() == b"a recording"
    (unreported / "recordings" / RECORDING).write_bytes(b"another one")
    assert main(["view", str(unreported), "--export", str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


@pytest.fixture
def learned(tmp_path: Path) -> Path:
    """A run with an artifact, and of two cells."""
    path = tmp_path / "learned"
    request = dataclasses.replace(REQUEST, methods=("bc", "gail"))
    with open_for_run(path, request) as directory:
        for method, level in (("bc", 1.0), ("gail", 2.0)):
            found = result(method)
            data, _ = artifact(found.cell, CONDITIONS, {"pi_star": policy(level), "reward": None})
            directory.save(dataclasses.replace(found, learned=sha256_of(data)), {LEARNED: data})
    return path


def policy(level: float) -> Network:
    return Network(np.zeros(4), np.ones(4), (np.full((4, 1), level),), (np.zeros(1),), tanh=True)


OTHER = "cartpole__gail__seed0"


def artifact_of_another_cell(run: Path) -> None:
    ((data,),) = execute(run, "SELECT data FROM learned WHERE name = ?", OTHER)
    store(run, data, NAME, "learned")


def artifact_without_numbers(run: Path) -> None:
    data, _ = artifact(Cell("cartpole", "bc", 0), CONDITIONS, {"pi_star": policy(math.nan), "reward": None})
    store(run, data, NAME, "learned")


def cell_with_another_artifact(run: Path) -> None:
    """Even its own checksums are right."""
    artifact_of_another_cell(run)
    store(run, stored(run) | {"learned": stored(run, OTHER)["learned"]})


def cell_of_another_name(run: Path) -> None:
    store(run, stored(run, OTHER), NAME)


ARTIFACTS = (artifact_of_another_cell, artifact_without_numbers, cell_with_another_artifact)
CELLS = (damage, cell_of_another_name)


@pytest.mark.parametrize("damage", [*ARTIFACTS, *CELLS])
def test_what_is_not_as_it_was_written_is_not_exported(
    learned: Path, damage: Callable[[Path], None], tmp_path: Path
) -> None:
    exported.export(learned, "cartpole", "bc", to=tmp_path / "before")
    damage(learned)
    with pytest.raises(BadInput) as told:
        exported.export(learned, "cartpole", "bc", to=tmp_path / "to")
    assert "\n" not in str(told.value)
    assert not (tmp_path / "to").exists()


@pytest.mark.parametrize("damage", CELLS)
def test_cells_that_are_not_as_they_were_written_are_compared_with_nothing(
    learned: Path, damage: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    damage(learned)
    assert main(["compare", str(learned), str(learned)]) == 0
    assert "left out: " in (said := capsys.readouterr().err)
    assert NAME in said
    with open_to_verify(learned) as run:
        assert Cell("cartpole", "bc", 0) not in run.load()[0]
        assert run.damaged()
    request = dataclasses.replace(REQUEST, methods=("bc", "gail"))
    try:
        found, left_out = baseline.comparable([learned], request, numeric(True))
    except BadInput as error:
        found, left_out = [], [str(error)]
    assert Cell("cartpole", "bc", 0) not in {result.cell for result in found}
    assert any(NAME in line for line in left_out)


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
    one, other = (
        exported.export(learned, "cartpole", method, to=tmp_path / method) for method in ("bc", "gail")
    )
    exported.load_learned(one)
    shutil.copyfile(other / "policy.safetensors", one / "policy.safetensors")
    with pytest.raises(BadInput, match="is not the one that was exported with it"):
        exported.load_learned(one)
    facts = json.loads((other / exported.FACTS).read_text())
    (other / exported.FACTS).write_text(json.dumps(facts | {"env": "swingup"}))
    with pytest.raises(BadInput, match=r"learned\.json is not as it was written"):
        exported.load_learned(other)


@pytest.mark.parametrize("leads", ["to an empty folder", "nowhere"])
def test_nothing_is_exported_through_a_link(
    unreported: Path, learned: Path, tmp_path: Path, leads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / ("empty" if "empty" in leads else "none"))
    before = snapshot(tmp_path)
    asked = ["--env", "cartpole", "--method", "bc", "--to", str(tmp_path / "link")]
    for words in (
        ["export", str(learned), *asked],
        ["view", str(unreported), "--export", str(tmp_path / "link")],
    ):
        assert main(words) == 2
        assert "is there already" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_verify_names_each_damage_once_and_what_no_checksum_covers(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, mine = run / "recordings" / RECORDING, [run / "notes.txt", run / "recordings/mine.rrd"]
    for file in mine:
        file.write_text("mine")
    uncovered = [f"{file}: covered by no checksum" for file in mine]
    assert main(["verify", str(run)]) == 0
    whole = f"{run}: every file that has a checksum is as it was written"
    assert capsys.readouterr().out.splitlines() == [*uncovered, whole]
    recording.write_text("{")
    assert main(["verify", str(run)]) == 1
    damaged = f"{recording}: its checksum does not match"
    assert capsys.readouterr().out.splitlines() == [damaged, *uncovered]
