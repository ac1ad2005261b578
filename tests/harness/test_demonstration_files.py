"""Demonstrations go out and come back bit by bit; what does not fit is refused in a line."""

import io
import json
import os
import pickle
import shutil
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from harness.action_units import SCALED

from harness import demonstrations as demos
from harness.cli import main
from harness.judge.results import Conditions, Shown
from harness.registry import BadInput
from tests.harness.made_demonstrations import CHOICES, SWINGUP, imitation, made, same
from tests.harness.made_minari import minari_folder

Tried = Callable[[str, Counter[str]], None]
pytestmark = pytest.mark.usefixtures("own_cache", "read_here")


def test_what_is_written_comes_back_bit_by_bit(tmp_path: Path) -> None:
    episodes, rewards = made()
    demos.write(tmp_path / "d.npz", episodes, rewards)
    found = demos.read(tmp_path / "d.npz", SWINGUP)
    assert same(found.episodes, episodes)
    assert found.rewards is not None
    assert all(map(np.array_equal, found.rewards, rewards))
    demos.write(tmp_path / "again.npz", found.episodes, found.rewards)
    again = demos.read(tmp_path / "again.npz", SWINGUP)
    assert same(again.episodes, episodes)
    assert again.digest == found.digest
    demos.write(tmp_path / "bare.npz", episodes)
    bare = demos.read(tmp_path / "bare.npz", SWINGUP)
    assert (bare.returns, bare.digest) == (None, found.digest)


@pytest.mark.parametrize("spec", [SWINGUP, CHOICES], ids=lambda spec: spec.name)
def test_an_experts_demonstrations_are_those_that_a_run_shows(tmp_path: Path, spec: Any) -> None:
    from harness.cell.experts import source_for

    command = [
        "demos",
        "export",
        "--env",
        spec.name,
        "--seed",
        "1",
        "--demos",
        "3",
        "--to",
        str(tmp_path / "d.npz"),
    ]
    assert main(command) == 0
    shown = source_for(spec.name, 1, Conditions("full", "absorbing", "sbx")).demonstrations(Shown(3))
    assert same(demos.read(tmp_path / "d.npz", spec).episodes, shown)


def test_imitations_folders_are_read_and_their_infos_are_not(tmp_path: Path) -> None:
    episodes, rewards = made()
    folder = imitation(tmp_path / "folder", episodes, rewards, parts=1)
    found = demos.read(folder, SWINGUP, SCALED)
    assert same(found.episodes, episodes)  # of which the one as long as the horizon was cut there
    assert (found.guessed, found.form) == (1, "imitation")
    two = demos.read(imitation(tmp_path / "two", episodes, rewards), SWINGUP, SCALED)
    assert [len(act) for act in two.episodes.act] == [200, 3, 7]
    native = [2 * act for act in episodes.act]
    scaled = imitation(tmp_path / "native", episodes, rewards, 1, native)
    with pytest.raises(BadInput, match=r"actions .* are outside of \[-1, 1\], by .*, give --action-bounds"):
        demos.read(scaled, SWINGUP, SCALED)
    assert same(demos.read(scaled, SWINGUP, (-2.0, 2.0)).episodes, episodes)


def test_imitations_older_files_are_read(tmp_path: Path) -> None:
    episodes, rewards = made(spec=CHOICES)
    lengths = episodes.lengths
    np.savez(
        tmp_path / "old.npz",
        obs=np.concatenate(episodes.obs),
        acts=np.concatenate(episodes.act).argmax(axis=1),
        indices=np.cumsum(lengths)[:-1],
        terminal=np.array([True] * 3),
        rews=np.concatenate(rewards),
        infos=np.array([{"a": 1}] * int(lengths.sum()), dtype=object),
    )
    found = demos.read(tmp_path / "old.npz", CHOICES)
    assert [act.tolist() for act in found.episodes.act] == [act.tolist() for act in episodes.act]
    assert found.episodes.terminated == (True, True, True)  # 200 steps are not CartPole's horizon
    assert found.form == "imitation's npz"


def test_nothing_that_is_there_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demos.write(tmp_path / "d.npz", *made())
    before = (tmp_path / "d.npz").read_bytes()
    to = ["--env", "swingup", "--to", str(tmp_path / "d.npz")]
    for words in (["import", str(tmp_path / "d.npz")], ["export", "--demos", "1"]):
        assert main(["demos", *words, *to]) == 2
        assert "d.npz is there already" in capsys.readouterr().err
    assert (tmp_path / "d.npz").read_bytes() == before
    for name in ("e.npz", "e"):
        to = ["--env", "swingup", "--to", str(tmp_path / "d.npz" / name)]
        assert main(["demos", "export", "--demos", "1", *to]) == 2
        assert "d.npz is no folder" in capsys.readouterr().err


@pytest.mark.parametrize("row", [(0.0, 0.0), (1.0, 1.0), (0.4, 0.6), (-1.0, 1.0)])
def test_what_is_no_choice_is_refused(tmp_path: Path, row: tuple[float, float]) -> None:
    episodes, _ = made(spec=CHOICES)
    act = [one.copy() for one in episodes.act]
    act[1][3] = row
    demos.write(tmp_path / "d.npz", replace(episodes, act=tuple(act)))
    with pytest.raises(BadInput, match="episode 1 has actions that are no choice"):
        demos.read(tmp_path / "d.npz", CHOICES)


def test_returns_that_no_histogram_has_are_described(tmp_path: Path) -> None:
    episodes, rewards = made((2, 2), (True, True))
    paid = [np.array([1.0, 1.0]), np.array([1.0, np.nextafter(1.0, 2.0)])]
    demos.write(tmp_path / "near.npz", episodes, paid)
    assert "returns     2.00 on average" in demos.described(
        demos.read(tmp_path / "near.npz", SWINGUP), SWINGUP
    )
    demos.write(tmp_path / "big.npz", episodes, [np.full(2, 1e308) for _ in rewards])
    with pytest.raises(BadInput, match=r"sum to more than 1e\+100"):
        demos.read(tmp_path / "big.npz", SWINGUP)


def test_observations_that_the_task_does_not_have_are_refused(tmp_path: Path) -> None:
    episodes, rewards = made()
    obs = [one.copy() for one in episodes.obs]
    obs[1][4, 2] = 8.1
    demos.write(tmp_path / "d.npz", replace(episodes, obs=tuple(obs)), rewards)
    with pytest.raises(BadInput, match=r"episode 1 observes 8.1 as .*, which lies in \[-8, 8\]"):
        demos.read(tmp_path / "d.npz", SWINGUP)


def test_inspect_says_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imitation(tmp_path / "folder", *made())
    scaled = ["--env", "swingup", "--action-bounds=scaled"]
    assert main(["demos", "inspect", str(tmp_path / "folder"), *scaled]) == 0
    out = capsys.readouterr().out
    assert "episodes    3, of which 2 terminated" in out
    assert "steps       210; 3 to 200 an episode" in out
    assert "1 called terminal at the horizon are taken for cut there" in out
    assert out.count("#") >= 3
    arguments = ["demos", "import", str(tmp_path / "folder"), *scaled, "--to"]
    assert main([*arguments, str(tmp_path / "d.npz")]) == 0
    assert str(demos.read(tmp_path / "d.npz", SWINGUP)) in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "d.csv")]) == 2
    assert "ends in .npz" in capsys.readouterr().err


def wrong_arrays() -> dict[str, dict[str, np.ndarray]]:
    """Arrays of a file, each with one thing wrong."""
    episodes, rewards = made((5, 4), (True, False))
    good: dict[str, Any] = {
        "obs": np.concatenate(episodes.obs),
        "act": np.concatenate(episodes.act),
        "lengths": episodes.lengths,
        "terminated": np.array(episodes.terminated),
        "rewards": np.concatenate(rewards),
    }
    nan, huge = good["obs"].copy(), good["act"].copy()
    nan[3], huge[2] = np.nan, 1e300
    changes: dict[str, dict[str, Any]] = {
        "no obs": {"obs": None},
        "short obs": {"obs": good["obs"][:-1]},
        "flat obs": {"obs": good["obs"].ravel()},
        "deep obs": {"obs": good["obs"][..., None]},
        "text obs": {"obs": good["obs"].astype(str)},
        "complex obs": {"obs": good["obs"].astype(complex)},
        "object obs": {"obs": good["obs"].astype(object)},
        "nan obs": {"obs": nan},
        "wide obs": {"obs": np.concatenate([good["obs"]] * 2, axis=1)},
        "huge act": {"act": huge},
        "no act": {"act": good["act"][:, :0]},
        "dates as act": {"act": np.zeros((9, 1), "datetime64[s]")},
        "structured act": {"act": np.zeros((9, 1), [("a", float)])},
        "negative lengths": {"lengths": np.array([-1, 10])},
        "float lengths": {"lengths": np.array([5.0, 4.0])},
        "empty lengths": {"lengths": np.array([], int)},
        "zero length": {"lengths": np.array([9, 0])},
        "vast lengths": {"lengths": np.array([2**62, 2**62])},
        "wrapping lengths": {"lengths": np.array([2**63 - 1, 2**63 - 1, 11])},
        "more endings": {"terminated": np.array([True] * 3)},
        "texts as endings": {"terminated": np.array(["False", "False"])},
        "numbers as endings": {"terminated": np.array([2, -5])},
        "nan endings": {"terminated": np.array([np.nan, 0])},
        "rewards of others": {"rewards": np.zeros(3)},
        "nan rewards": {"rewards": np.full(9, np.nan)},
        "too long": {"lengths": np.array([9])} | {"obs": good["obs"][:10], "terminated": np.array([True])},
    }
    found = {
        name: {k: v for k, v in (good | change).items() if v is not None} for name, change in changes.items()
    }
    found["too long"] |= {"obs": np.zeros((202, 3)), "act": np.zeros((201, 1)), "lengths": np.array([201])}
    found["too long"] |= {"rewards": np.zeros(201)}
    return found


@pytest.mark.parametrize("wrong", wrong_arrays())
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, wrong: str) -> None:
    np.savez(tmp_path / "d.npz", **wrong_arrays()[wrong])  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=r"d\.npz: no demonstrations of swingup: ") as error:
        demos.read(tmp_path / "d.npz", SWINGUP)
    assert str(error.value).isprintable()


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.abort, ()


def test_no_pickle_is_read(tmp_path: Path) -> None:
    (tmp_path / "bomb.pkl").write_bytes(pickle.dumps(Bomb()))
    (tmp_path / "bomb.npz").write_bytes(pickle.dumps(Bomb()))
    arrays = wrong_arrays()["object obs"] | {"act": np.array([Bomb()] * 9)[:, None]}
    np.savez(tmp_path / "objects.npz", **arrays)  # type: ignore[arg-type]
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bomb()]), allow_pickle=True)
    (tmp_path / "one.npz").write_bytes(buffer.getvalue())
    for name in ("bomb.pkl", "bomb.npz", "objects.npz", "one.npz"):
        with pytest.raises(BadInput, match="no demonstrations of swingup"):
            demos.read(tmp_path / name, SWINGUP)


def test_archives_of_no_or_two_arrays_are_refused_in_our_words(tmp_path: Path) -> None:
    good, path = wrong_arrays()["rewards of others"], tmp_path / "d.npz"
    del good["rewards"]

    def member(value: Any) -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, value, allow_pickle=True)
        return buffer.getvalue()

    def refused(why: str, *added: tuple[str, bytes], without: str = "") -> None:
        with zipfile.ZipFile(path, "w") as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of names that are there already
            whole = {f"{name}.npy": member(its) for name, its in good.items() if name != without}
            for name, data in (*whole.items(), *added):
                archive.writestr(name, data)
        with pytest.raises(BadInput, match=f"no demonstrations of swingup: {why}") as error:
            demos.read(path, SWINGUP)
        assert "allow_pickle" not in str(error.value)

    for name in ("act.npy", "act"):
        refused("it has two arrays of one name", (name, member(good["act"] / 2)))
    for data in (b"no array", member(np.array([None])), member(good["act"])[:50], member(np.float64(1))):
        refused("its act is (damaged|no array)", ("act.npy", data), without="act")
    path.write_bytes(b"PK\x05\x06" + bytes(18) + path.read_bytes()[:40])
    with pytest.raises(BadInput, match=r"no demonstrations of swingup: it (is|has)"):
        demos.read(path, SWINGUP)


def test_folders_that_are_no_whole_dataset_are_refused_in_our_words(tmp_path: Path) -> None:
    folder = imitation(tmp_path / "folder", *made(), parts=1)
    state = json.loads((folder / "state.json").read_text())
    demos.read(folder, SWINGUP, SCALED)

    def refused(text: str, why: str) -> None:
        (folder / "state.json").write_text(text)
        with pytest.raises(BadInput, match=f"no demonstrations of swingup: {why}"):
            demos.read(folder, SWINGUP, SCALED)

    refused(json.dumps(state | {"_indices_data_files": [{"filename": "i.arrow"}]}), "it shows a selection")
    for text in ("[1]", "{", "{}", "1", '{"_data_files": [1]}', '{"_data_files": 5}'):
        refused(text, "its state.json does not list files")
    schema = pa.ipc.open_stream((folder / "data-00000-of-00001.arrow").read_bytes()).schema
    with pa.ipc.new_stream(folder / "empty.arrow", schema) as stream:
        stream.write_table(schema.empty_table())
    refused(json.dumps({"_data_files": [{"filename": "empty.arrow"}]}), "it holds no episode")


def test_odd_places_are_refused(tmp_path: Path) -> None:
    demos.write(tmp_path / "d.npz", *made())
    (tmp_path / "link.npz").symlink_to(tmp_path / "d.npz")
    (tmp_path / "nested/deeper").mkdir(parents=True)
    os.mkfifo(tmp_path / "pipe.npz")
    folder = imitation(tmp_path / "folder", *made())
    (tmp_path / "escape").mkdir()
    (tmp_path / "escape/state.json").write_text(json.dumps({"_data_files": [{"filename": "../d.npz"}]}))
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty/state.json").write_text(json.dumps({"_data_files": []}))
    (tmp_path / "linked").mkdir()
    shutil.copy(folder / "state.json", tmp_path / "linked")
    for file in folder.glob("*.arrow"):
        (tmp_path / "linked" / file.name).symlink_to(file)
    for name in ("nowhere.npz", "link.npz", "nested", "pipe.npz", "escape", "empty", "linked"):
        with pytest.raises(BadInput, match="no demonstrations of swingup"):
            demos.read(tmp_path / name, SWINGUP)


def test_whatever_is_damaged_is_refused_in_a_line_or_harmless(tmp_path: Path, tried: Tried) -> None:
    rng, counts = np.random.default_rng(0), Counter[str]()
    demos.write(tmp_path / "d.npz", *made((5, 4), (True, False)))
    folder = imitation(tmp_path / "folder", *made((5, 4), (True, False)), parts=1)
    places = [(tmp_path / "d.npz", tmp_path / "d.npz")]
    places += [(folder / "state.json", folder), (next(folder.glob("*.arrow")), folder)]
    episodes, rewards = made((5, 4), (True, False))
    for form, name in (("hdf5", "main_data.hdf5"), ("parquet", "1/part-0.parquet")):
        path = minari_folder(tmp_path / form, form, episodes.obs, episodes.act, episodes.terminated, rewards)
        places.append((path / "data" / name, path))
    for file, path in places:
        whole = file.read_bytes()
        for _ in range(500):
            at = int(rng.integers(len(whole)))
            byte = bytes([int(rng.integers(256))])
            cut = whole[:at] if rng.random() < 0.3 else whole[:at] + byte + whole[at + 1 :]
            file.write_bytes(cut)
            said = ""
            try:
                demos.read(path, SWINGUP, SCALED)
            except BadInput as error:
                said = str(error)
            assert said.isprintable(), said
            counts[f"{file.suffix} {'refused' if said else 'taken'}"] += 1
        file.write_bytes(whole)
    tried("damaged files of demonstrations", counts)
    assert all(counts[f"{suffix} refused"] > 50 for suffix in (".npz", ".arrow", ".hdf5", ".parquet"))
