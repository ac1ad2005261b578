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

from harness.cell.experts import source_for
from harness.cli.main import main
from harness.demonstrations.description import described
from harness.demonstrations.reading import read, write
from harness.demonstrations.units import SCALED
from harness.records import Conditions, Shown
from harness.registry import BadInput
from tests.harness.demonstrations.made_demonstrations import CHOICES, SWINGUP, imitation, made, refused, same
from tests.harness.demonstrations.made_minari import minari_folder

Tried = Callable[[str, Counter[str]], None]
pytestmark = pytest.mark.usefixtures("own_cache", "read_here")


def test_what_is_written_comes_back_bit_by_bit(tmp_path: Path) -> None:
    episodes, rewards = made()
    write(tmp_path / "d.npz", episodes, rewards)
    found = read(tmp_path / "d.npz", SWINGUP)
    assert same(found.episodes, episodes)
    assert all(map(np.array_equal, found.rewards or (), rewards))
    write(tmp_path / "bare.npz", found.episodes)
    bare = read(tmp_path / "bare.npz", SWINGUP)
    assert (bare.returns, bare.digest) == (None, found.digest)


@pytest.mark.parametrize("spec", [SWINGUP, CHOICES], ids=lambda spec: spec.name)
def test_an_experts_demonstrations_are_those_that_a_run_shows(tmp_path: Path, spec: Any) -> None:
    to = ["--seed", "1", "--demos", "3", "--to", str(tmp_path / "d.npz")]
    assert main(["demos", "export", "--env", spec.name, *to]) == 0
    shown = source_for(spec.name, 1, Conditions("full", "absorbing", "sbx")).demonstrations(Shown(3))
    assert same(read(tmp_path / "d.npz", spec).episodes, shown)


def test_imitations_folders_are_read_and_their_infos_are_not(tmp_path: Path) -> None:
    episodes, rewards = made()
    found = read(imitation(tmp_path / "folder", episodes, rewards, parts=1), SWINGUP, SCALED)
    assert same(found.episodes, episodes)  # the one as long as the horizon was cut there
    assert (found.guessed, found.form) == (1, "imitation")
    two = read(imitation(tmp_path / "two", episodes, rewards), SWINGUP, SCALED)
    assert [len(act) for act in two.episodes.act] == [200, 3, 7]
    native = imitation(tmp_path / "native", episodes, rewards, 1, [2 * act for act in episodes.act])
    refused(native, "are outside of [-1, 1], by ", bounds=SCALED)
    assert same(read(native, SWINGUP, 2 * SCALED).episodes, episodes)


def test_imitations_older_files_are_read(tmp_path: Path) -> None:
    episodes, rewards = made(spec=CHOICES)
    np.savez(
        tmp_path / "old.npz",
        obs=np.concatenate(episodes.obs),
        acts=np.concatenate(episodes.act).argmax(axis=1),
        indices=np.cumsum(episodes.lengths)[:-1],
        terminal=np.array([True] * 3),
        rews=np.concatenate(rewards),
        infos=np.array([{"a": 1}] * int(episodes.lengths.sum()), dtype=object),
    )
    found = read(tmp_path / "old.npz", CHOICES)
    assert same(found.episodes, replace(episodes, terminated=(True,) * 3))  # 200 steps are not its horizon
    assert found.form == "imitation's npz"


def test_nothing_that_is_there_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "d.npz"
    write(file, *made())
    before = file.read_bytes()
    for words in (["import", str(file)], ["export", "--demos", "1"]):
        assert main(["demos", *words, "--env", "swingup", "--to", str(file)]) == 2
        assert "d.npz is there already" in capsys.readouterr().err
    assert file.read_bytes() == before
    for name in ("e.npz", "e"):
        assert main(["demos", "export", "--demos", "1", "--env", "swingup", "--to", str(file / name)]) == 2
        assert "d.npz is no folder" in capsys.readouterr().err


@pytest.mark.parametrize("row", [(0.0, 0.0), (1.0, 1.0), (0.4, 0.6), (-1.0, 1.0)])
def test_what_is_no_choice_is_refused(tmp_path: Path, row: tuple[float, float]) -> None:
    episodes, _ = made(spec=CHOICES)
    act = [one.copy() for one in episodes.act]
    act[1][3] = row
    write(tmp_path / "d.npz", replace(episodes, act=tuple(act)))
    refused(tmp_path / "d.npz", "episode 1 has actions that are no choice", CHOICES)


def test_observations_and_rewards_that_the_task_does_not_have_are_refused(tmp_path: Path) -> None:
    episodes, rewards = made()
    obs = [one.copy() for one in episodes.obs]
    obs[1][4, 2] = 8.1
    write(tmp_path / "d.npz", replace(episodes, obs=tuple(obs)), rewards)
    refused(tmp_path / "d.npz", "episode 1 observes 8.1 as ")
    write(tmp_path / "big.npz", episodes, [np.full(len(paid), 1e308) for paid in rewards])
    refused(tmp_path / "big.npz", "sum to more than 1e+100")


def test_inspect_says_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imitation(tmp_path / "folder", *made())
    scaled = ["--env", "swingup", "--action-bounds=scaled"]
    assert main(["demos", "inspect", str(tmp_path / "folder"), *scaled]) == 0
    out = capsys.readouterr().out
    assert "episodes    3, of which 2 terminated" in out
    assert "steps       210; 3 to 200 an episode" in out
    assert "1 called terminal at the horizon are taken for cut there" in out
    arguments = ["demos", "import", str(tmp_path / "folder"), *scaled, "--to"]
    assert main([*arguments, str(tmp_path / "d.npz")]) == 0
    assert str(read(tmp_path / "d.npz", SWINGUP)) in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "d.csv")]) == 2
    assert "ends in .npz" in capsys.readouterr().err
    write(tmp_path / "paid.npz", made((2, 2), (True, True))[0], [np.ones(2), np.full(2, 1.5)])
    lines = described(read(tmp_path / "paid.npz", SWINGUP), SWINGUP)
    assert lines[-1] == "returns     2.50 on average, 2.00 to 3.00"


def good_arrays() -> dict[str, Any]:
    episodes, rewards = made((5, 4), (True, False))
    return {
        "obs": np.concatenate(episodes.obs),
        "act": np.concatenate(episodes.act),
        "lengths": episodes.lengths,
        "terminated": np.array(episodes.terminated),
        "rewards": np.concatenate(rewards),
    }


WRONG: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "short obs": lambda good: {"obs": good["obs"][:-1]},
    "flat obs": lambda good: {"obs": good["obs"].ravel()},
    "deep obs": lambda good: {"obs": good["obs"][..., None]},
    "text obs": lambda good: {"obs": good["obs"].astype(str)},
    "complex obs": lambda good: {"obs": good["obs"].astype(complex)},
    "object obs": lambda good: {"obs": good["obs"].astype(object)},
    "nan obs": lambda good: {"obs": good["obs"] * np.nan},
    "wide obs": lambda good: {"obs": np.concatenate([good["obs"]] * 2, axis=1)},
    "huge act": lambda good: {"act": good["act"] * 0 + 1e300},
    "no act": lambda good: {"act": good["act"][:, :0]},
    "dates as act": lambda good: {"act": np.zeros((9, 1), "datetime64[s]")},
    "structured act": lambda good: {"act": np.zeros((9, 1), [("a", float)])},
    "negative lengths": lambda good: {"lengths": np.array([-1, 10])},
    "float lengths": lambda good: {"lengths": np.array([5.0, 4.0])},
    "empty lengths": lambda good: {"lengths": np.array([], int)},
    "zero length": lambda good: {"lengths": np.array([9, 0])},
    "vast lengths": lambda good: {"lengths": np.array([2**62, 2**62])},
    "wrapping lengths": lambda good: {"lengths": np.array([2**63 - 1, 2**63 - 1, 11])},
    "more endings": lambda good: {"terminated": np.array([True] * 3)},
    "texts as endings": lambda good: {"terminated": np.array(["False", "False"])},
    "numbers as endings": lambda good: {"terminated": np.array([2, -5])},
    "nan endings": lambda good: {"terminated": np.array([np.nan, 0])},
    "rewards of others": lambda good: {"rewards": np.zeros(3)},
    "nan rewards": lambda good: {"rewards": np.full(9, np.nan)},
    "no number": lambda good: {"act": np.float64(1)},
    "too long": lambda good: {
        **{"obs": np.zeros((202, 3)), "act": np.zeros((201, 1)), "rewards": np.zeros(201)},
        **{"lengths": np.array([201]), "terminated": np.array([True])},
    },
}


@pytest.mark.parametrize("wrong", WRONG)
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, wrong: str) -> None:
    good = good_arrays()
    np.savez(tmp_path / "d.npz", **good | WRONG[wrong](good))
    refused(tmp_path / "d.npz", "")


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.abort, ()


def test_no_pickle_is_read(tmp_path: Path) -> None:
    for name in ("bomb.pkl", "bomb.npz"):
        (tmp_path / name).write_bytes(pickle.dumps(Bomb()))
    np.savez(tmp_path / "objects.npz", **good_arrays() | {"act": np.array([Bomb()] * 9)[:, None]})
    with (tmp_path / "one.npz").open("wb") as file:
        np.save(file, np.array([Bomb()]), allow_pickle=True)
    for name in ("bomb.pkl", "bomb.npz", "objects.npz", "one.npz"):
        refused(tmp_path / name, "pickles are not read")


def test_archives_of_no_or_two_arrays_are_refused_in_our_words(tmp_path: Path) -> None:
    good, path = good_arrays(), tmp_path / "d.npz"

    def member(value: Any) -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, value, allow_pickle=True)
        return buffer.getvalue()

    def written(name: str, data: bytes, without: str = "") -> None:
        with zipfile.ZipFile(path, "w") as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about names that are there already
            for own, array in good.items():
                if own != without:
                    archive.writestr(f"{own}.npy", member(array))
            archive.writestr(name, data)

    for name in ("act.npy", "act"):
        written(name, member(good["act"] / 2))
        refused(path, "it has two arrays of one name")
    for data in (b"no array", member(np.array([None])), member(good["act"])[:50]):
        written("act.npy", data, without="act")
        refused(path, "its act is ")
    path.write_bytes(b"PK\x05\x06" + bytes(18) + path.read_bytes()[:40])
    refused(path, "it ")


def test_folders_that_are_no_whole_dataset_are_refused_in_our_words(tmp_path: Path) -> None:
    folder = imitation(tmp_path / "folder", *made(), parts=1)
    state = json.loads((folder / "state.json").read_text())
    schema = pa.ipc.open_stream((folder / "data-00000-of-00001.arrow").read_bytes()).schema
    with pa.ipc.new_stream(folder / "empty.arrow", schema) as stream:
        stream.write_table(schema.empty_table())
    selection = json.dumps(state | {"_indices_data_files": [{"filename": "i.arrow"}]})
    odd = dict.fromkeys(
        ("[1]", "{", "{}", "1", '{"_data_files": [1]}', '{"_data_files": 5}'), "does not list files"
    )
    odd |= {selection: "a selection of its rows", '{"_data_files": []}': "names no files"}
    odd |= {'{"_data_files": [{"filename": "../d.npz"}]}': "names no files"}
    odd |= {'{"_data_files": [{"filename": "empty.arrow"}]}': "it holds no episode"}
    for text, why in odd.items():
        (folder / "state.json").write_text(text)
        refused(folder, why, bounds=SCALED)


def test_odd_places_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "d.npz", *made())
    (tmp_path / "link.npz").symlink_to(tmp_path / "d.npz")
    (tmp_path / "nested/deeper").mkdir(parents=True)
    os.mkfifo(tmp_path / "pipe.npz")
    folder = imitation(tmp_path / "folder", *made())
    (tmp_path / "linked").mkdir()
    shutil.copy(folder / "state.json", tmp_path / "linked")
    for file in folder.glob("*.arrow"):
        (tmp_path / "linked" / file.name).symlink_to(file)
    for name in ("nowhere.npz", "link.npz", "nested", "pipe.npz", "linked"):
        refused(tmp_path / name, "")


def test_whatever_is_damaged_is_refused_in_a_line_or_harmless(tmp_path: Path, tried: Tried) -> None:
    rng, counts = np.random.default_rng(0), Counter[str]()
    episodes, rewards = made((5, 4), (True, False))
    write(tmp_path / "d.npz", episodes, rewards)
    folder = imitation(tmp_path / "folder", episodes, rewards, parts=1)
    places = [(tmp_path / "d.npz", tmp_path / "d.npz")]
    places += [(folder / "state.json", folder), (next(folder.glob("*.arrow")), folder)]
    for form, name in (("hdf5", "main_data.hdf5"), ("parquet", "1/part-0.parquet")):
        path = minari_folder(tmp_path / form, form, episodes.obs, episodes.act, episodes.terminated, rewards)
        places.append((path / "data" / name, path))
    for file, path in places:
        whole = file.read_bytes()
        for _ in range(500):
            at = int(rng.integers(len(whole)))
            byte = bytes([int(rng.integers(256))])
            file.write_bytes(whole[:at] if rng.random() < 0.3 else whole[:at] + byte + whole[at + 1 :])
            reason = ""
            try:
                read(path, SWINGUP, SCALED)
            except BadInput as error:
                reason = str(error)
            assert reason.isprintable(), reason
            counts[f"{file.suffix} {'refused' if reason else 'taken'}"] += 1
        file.write_bytes(whole)
    tried("damaged files of demonstrations", counts)
    assert all(counts[f"{suffix} refused"] > 50 for suffix in (".npz", ".arrow", ".hdf5", ".parquet"))
