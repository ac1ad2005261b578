"""Minari's datasets come in and go out bit by bit; what does not fit is refused in a line."""

import json
import os
import pickle
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pyarrow as pa
import pytest
from gymnasium import spaces
from pyarrow import parquet

from harness.cli import runs
from harness.cli.files import export_demonstrations
from harness.cli.main import main
from harness.demonstrations import recording
from harness.demonstrations.reading import read
from harness.demonstrations.units import SCALED
from harness.registry import SPECS
from tests.harness.demonstrations.made_demonstrations import CHOICES, SWINGUP, refused
from tests.harness.demonstrations.made_minari import FLAGS, FORMS, made, minari_folder
from tests.harness.small_runs import stored

UNTOLD = "does not tell the bounds of its actions; give them as --action-bounds"
pytestmark = pytest.mark.usefixtures("read_here", "own_cache")


@pytest.fixture(autouse=True)
def _no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)


def box(low: float, high: float) -> spaces.Box:
    return spaces.Box(low, high, (1,), np.float64)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_what_minari_writes_is_read_bit_by_bit(tmp_path: Path, form: str, kind: Any) -> None:
    there = made(kind)
    path = minari_folder(tmp_path / "d", form, **there)
    found = read(path, SWINGUP)
    for name, arrays in (
        ("obs", found.episodes.obs),
        ("act", found.episodes.act),
        ("rewards", found.rewards),
    ):
        assert all(map(np.array_equal, arrays or (), there[name]))
    assert found.episodes.terminated == (False, True, True)
    assert (found.form, found.guessed) == (f"Minari {form}", 0)
    assert read(path / "data", SWINGUP).digest == found.digest


@pytest.mark.parametrize("form", FORMS)
def test_choices_are_read(tmp_path: Path, form: str) -> None:
    there = made(spec=CHOICES)
    found = read(minari_folder(tmp_path / "d", form, **there, action_space=spaces.Discrete(2)), CHOICES)
    assert [act.argmax(axis=1).tolist() for act in found.episodes.act] == [a.tolist() for a in there["act"]]
    other = minari_folder(tmp_path / "other", form, **there, action_space=spaces.Discrete(2, start=1))
    refused(other, "its choices are numbered from 1 on, and the task's from 0 on", CHOICES)


def test_actions_are_scaled_by_the_bounds_of_their_space(tmp_path: Path) -> None:
    there = made()
    native = there | {"act": [2 * act for act in there["act"]]}

    def folder(name: str, low: float, high: float, episodes: Any = native) -> Path:
        return minari_folder(tmp_path / name, "parquet", **episodes, action_space=box(low, high))

    public, wide = folder("public", -2, 2), folder("wide", -4, 4)
    unbounded = folder("unbounded", -np.inf, np.inf)
    found = read(public, SWINGUP)
    assert all(map(np.array_equal, found.episodes.act, there["act"]))
    for path in (public, unbounded):
        assert read(path, SWINGUP, 2 * SCALED).digest == found.digest
    refused(public, "[-4, 4] contradicts the file, which says [-2, 2]", bounds=4 * SCALED)
    refused(wide, "its actions are in [-4, 4], and the task's in [-1, 1] or [-2, 2]; ")
    asked = read(wide, SWINGUP, 4 * SCALED)
    assert all(np.allclose(2 * act, its) for act, its in zip(asked.episodes.act, there["act"], strict=True))
    for path in (unbounded, folder("small", -np.inf, np.inf, there)):
        refused(path, UNTOLD)
    refused(folder("flat", 2, 2), "its actions are in [2, 2]")


def test_each_entry_of_an_action_has_its_own_bounds(tmp_path: Path) -> None:
    spec = SPECS["hopper"]
    there, scale = made(spec=spec, lengths=(4, 3)), np.array([1.0, 2.0, 0.5])
    native = there | {"act": [scale * act for act in there["act"]]}
    space = spaces.Box(-scale, scale, dtype=float)
    path = minari_folder(tmp_path / "d", "hdf5", **native, action_space=space)
    refused(path, "its actions are in [-1, 1] x [-2, 2] x [-0.5, 0.5], and the task's in [-1, 1]", spec)
    found = read(path, spec, np.array([-scale, scale]))
    assert all(map(np.array_equal, found.episodes.act, there["act"]))


@pytest.mark.parametrize("form", FORMS)
def test_endings_are_as_they_are_said(tmp_path: Path, form: str) -> None:
    neither = {name: np.zeros(5, bool) for name in FLAGS}
    both = {name: np.arange(5) == 4 for name in FLAGS}
    five, whole = made(lengths=(5,)), made(lengths=(200,))
    unended = minari_folder(tmp_path / "open", form, **five, **neither)
    refused(unended, "episode 0 neither terminated nor was cut where it ends, before the horizon")
    on = minari_folder(tmp_path / "on", form, **five, **neither | {"terminations": np.arange(5) >= 3})
    refused(on, "episode 0 goes on after it ended")
    ended = minari_folder(tmp_path / "both", form, **five, **both)
    never = minari_folder(tmp_path / "never", form, **whole, terminations=np.zeros(200, bool))
    last = minari_folder(tmp_path / "last", form, **whole, terminations=np.arange(200) == 199)
    terminated = [read(path, SWINGUP).episodes.terminated for path in (ended, never, last)]
    assert terminated == [(True,), (False,), (True,)]


@pytest.mark.parametrize("form", FORMS)
def test_what_is_no_row_of_numbers_is_refused(tmp_path: Path, form: str) -> None:
    there = made(lengths=(5,))
    (obs,), words = there["obs"], [str(i) for i in range(6)]
    unbounded = spaces.Box(-np.inf, np.inf, (3,), np.float64)
    odd = {
        "dictionary": ({"a": obs}, spaces.Dict({"a": unbounded})),
        "tuple": ((obs,), spaces.Tuple([unbounded])),
        "texts": (words, spaces.Text(9)),
        "images": (np.zeros((6, 32, 32, 3), np.uint8), spaces.Box(0, 255, (32, 32, 3), np.uint8)),
        "wide": (np.zeros((6, 4)), spaces.Box(-1, 1, (4,), np.float64)),
        "nan": (np.full((6, 3), np.nan), None),
    }
    for name, (seen, space) in odd.items():
        path = minari_folder(tmp_path / name, form, **there, observations=seen, observation_space=space)
        refused(path, "observations")
    flags = there | {"act": [np.zeros((5, 1), np.int64)]}
    refused(minari_folder(tmp_path / "multi", form, **flags, action_space=spaces.MultiDiscrete([2])), "Multi")
    huge = minari_folder(tmp_path / "huge", form, **there | {"act": [np.full((5, 1), 1e300)]})
    refused(huge, "by 1e+300 at most")


ODD_FACTS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no JSON": lambda facts: "{",
    "a list": lambda facts: "[]",
    "deep": lambda facts: "[" * 100_000,
    "no count": lambda facts: facts.pop("total_episodes"),
    "other steps": lambda facts: facts.update(total_steps=13),
    "none": lambda facts: facts.update(total_episodes=0),
    "more than there are": lambda facts: facts.update(total_episodes=4),
    "too many": lambda facts: facts.update(total_episodes=10**9),
    "true": lambda facts: facts.update(total_episodes=True),
    "a pickle": lambda facts: facts.update(data_format="pickle"),
    "a list of formats": lambda facts: facts.update(data_format=["hdf5"]),
    "a space of its own": lambda facts: facts.update(action_space={"type": "Box"}),
    "a space of texts": lambda facts: facts.update(action_space='{"type": "Box", "low": "x", "high": "y"}'),
    "an uneven space": lambda facts: facts.update(
        action_space='{"type": "Box", "low": [1, [2]], "high": [3]}'
    ),
    "no space": lambda facts: facts.pop("action_space"),
    "no numbers": lambda facts: facts.update(action_space='{"type": "Box", "low": [], "high": []}'),
    "other bounds": lambda facts: facts.update(action_space='{"type": "Box", "low": [0, 0], "high": [1, 1]}'),
}
OTHERS = "its bounds are of other actions"
REASONS = {
    "other steps": "tells of 13 steps, and its episodes have 12",
    "more than there are": "3",
    "no numbers": OTHERS,
    "other bounds": OTHERS,
    "no space": UNTOLD,
}


@pytest.mark.parametrize("form", FORMS)
def test_odd_descriptions_are_refused(tmp_path: Path, form: str) -> None:
    file = minari_folder(tmp_path / "d", form, **made(lengths=(5, 4, 3))) / "data/metadata.json"
    whole = file.read_text()
    for name, change in ODD_FACTS.items():
        facts = json.loads(whole)
        text = change(facts)
        file.write_text(text if name in ("no JSON", "a list", "deep") else json.dumps(facts))
        refused(tmp_path / "d", REASONS.get(name, "its metadata.json cannot be used: "))


@pytest.mark.parametrize("form", FORMS)
def test_links_pickles_and_more_than_is_read_are_refused(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = minari_folder(tmp_path / "d", form, **made(lengths=(5, 4)))
    file = "main_data.hdf5" if form == "hdf5" else f"0/part-0.{form}"
    linked = ["data", "data/metadata.json", f"data/{file}", *(["data/0"] if form != "hdf5" else [])]
    for number, name in enumerate(linked):
        shutil.copytree(path, copy := tmp_path / f"copy{number}")
        (copy / name).rename(tmp_path / f"elsewhere{number}")
        (copy / name).symlink_to(tmp_path / f"elsewhere{number}")
        refused(copy, "is a link")
    with monkeypatch.context() as patch:
        patch.setattr(recording, "LARGEST", 400)
        refused(path, "larger than")
    (path / "data" / file).write_bytes(pickle.dumps(made()))
    refused(path, "")
    (path / "data" / file).unlink()
    os.mkfifo(path / "data" / file)
    refused(path, "no regular file")


def test_few_bytes_of_parquet_stand_for_no_more_than_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = minari_folder(tmp_path / "d", "parquet", **made(lengths=(5,)))
    rows = 100_000
    column = pa.FixedSizeListArray.from_arrays(np.zeros(rows), 1)
    there = {"observations": column, "actions": column, "rewards": np.zeros(rows)}
    flags = dict.fromkeys(FLAGS, np.zeros(rows, bool))
    parquet.write_table(pa.table(there | flags), path / "data/0/part-0.parquet")
    monkeypatch.setattr(recording, "LARGEST", 1_000_000)
    refused(path, "it holds more than")


@pytest.mark.parametrize("spec", [SWINGUP, CHOICES], ids=lambda spec: spec.name)
def test_minari_reads_what_is_exported(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, spec: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "users")
    export = ["demos", "export", "--env", spec.name, "--demos", "3", "--to"]
    assert [main([*export, name]) for name in ("d.npz", "folder")] == [0, 0]
    out, err = capfd.readouterr()
    assert (out.count("\n"), err) == (2, "")
    assert os.environ["MINARI_DATASETS_PATH"] == "users"
    assert {path.name for path in tmp_path.iterdir()} <= {"cache", "d.npz", "folder"}
    known = read(tmp_path / "d.npz", spec)
    assert read(tmp_path / "folder", spec).digest == known.digest
    theirs = minari.MinariDataset(tmp_path / "folder/data")
    assert theirs.spec.dataset_id == f"irl-bench/{spec.name}/expert-v0"
    assert theirs.total_episodes == 3
    for i, episode in enumerate(theirs.iterate_episodes()):
        act = known.episodes.act[i]
        assert np.array_equal(episode.observations, known.episodes.obs[i])
        assert np.array_equal(episode.actions, act.argmax(axis=1) if spec.discrete else act)
        assert np.array_equal(episode.rewards, (known.rewards or ())[i])
        ends = (episode.terminations[-1], episode.truncations[-1])
        assert ends == (known.episodes.terminated[i], not known.episodes.terminated[i])
        assert all(theirs.action_space.contains(one) for one in episode.actions)
    assert main(["demos", "import", "folder", "--env", spec.name, "--to", "e.npz"]) == 0
    assert read(tmp_path / "e.npz", spec).digest == known.digest
    assert main([*export, "folder"]) == 2
    assert "is there already" in capfd.readouterr().err


def test_nothing_is_left_of_an_export_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "x")

    monkeypatch.setattr("minari.dataset._storages.arrow_storage.ParquetStorage.update_episodes", fail)
    with pytest.raises(OSError, match="No space left"):
        export_demonstrations(tmp_path / "folder", "swingup", 0, 1, "expert")
    assert {path.name for path in tmp_path.iterdir()} <= {"cache"}
    assert "MINARI_DATASETS_PATH" not in os.environ


def test_without_the_extra_one_line_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for form in FORMS:
        minari_folder(tmp_path / form, form, **made())
    for module in ("minari", "h5py"):
        monkeypatch.setitem(sys.modules, module, None)
    assert main(["demos", "inspect", str(tmp_path / "hdf5"), "--env", "swingup"]) == 2
    assert main(["demos", "export", "--env", "swingup", "--to", str(tmp_path / "folder")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == err.count("pip install 'irl-bench[minari]'") == 2
    assert not (tmp_path / "folder").exists()
    for form in ("parquet", "arrow"):  # which the program's own packages read
        assert main(["demos", "inspect", str(tmp_path / form), "--env", "swingup"]) == 0


def test_a_run_is_shown_a_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "handle_signals", lambda: None)
    monkeypatch.setattr("harness.schedule.grid.Grid.run", lambda self, cells: None)
    path, out = minari_folder(tmp_path / "d", "hdf5", **made()), tmp_path / "run"
    main(["run", "--methods", "bc", "--envs", "swingup", "--out", str(out), "--demos-from", str(path)])
    asked = stored(out, "request", "run")["conditions"]
    assert asked["demonstrations"] == str(read(path, SWINGUP))
