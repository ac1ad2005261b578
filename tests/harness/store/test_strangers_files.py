"""What a stranger's run may hold, and what every command that reads one makes of it."""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import irl_bench
from harness import exported
from harness.cli import main
from harness.judge.results import Cell, artifact_of
from harness.registry import BadInput
from harness.run import baseline
from harness.run.environment import numeric
from harness.show import view
from harness.store.artifacts import artifact
from harness.store.codec import checksum
from harness.store.files import new_folder, opened_below, sha256, sha256_of
from harness.store.opening import open_for_run, open_to_verify
from harness.store.request import REQUEST as REQUEST_FILE
from harness.store.sums import SUMS, readable, why_damaged
from methods.network import Network
from tests.harness.small_runs import CONDITIONS, RECORDING, REQUEST, result, run, snapshot, strange

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
def recorded(tmp_path: Path) -> Path:
    """A run with a recording, and without a report."""
    path = tmp_path / "recorded"
    data = b"a recording"
    with open_for_run(path, REQUEST) as directory:
        found = dataclasses.replace(result(), recordings={RECORDING: sha256_of(data)})
        directory.save(found, {f"recordings/{RECORDING}": data})
    return path


def note(run: Path, name: str, digest: str) -> None:
    """The list of checksums says so."""
    with (run / SUMS).open("a") as sums:
        sums.write(f"{digest}  {name}\n")


def leads_away(run: Path, secret: Path, kind: str) -> None:
    """A recording of the run is something else, which the list of checksums calls right."""
    recording = run / "recordings" / RECORDING
    recording.unlink()
    match kind:
        case "link":
            recording.symlink_to(secret)
        case "pipe":
            os.mkfifo(recording)
        case "device":
            recording.symlink_to("/dev/zero")
        case "folder":
            recording.mkdir()
        case "large":
            with recording.open("wb") as file:
                file.truncate((1 << 30) + 1)
        case "folder of links":
            shutil.move(run / "recordings", secret.parent / "elsewhere")
            (secret.parent / "elsewhere" / RECORDING).write_bytes(SECRET)
            (run / "recordings").symlink_to(secret.parent / "elsewhere")
    note(run, f"recordings/{RECORDING}", sha256_of(SECRET))


@pytest.mark.parametrize("kind", ["link", "pipe", "device", "folder", "large", "folder of links"])
@pytest.mark.usefixtures("viewer")
def test_a_recording_that_is_no_file_of_the_run_is_neither_copied_nor_served(
    recorded: Path,
    secret: Path,
    kind: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(view, "serve", lambda *its: pytest.fail("it is served"))
    leads_away(recorded, secret, kind)
    new = secret.parent / "new"
    for words in (["--export", str(new / "page")], ["--web"]):
        assert main(["view", str(recorded), *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not new.exists()


@pytest.mark.usefixtures("viewer")
def test_only_recordings_as_they_were_written_are_exported(recorded: Path, tmp_path: Path) -> None:
    assert main(["view", str(recorded), "--export", str(tmp_path / "page")]) == 0
    assert (tmp_path / "page/recordings" / RECORDING).read_bytes() == b"a recording"
    (recorded / "recordings" / RECORDING).write_bytes(b"another one")
    assert main(["view", str(recorded), "--export", str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


def read_below(*its: Any) -> bytes:
    with opened_below(*its) as file:
        return file.read()


def test_no_link_below_a_folder_is_followed(tmp_path: Path, secret: Path) -> None:
    (tmp_path / "run/a").mkdir(parents=True)
    (tmp_path / "run/a/file").write_text("mine")
    (tmp_path / "run/link").symlink_to(secret)
    (tmp_path / "run/folder").symlink_to(tmp_path / "run/a")
    assert read_below(tmp_path / "run", "a/file") == b"mine"
    for name in ("link", "folder/file", "../secret", str(secret), "a/../../secret", "a", "none", "", "x\0"):
        with pytest.raises(OSError, match=r"link|leads out|no regular|No such|null"):
            read_below(tmp_path / "run", name)
    with pytest.raises(OSError, match="larger than"):
        read_below(tmp_path / "run", "a/file", 3)


def interrupted(target: Path) -> None:
    with new_folder(target) as folder:
        (folder / "half").write_text("half")
        raise KeyboardInterrupt


def test_a_folder_that_cannot_be_filled_is_not_left(tmp_path: Path, secret: Path) -> None:
    for there in (False, True):
        target = tmp_path / "deep/er/page"
        if there:
            target.mkdir(parents=True)
        with pytest.raises(KeyboardInterrupt):
            interrupted(target)
        assert target.exists() == (tmp_path / "deep").exists() == there
        if there:
            assert [*target.iterdir()] == []
    with new_folder(target) as folder:
        (folder / "whole").write_text("whole")
    assert [file.name for file in target.iterdir()] == ["whole"]
    with new_folder(tmp_path / "another/one") as folder:
        (folder / "whole").write_text("whole")
    assert [file.name for file in (tmp_path / "another").rglob("*")] == ["one", "whole"]


@pytest.mark.usefixtures("viewer")
def test_an_export_that_fails_leaves_nothing(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*its: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "page")

    monkeypatch.setattr("gzip.compress", full)
    assert main(["view", str(recorded), "--export", str(tmp_path / "new/page")]) == 2
    assert not (tmp_path / "new").exists()


@pytest.fixture
def learned(tmp_path: Path) -> Path:
    """A run with an artifact, and of two cells."""
    path = tmp_path / "learned"
    request = dataclasses.replace(REQUEST, methods=("bc", "gail"))
    with open_for_run(path, request) as directory:
        for method, level in (("bc", 1.0), ("gail", 2.0)):
            found = result(method)
            data, _ = artifact(found.cell, CONDITIONS, {"pi_star": policy(level), "reward": None})
            name = artifact_of(found.cell)
            digests = {name.partition("/")[2]: sha256_of(data)}
            directory.save(dataclasses.replace(found, artifacts=digests), {name: data})
    return path


def policy(level: float) -> Network:
    return Network(np.zeros(4), np.ones(4), (np.full((4, 1), level),), (np.zeros(1),), tanh=True)


def artifact_of_another_cell(run: Path) -> None:
    names = [artifact_of(Cell("cartpole", method, 0)) for method in ("bc", "gail")]
    (run / names[0]).write_bytes((run / names[1]).read_bytes())
    note(run, names[0], sha256(run / names[0]))


def artifact_without_numbers(run: Path) -> None:
    data, _ = artifact(Cell("cartpole", "bc", 0), CONDITIONS, {"pi_star": policy(math.nan), "reward": None})
    name = artifact_of(Cell("cartpole", "bc", 0))
    (run / name).write_bytes(data)
    note(run, name, sha256_of(data))


def cell_with_another_artifact(run: Path) -> None:
    """Even its own checksums are right."""
    artifact_of_another_cell(run)
    file, name = run / "cells/cartpole__bc__seed0.json", artifact_of(Cell("cartpole", "bc", 0))
    stored = json.loads(file.read_text())
    stored["result"]["artifacts"] = {Path(name).name: sha256(run / name)}
    file.write_text(json.dumps(stored | {"sha256": checksum(stored["result"])}))
    note(run, "cells/cartpole__bc__seed0.json", sha256(file))


def cell_changed(run: Path) -> None:
    strange(run, return_mean=999.0)


def list_without_the_cell(run: Path) -> None:
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if "cells/cartpole__bc" not in line))


def no_list(run: Path) -> None:
    (run / SUMS).unlink()


ARTIFACTS = (artifact_of_another_cell, artifact_without_numbers, cell_with_another_artifact)
CELLS = (cell_changed, list_without_the_cell, no_list)


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
    assert main(["compare", str(learned), str(learned)]) == (2 if damage is no_list else 0)
    assert "left out: " in (said := capsys.readouterr().err)
    assert "cartpole__bc__seed0.json" in said
    with open_to_verify(learned) as run:
        assert Cell("cartpole", "bc", 0) not in run.load()[0]
        assert run.damaged()
    request = dataclasses.replace(REQUEST, methods=("bc", "gail"))
    try:
        found, left_out = baseline.comparable([learned], request, numeric(True))
    except BadInput as error:
        found, left_out = [], [str(error)]
    assert Cell("cartpole", "bc", 0) not in {result.cell for result in found}
    assert any("cartpole__bc__seed0.json" in line for line in left_out)


def test_tables_that_are_not_as_they_were_written_are_not_loaded(run: Path) -> None:
    assert len(irl_bench.load(run).scores) == 1
    for name in ("scores.csv", "leaderboard.csv"):
        whole = (run / name).read_bytes()
        (run / name).write_bytes(whole.replace(b"1.0", b"9.0"))
        with pytest.raises(BadInput, match=f"{name}: its checksum does not match"):
            irl_bench.load(run)
        (run / name).write_bytes(whole)
    (run / SUMS).unlink()
    with pytest.raises(BadInput, match=f"{SUMS}: No such file"):
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


@pytest.mark.parametrize("leads", ["to an empty folder", "nowhere", "to the folder above"])
def test_nothing_is_exported_through_a_link(
    recorded: Path, learned: Path, tmp_path: Path, leads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    target = {"to an empty folder": tmp_path / "empty", "nowhere": tmp_path / "none"}.get(leads, tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(target)
    before = snapshot(tmp_path)
    asked = ["--env", "cartpole", "--method", "bc", "--to", str(tmp_path / "link")]
    for words in (
        ["export", str(learned), *asked],
        ["view", str(recorded), "--export", str(tmp_path / "link")],
    ):
        assert main(words) == 2
        assert "is there already" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_verify_names_each_damage_once_and_what_no_checksum_covers(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, figure = run / "recordings" / RECORDING, run / "figures/stale.png"
    figure.write_text("of an earlier version")
    (run / "figures/notes.txt").write_text("mine")
    assert main(["verify", str(run)]) == 0
    said = capsys.readouterr().out
    assert said.splitlines() == [
        f"{figure}: covered by no checksum",
        f"{run}: every file that has a checksum is as it was written",
    ]
    recording.write_text("{")
    assert main(["verify", str(run)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{recording}: its checksum does not match",
        f"{figure}: covered by no checksum",
    ]


def test_a_figure_that_is_not_drawn_any_more_goes_with_its_line(run: Path) -> None:
    stale, mine = run / "figures/stale.png", run / "figures/mine.png"
    for file in (stale, mine):
        file.write_text("a figure")
    note(run, "figures/stale.png", sha256(stale))
    note(run, "figures/mine.png", "0" * 64)
    note(run, "figures/../../mine.png", sha256(stale))
    (run.parent / "mine.png").write_text("a figure")
    assert main(["report", str(run)]) == 0
    assert not stale.exists()
    assert mine.exists()
    assert (run.parent / "mine.png").exists()
    assert main(["verify", str(run)]) == 0


def noted(run: Path, file: Path) -> str:
    return readable((run / SUMS).read_bytes())[file.relative_to(run).as_posix()]


def test_figures_of_committed_runs_are_those_of_their_reports() -> None:
    runs = [file.parent for file in (ROOT / "results/reference").rglob(REQUEST_FILE)]
    assert len(runs) > 30
    for path in runs:
        with open_to_verify(path) as run:
            assert run.uncovered() == [], path
        assert not [file for file in path.glob("figures/*") if why_damaged(file, noted(path, file))]
