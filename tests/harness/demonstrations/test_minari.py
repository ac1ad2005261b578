"""Minari's datasets come in and go out bit by bit; what does not fit is refused in a line."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pytest
from gymnasium import spaces

from harness.cli.main import main
from harness.demonstrations.reading import read
from harness.demonstrations.recording import Reading
from harness.demonstrations.units import SCALED
from harness.registry import SPECS
from tests.harness.demonstrations.made_demonstrations import (
    CHOICES,
    FLAGS,
    FORMS,
    SWINGUP,
    made,
    minari_folder,
    refused,
)

UNTOLD = "does not tell the bounds of its actions; give them as --action-bounds"
pytestmark = pytest.mark.usefixtures("read_here", "own_cache")


@pytest.fixture(autouse=True)
def _no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_what_minari_writes_is_read_bit_by_bit(tmp_path: Path, form: str, kind: Any) -> None:
    episodes, rewards = made()
    result = read(path := minari_folder(tmp_path / "d", form, (episodes, rewards), kind=kind), SWINGUP)
    assert all(map(np.array_equal, result.episodes.obs, episodes.obs))
    assert all(map(np.array_equal, result.episodes.act, [act.astype(kind) for act in episodes.act]))
    assert all(map(np.array_equal, result.rewards or (), rewards))
    assert result.episodes.terminated == (False, True, True)
    assert (result.form, result.guessed) == (f"Minari {form}", 0)
    assert read(path / "data", SWINGUP).digest == result.digest


def test_choices_are_read_and_those_of_other_numbers_are_refused(tmp_path: Path) -> None:
    content = made(spec=CHOICES)
    result = read(minari_folder(tmp_path / "d", "hdf5", content, spaces.Discrete(2)), CHOICES)
    assert all(map(np.array_equal, result.episodes.act, content[0].act))
    other = minari_folder(tmp_path / "other", "parquet", content, spaces.Discrete(2, start=1))
    refused(other, "its choices are numbered from 1 on, and the task's from 0 on", CHOICES)


def test_actions_are_scaled_by_the_bounds_of_their_space(tmp_path: Path) -> None:
    """Each entry of an action by its own."""
    spec = SPECS["hopper"]
    scale = np.array([1.0, 2.0, 0.5])

    def folder(name: str, factor: float) -> Path:
        space = spaces.Box(-factor * scale, factor * scale, dtype=float)
        act = [one * scale for one in episodes.act]
        return minari_folder(tmp_path / name, "parquet", (episodes, rewards), space, actions=act[0])

    episodes, rewards = made((4,), (True,), spec)
    said = "its actions are in [-1, 1] x [-2, 2] x [-0.5, 0.5], and the task's in [-1, 1]"
    refused(path := folder("d", 1), said, spec)
    refused(path, "contradicts the file, which says [-1, 1] x", spec, SCALED)
    refused(unbounded := folder("unbounded", np.inf), UNTOLD, spec)
    for one in (path, unbounded):
        assert np.array_equal(read(one, spec, np.array([-scale, scale])).episodes.act[0], episodes.act[0])


@pytest.mark.parametrize("form", FORMS)
def test_endings_are_as_they_are_said(tmp_path: Path, form: str) -> None:
    neither = {name: np.zeros(5, bool) for name in FLAGS}
    both = {name: np.arange(5) == 4 for name in FLAGS}
    five, whole = made((5,), (False,)), made((200,), (False,))
    unended = minari_folder(tmp_path / "open", form, five, **neither)
    refused(unended, "episode 0 neither terminated nor was cut where it ends, before the horizon")
    on = minari_folder(tmp_path / "on", form, five, **neither | {"terminations": np.arange(5) >= 3})
    refused(on, "episode 0 goes on after it ended")
    ended = minari_folder(tmp_path / "both", form, five, **both)
    never = minari_folder(tmp_path / "never", form, whole, truncations=np.zeros(200, bool))
    last = minari_folder(tmp_path / "last", form, whole, terminations=np.arange(200) == 199)
    terminated = [read(path, SWINGUP).episodes.terminated for path in (ended, never, last)]
    assert terminated == [(True,), (False,), (True,)]


@pytest.mark.parametrize("form", FORMS)
def test_what_is_no_row_of_numbers_is_refused(tmp_path: Path, form: str) -> None:
    content = made((5,), (True,))
    images = np.zeros((6, 32, 32, 3), np.uint8), spaces.Box(0, 255, (32, 32, 3), np.uint8)
    path = minari_folder(tmp_path / "d", form, content, observations=images[0], observation_space=images[1])
    refused(path, "")


@pytest.mark.parametrize("form", FORMS)
def test_observations_of_a_dictionary_are_chosen_by_key(tmp_path: Path, form: str) -> None:
    content, sizes = made((5,), (True,)), {"angle": 2, "goal": 4, "rate": 1}
    seen = {"angle": content[0].obs[0][:, :2], "goal": np.zeros((6, 4)), "rate": content[0].obs[0][:, 2:]}
    space = spaces.Dict(
        {name: spaces.Box(-np.inf, np.inf, (size,), np.float64) for name, size in sizes.items()}
    )
    path = minari_folder(tmp_path / "d", form, content, observations=seen, observation_space=space)
    refused(path, "its observations are angle (2), goal (4), rate (1); give those of the task")
    result = read(path, SWINGUP, how=Reading(obs_keys=("angle", "rate")))
    np.testing.assert_array_equal(result.episodes.obs[0], content[0].obs[0])


ODD_FACTS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "other steps": (lambda facts: facts.update(total_steps=13), "tells of 13 steps"),
    "a pickle": (lambda facts: facts.update(data_format="pickle"), "its metadata.json cannot be used"),
    "no space": (lambda facts: facts.pop("action_space"), UNTOLD),
}


@pytest.mark.parametrize("name", ODD_FACTS)
def test_odd_descriptions_are_refused(tmp_path: Path, name: str) -> None:
    file = minari_folder(tmp_path / "d", "parquet", made((5, 4, 3))) / "data/metadata.json"
    facts = json.loads(file.read_text())
    change, why = ODD_FACTS[name]
    change(facts)
    file.write_text(json.dumps(facts))
    refused(tmp_path / "d", why)


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
    assert main([*export, "folder"]) == 2
    assert "is there already" in capfd.readouterr().err


def test_without_the_extra_one_line_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for form in FORMS:
        minari_folder(tmp_path / form, form, made())
    for module in ("minari", "h5py"):
        monkeypatch.setitem(sys.modules, module, None)
    assert main(["demos", "inspect", str(tmp_path / "hdf5"), "--env", "swingup"]) == 2
    assert main(["demos", "export", "--env", "swingup", "--to", str(tmp_path / "folder")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == err.count("pip install 'irl-bench[minari]'") == 2
    assert not (tmp_path / "folder").exists()
    for form in ("parquet", "arrow"):  # which the program's own packages read
        assert main(["demos", "inspect", str(tmp_path / form), "--env", "swingup"]) == 0
