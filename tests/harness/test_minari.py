"""Minari's datasets come in and go out bit by bit; what does not fit is refused in a line."""

import json
import os
import pickle
import shutil
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import minari
import numpy as np
import pyarrow as pa
import pytest
from gymnasium import spaces
from pyarrow import parquet

from harness import commands, demonstration_forms
from harness import demonstrations as demos
from harness.cli import main
from harness.registry import SPECS, BadInput
from harness.run.environment import CACHE_VARIABLE
from tests.harness.made_minari import FORMS, minari_folder
from tests.harness.small_runs import stored as asked

FLAGS = ("terminations", "truncations")
SWINGUP, CHOICES = SPECS["swingup"], SPECS["cartpole_discrete"]


pytestmark = pytest.mark.usefixtures("read_here")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)


def made(
    kind: Any = np.float64, spec: Any = SWINGUP, lengths: tuple[int, ...] = (200, 7, 3)
) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    act = [spec.random_actions(n, rng).astype(kind) for n in lengths]
    return {
        "obs": [rng.uniform(-0.4, 0.4, (n + 1, spec.obs_size)).astype(kind) for n in lengths],
        "act": [one.argmax(axis=1) for one in act] if spec.discrete else act,
        "ended": [n < 200 for n in lengths],
        "rewards": [rng.normal(size=n) for n in lengths],
    }


def refused(path: Path, why: str, spec: Any = SWINGUP) -> None:
    with pytest.raises(BadInput, match="no demonstrations of ") as error:
        demos.read(path, spec)
    assert str(error.value).isprintable()
    assert why in str(error.value)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_what_minari_writes_is_read_bit_by_bit(tmp_path: Path, form: str, kind: Any) -> None:
    there = made(kind)
    path = minari_folder(tmp_path / "d", form, **there)
    found = demos.read(path, SWINGUP)
    assert all(map(np.array_equal, found.episodes.obs, there["obs"]))
    assert all(map(np.array_equal, found.episodes.act, there["act"]))
    assert found.rewards is not None
    assert all(map(np.array_equal, found.rewards, there["rewards"]))
    assert found.episodes.terminated == (False, True, True)
    assert (found.form, found.guessed) == (f"Minari {form}", 0)
    assert demos.read(path / "data", SWINGUP).digest == found.digest


@pytest.mark.parametrize("form", FORMS)
def test_choices_are_read(tmp_path: Path, form: str) -> None:
    there = made(spec=CHOICES)
    found = demos.read(minari_folder(tmp_path / "d", form, **there, action_space=spaces.Discrete(2)), CHOICES)
    assert [act.argmax(axis=1).tolist() for act in found.episodes.act] == [a.tolist() for a in there["act"]]
    other = minari_folder(tmp_path / "other", form, **there, action_space=spaces.Discrete(2, start=1))
    refused(other, "its choices are numbered from 1 on, and the task's from 0 on", CHOICES)


@pytest.mark.parametrize("form", FORMS)
def test_actions_are_scaled_by_the_bounds_of_their_space(tmp_path: Path, form: str) -> None:
    there = made()
    native = there | {"act": [2 * act for act in there["act"]]}
    found = demos.read(minari_folder(tmp_path / "d", form, **native, action_space=box(-2, 2)), SWINGUP)
    assert all(map(np.array_equal, found.episodes.act, there["act"]))
    assert demos.read(tmp_path / "d", SWINGUP, (-2.0, 2.0)).digest == found.digest
    with pytest.raises(BadInput, match=r"\[-4, 4\] contradicts the file, which says \[-2, 2\]"):
        demos.read(tmp_path / "d", SWINGUP, (-4.0, 4.0))
    wide = minari_folder(tmp_path / "wide", form, **native, action_space=box(-4, 4))
    refused(wide, "its actions are in [-4, 4], and the task's in [-1, 1] or [-2, 2]; ")
    asked = demos.read(wide, SWINGUP, (-4.0, 4.0))
    assert all(np.allclose(2 * act, its) for act, its in zip(asked.episodes.act, there["act"], strict=True))
    unbounded = minari_folder(tmp_path / "unbounded", form, **native, action_space=box(-np.inf, np.inf))
    refused(unbounded, "does not tell the bounds of its actions; give them as --action-bounds")
    small = minari_folder(tmp_path / "small", form, **there, action_space=box(-np.inf, np.inf))
    refused(small, "does not tell the bounds of its actions; give them as --action-bounds")
    assert demos.read(unbounded, SWINGUP, (-2.0, 2.0)).digest == found.digest
    refused(
        minari_folder(tmp_path / "flat", form, **native, action_space=box(2, 2)), "its actions are in [2, 2]"
    )


def box(low: float, high: float) -> spaces.Box:
    return spaces.Box(low, high, (1,), np.float64)


def test_each_entry_of_an_action_has_its_own_bounds(tmp_path: Path) -> None:
    spec = SPECS["hopper"]
    there, scale = made(spec=spec, lengths=(4, 3)), np.array([1.0, 2.0, 0.5])
    native = there | {"act": [scale * act for act in there["act"]]}
    path = minari_folder(
        tmp_path / "d", "hdf5", **native, action_space=spaces.Box(-scale, scale, dtype=float)
    )
    refused(path, "its actions are in [-1, 1] x [-2, 2] x [-0.5, 0.5], and the task's in [-1, 1]", spec)
    found = demos.read(path, spec, (-scale, scale))
    assert all(map(np.array_equal, found.episodes.act, there["act"]))


@pytest.mark.parametrize("form", FORMS)
def test_endings_are_as_they_are_said(tmp_path: Path, form: str) -> None:
    steps = {name: np.zeros(5, bool) for name in FLAGS}
    both = {name: np.arange(5) == 4 for name in steps}
    five, whole = made(lengths=(5,)), made(lengths=(200,))
    refused(
        minari_folder(tmp_path / "open", form, **five, **steps),
        "episode 0 neither terminated nor was cut where it ends, before the horizon",
    )
    on = minari_folder(tmp_path / "on", form, **five, **steps | {"terminations": np.arange(5) >= 3})
    refused(on, "episode 0 goes on after it ended")
    ended = demos.read(minari_folder(tmp_path / "both", form, **five, **both), SWINGUP)
    never = minari_folder(tmp_path / "never", form, **whole, terminations=np.zeros(200, bool))
    assert (ended.episodes.terminated, demos.read(never, SWINGUP).episodes.terminated) == ((True,), (False,))
    last = minari_folder(tmp_path / "last", form, **whole, terminations=np.arange(200) == 199)
    assert demos.read(last, SWINGUP).episodes.terminated == (True,)


@pytest.mark.parametrize("form", FORMS)
def test_what_is_no_row_of_numbers_is_refused(tmp_path: Path, form: str) -> None:
    there = made(lengths=(5,))
    (obs,), words = there["obs"], [str(i) for i in range(6)]
    pixels = spaces.Box(0, 255, (32, 32, 3), np.uint8)
    odd = {
        "dictionary": ({"a": obs}, spaces.Dict({"a": spaces.Box(-np.inf, np.inf, (3,), np.float64)})),
        "tuple": ((obs,), spaces.Tuple([spaces.Box(-np.inf, np.inf, (3,), np.float64)])),
        "texts": (words, spaces.Text(9)),
        "images": (np.zeros((6, 32, 32, 3), np.uint8), pixels),
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
    "a list": lambda facts: [],
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
    "no numbers": lambda facts: facts.update(action_space='{"type": "Box", "low": [], "high": []}'),
    "other bounds": lambda facts: facts.update(action_space='{"type": "Box", "low": [0, 0], "high": [1, 1]}'),
}


OTHERS = "its bounds are of other actions"
MORE = {
    "other steps": "tells of 13 steps, and its episodes have 12",
    "more than there are": "3",
    "no numbers": OTHERS,
    "other bounds": OTHERS,
}


@pytest.mark.parametrize("form", FORMS)
def test_odd_descriptions_are_refused(tmp_path: Path, form: str) -> None:
    file = minari_folder(tmp_path / "d", form, **made(lengths=(5, 4, 3))) / "data/metadata.json"
    whole = file.read_text()
    for name, change in ODD_FACTS.items():
        facts = json.loads(whole)
        text = change(facts)
        file.write_text(text if isinstance(text, str) else json.dumps([] if text == [] else facts))
        refused(tmp_path / "d", MORE.get(name, "its metadata.json cannot be used: "))
    facts = json.loads(whole)
    del facts["action_space"]
    file.write_text(json.dumps(facts))
    refused(tmp_path / "d", "does not tell the bounds of its actions; give them as --action-bounds")
    assert len(demos.read(tmp_path / "d", SWINGUP, (-1.0, 1.0)).episodes) == 3


@pytest.mark.parametrize("form", FORMS)
def test_links_pickles_and_more_than_is_read_are_refused(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = minari_folder(tmp_path / "d", form, **made(lengths=(5, 4)))
    file = "main_data.hdf5" if form == "hdf5" else f"0/part-0.{form}"
    linked = ["data", "data/metadata.json", f"data/{file}", *(["data/0"] if form != "hdf5" else [])]
    for name in linked:
        shutil.copytree(path, copy := tmp_path / "copy")
        (copy / name).rename(tmp_path / "elsewhere")
        (copy / name).symlink_to(tmp_path / "elsewhere")
        refused(copy, "is a link")
        shutil.rmtree(copy)
        (shutil.rmtree if (tmp_path / "elsewhere").is_dir() else os.unlink)(tmp_path / "elsewhere")
    with monkeypatch.context() as patch:
        patch.setattr(demonstration_forms, "LARGEST", 400)
        refused(path, "it is larger than" if form != "parquet" else "larger than")
    (path / "data" / file).write_bytes(pickle.dumps(made()))
    refused(path, "no demonstrations of swingup: ")
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
    monkeypatch.setattr(demonstration_forms, "LARGEST", 1_000_000)
    refused(path, "it holds more than")


OTHERWISE = dict.fromkeys(("flags as numbers", "fewer flags", "no steps"), "terminations and truncations")
OTHERWISE["no episode"] = "episode_0"


def odd_hdf5(file: h5py.File, elsewhere: Path) -> dict[str, Callable[[], object]]:
    """What is put in the place of the first episode's rewards, or of the episode."""
    group, kept = file["episode_0"], file["episode_0/rewards"][()]

    def put(**options: Any) -> object:
        return group.create_dataset("rewards", **options)

    def virtual() -> None:
        layout = h5py.VirtualLayout((5,), float)
        layout[:] = h5py.VirtualSource(str(elsewhere), "kept", (5,))
        group.create_virtual_dataset("rewards", layout)

    def linked(link: Any) -> Callable[[], None]:
        return lambda: group.__setitem__("rewards", link)

    return {
        "a link of HDF5 to a file": linked(h5py.ExternalLink(str(elsewhere), "kept")),
        "a link of HDF5": linked(h5py.SoftLink("/episode_1/rewards")),
        "a virtual one": virtual,
        "one in another file": lambda: put(shape=(5,), dtype=float, external=[(str(elsewhere), 0, 40)]),
        "a compressed one": lambda: put(data=kept, compression="gzip"),
        "one that was never written": lambda: put(shape=(10**12,), chunks=(10,), dtype=float),
        "texts": lambda: put(data=["a"] * 5),
        "objects": lambda: put(shape=(5,), dtype=h5py.vlen_dtype(float)),
        "opaque": lambda: put(data=np.void(pickle.dumps(1))),
        "empty": lambda: put(data=h5py.Empty(float)),
        "one number": lambda: put(data=1.0),
        "a table": lambda: put(data=np.zeros((5, 1))),
        "too few": lambda: put(data=kept[:3]),
        "a folder": lambda: group.create_group("rewards"),
        "a type": lambda: group.__setitem__("rewards", np.dtype(float)),
        "nothing": lambda: None,
        "flags as numbers": lambda: (
            put(data=kept),
            group.pop("terminations"),
            group.create_dataset("terminations", data=np.ones(5)),
        ),
        "fewer flags": lambda: (
            put(data=kept),
            group.pop("terminations"),
            group.create_dataset("terminations", data=[True]),
        ),
        "no steps": lambda: (
            put(data=kept[:0]),
            [(group.pop(name), group.create_dataset(name, data=np.zeros(0, bool))) for name in FLAGS],
        ),
        "no episode": lambda: file.pop("episode_0"),
    }


def test_hdf5_reads_from_no_other_file_and_only_arrays_of_numbers(tmp_path: Path) -> None:
    path = minari_folder(tmp_path / "d", "hdf5", **made(lengths=(5, 4)))
    place, elsewhere = path / "data/main_data.hdf5", tmp_path / "elsewhere.hdf5"
    with h5py.File(elsewhere, "w") as file:
        file["kept"] = np.ones(5)
    whole = place.read_bytes()
    with h5py.File(place) as file:
        names = list(odd_hdf5(file, elsewhere))
    for name in names:
        place.write_bytes(whole)
        with h5py.File(place, "a") as file:
            put = odd_hdf5(file, elsewhere)[name]
            del file["episode_0/rewards"]
            put()
        refused(path, OTHERWISE.get(name, "rewards"))
    place.write_bytes(whole)
    assert len(demos.read(path, SWINGUP).episodes) == 2


def test_an_array_of_hdf5_that_was_read_without_an_end_is_refused(tmp_path: Path) -> None:
    path = minari_folder(tmp_path / "d", "hdf5", **made(lengths=(2, 4)))
    place = path / "data/main_data.hdf5"
    dimensions = b"\x01\x02\x01" + bytes(5) + struct.pack("<QQ", 3, 3)  # the second byte: how many
    whole = place.read_bytes()
    assert dimensions in whole
    place.write_bytes(whole.replace(dimensions, b"\x01\x01" + dimensions[2:]))
    refused(path, "/episode_0/observations (3,) is not whole")


@pytest.mark.parametrize("spec", [SWINGUP, CHOICES], ids=lambda spec: spec.name)
def test_minari_reads_what_is_exported(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, spec: Any
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "users"))
    export = ["demos", "export", "--env", spec.name, "--demos", "3", "--to"]
    assert main([*export, str(tmp_path / "d.npz")]) == 0
    assert main([*export, str(tmp_path / "folder")]) == 0
    out, err = capfd.readouterr()
    assert (out.count("\n"), err) == (2, "")
    assert os.environ["MINARI_DATASETS_PATH"] == str(tmp_path / "users")
    assert {path.name for path in tmp_path.iterdir()} <= {"cache", "d.npz", "folder"}
    known = demos.read(tmp_path / "d.npz", spec)
    assert demos.read(tmp_path / "folder", spec).digest == known.digest
    theirs = minari.MinariDataset(tmp_path / "folder/data")
    assert theirs.spec.dataset_id == f"irl-bench/{spec.name}/expert-v0"
    for i, episode in enumerate(theirs.iterate_episodes()):
        assert np.array_equal(episode.observations, known.episodes.obs[i])
        act = known.episodes.act[i]
        assert np.array_equal(episode.actions, act.argmax(axis=1) if spec.discrete else act)
        assert known.rewards is not None
        assert np.array_equal(episode.rewards, known.rewards[i])
        ends = (episode.terminations[-1], episode.truncations[-1])
        assert ends == (known.episodes.terminated[i], not known.episodes.terminated[i])
        assert all(theirs.action_space.contains(one) for one in episode.actions)
    assert theirs.total_episodes == 3
    assert (
        main(
            ["demos", "import", str(tmp_path / "folder"), "--env", spec.name, "--to", str(tmp_path / "e.npz")]
        )
        == 0
    )
    assert demos.read(tmp_path / "e.npz", spec).digest == known.digest
    assert main(["demos", "inspect", str(tmp_path / "folder"), "--env", spec.name]) == 0
    assert "form        Minari parquet" in capfd.readouterr().out
    assert main([*export, str(tmp_path / "folder")]) == 2
    assert "is there already" in capfd.readouterr().err
    monkeypatch.chdir(tmp_path)
    assert main([*export, "relative"]) == 0
    assert demos.read(tmp_path / "relative", spec).digest == known.digest


def test_nothing_is_left_of_an_export_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "x")

    monkeypatch.setattr("minari.dataset._storages.arrow_storage.ParquetStorage.update_episodes", fail)
    with pytest.raises(OSError, match="No space left"):
        demos.export(tmp_path / "folder", "swingup", 0, 1, "expert")
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
    monkeypatch.setattr(commands, "handle_signals", lambda: None)
    monkeypatch.setattr("harness.run.grid.Grid.run", lambda self, cells: None)
    path, out = minari_folder(tmp_path / "d", "hdf5", **made()), tmp_path / "run"
    main(["run", "--methods", "bc", "--envs", "swingup", "--out", str(out), "--demos-from", str(path)])
    stored = asked(out, "request", "run")["conditions"]
    assert stored["demonstrations"] == str(demos.read(path, SWINGUP))
