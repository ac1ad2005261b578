"""Demonstrations go out and come back bit by bit; what does not fit is refused in a line."""

import json
import os
import pickle
import signal
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from harness.cell.experts import source_for
from harness.cli.main import main
from harness.demonstrations import apart
from harness.demonstrations.forms import content
from harness.demonstrations.reading import read, write
from harness.demonstrations.recording import Reading
from harness.demonstrations.units import SCALED
from harness.records import Conditions, Shown
from harness.registry import BadInput
from tests.harness.demonstrations.made_demonstrations import (
    CHOICES,
    SWINGUP,
    imitation,
    made,
    refused,
    same,
)

Tried = Callable[[str, Counter[str]], None]
pytestmark = pytest.mark.usefixtures("own_cache")


def test_what_is_written_comes_back_bit_by_bit(tmp_path: Path) -> None:
    episodes, rewards = made()
    write(tmp_path / "d.npz", episodes, rewards)
    result = read(tmp_path / "d.npz", SWINGUP)
    assert same(result.episodes, episodes)
    assert all(map(np.array_equal, result.rewards or (), rewards))
    write(tmp_path / "bare.npz", result.episodes)
    bare = read(tmp_path / "bare.npz", SWINGUP)
    assert (bare.returns, bare.digest) == (None, result.digest)


@pytest.mark.parametrize("spec", [SWINGUP, CHOICES], ids=lambda spec: spec.name)
def test_an_experts_demonstrations_are_those_that_a_run_shows(tmp_path: Path, spec: Any) -> None:
    to = ["--seed", "1", "--demos", "3", "--to", str(tmp_path / "d.npz")]
    assert main(["demos", "export", "--env", spec.name, *to]) == 0
    shown = source_for(spec.name, 1, Conditions("full", "absorbing", "sbx")).demonstrations(Shown(3))
    assert same(read(tmp_path / "d.npz", spec).episodes, shown)


def test_imitations_folders_are_read_and_imported_and_their_infos_are_not(tmp_path: Path) -> None:
    episodes, rewards = made()
    result = read(imitation(tmp_path / "folder", episodes, rewards, parts=1), SWINGUP, SCALED)
    assert same(result.episodes, episodes)  # the one as long as the horizon was cut there
    assert (result.guessed, result.form) == (1, "imitation")
    two = read(imitation(tmp_path / "two", episodes, rewards), SWINGUP, SCALED)
    assert [len(act) for act in two.episodes.act] == [200, 3, 7]
    words = ["--env", "swingup", "--action-bounds=scaled", "--to", str(tmp_path / "d.npz")]
    assert main(["demos", "import", str(tmp_path / "folder"), *words]) == 0
    assert same(read(tmp_path / "d.npz", SWINGUP).episodes, episodes)


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
    result = read(tmp_path / "old.npz", CHOICES)
    assert same(result.episodes, replace(episodes, terminated=(True,) * 3))  # 200 steps are not its horizon
    assert result.form == "imitation's npz"


def test_what_the_user_says_reaches_the_process_that_reads(tmp_path: Path) -> None:
    episodes, _ = made((5, 4), (True, True))
    with h5py.File(tmp_path / "d.hdf5", "w") as file:
        for i, (obs, act) in enumerate(zip(episodes.obs, episodes.act, strict=True)):
            demo = file.create_group(f"data/demo_{i}")
            demo["obs/rate"], demo["obs/direction"], demo["actions"] = obs[:-1, 2], obs[:-1, :2], act
    how = Reading("drop", ("direction", "rate"))
    result = read(tmp_path / "d.hdf5", SWINGUP, SCALED, how).episodes
    assert all(map(np.array_equal, result.obs, [obs[:-1] for obs in episodes.obs]))
    assert all(map(np.array_equal, result.act, [act[:-1] for act in episodes.act]))


def test_nothing_that_is_there_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "d.npz"
    write(file, *made())
    before = file.read_bytes()
    for words in (["import", str(file)], ["export", "--demos", "1"]):
        assert main(["demos", *words, "--env", "swingup", "--to", str(file)]) == 2
        assert "d.npz is there already" in capsys.readouterr().err
    assert file.read_bytes() == before
    assert main(["demos", "export", "--demos", "1", "--env", "swingup", "--to", str(file / "e")]) == 2
    assert "d.npz is no folder" in capsys.readouterr().err


def good_arrays() -> dict[str, Any]:
    episodes, rewards = made((5, 4), (True, False))
    return {
        "obs": np.concatenate(episodes.obs),
        "act": np.concatenate(episodes.act),
        "lengths": episodes.lengths,
        "terminated": np.array(episodes.terminated),
        "rewards": np.concatenate(rewards),
    }


WRONG: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "fewer obs": (lambda good: {"obs": good["obs"][:-1]}, "it has 10 observations for 9 actions"),
    "as many": (lambda good: {"obs": good["obs"][:9]}, "one observation more than actions"),
    "text obs": (lambda good: {"obs": good["obs"].astype(str)}, "rows of numbers are needed"),
    "nan obs": (
        lambda good: {"obs": np.where(np.arange(11)[:, None] == 4, np.nan, good["obs"])},
        "it has observations that are not finite, the first in row 4 of all",
    ),
    "an empty episode": (
        lambda good: {
            **{"lengths": np.array([5, 0, 4]), "terminated": np.ones(3, bool)},
            "obs": np.zeros((12, 3)),
        },
        "episode 1 has 0 steps; leave out episodes without any",
    ),
    "no episode": (
        lambda good: {name: column[:0] for name, column in good.items()},
        "it holds no episode",
    ),
    "impossible obs": (lambda good: {"obs": good["obs"] + [0, 0, 8.1]}, "episode 0 observes "),
    "huge act": (lambda good: {"act": good["act"] * 0 + 1e300}, "by 1e+300 at most"),
    "wrapping": (
        lambda good: {"lengths": np.array([2**63 - 1, 11])},
        "do not sum to its 9 actions",
    ),
    "numbers as endings": (lambda good: {"terminated": np.array([2, -5])}, "true or false"),
    "other rewards": (lambda good: {"rewards": np.zeros(3)}, "it has rewards (3,) for 9 steps"),
    "vast rewards": (lambda good: {"rewards": np.full(9, 1e308)}, "sum to more than 1e+100"),
    "too long": (
        lambda good: {
            **{"obs": np.zeros((202, 3)), "act": np.zeros((201, 1)), "rewards": np.zeros(201)},
            **{"lengths": np.array([201]), "terminated": np.array([True])},
        },
        "episode 0 has 201 steps, and the horizon is 200",
    ),
}


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("wrong", WRONG)
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, wrong: str) -> None:
    good, (change, why) = good_arrays(), WRONG[wrong]
    np.savez(tmp_path / "d.npz", **good | change(good))
    refused(tmp_path / "d.npz", why)


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("row", [(0.0, 0.0), (0.4, 0.6)])
def test_what_is_no_choice_is_refused(tmp_path: Path, row: tuple[float, float]) -> None:
    episodes, _ = made(spec=CHOICES)
    act = [one.copy() for one in episodes.act]
    act[1][3] = row
    write(tmp_path / "d.npz", replace(episodes, act=tuple(act)))
    refused(tmp_path / "d.npz", "episode 1 has actions that are no choice", CHOICES)


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.abort, ()


def test_no_pickle_is_read(tmp_path: Path) -> None:
    (tmp_path / "bomb.npz").write_bytes(pickle.dumps(Bomb()))
    np.savez(tmp_path / "objects.npz", **good_arrays() | {"act": np.array([Bomb()] * 9)[:, None]})
    refused(tmp_path / "bomb.npz", "pickles are not read")
    refused(
        tmp_path / "objects.npz", "its act cannot be read: Object arrays cannot be loaded when allow_pickle"
    )


def test_folders_that_are_no_whole_dataset_are_refused(tmp_path: Path) -> None:
    folder = imitation(tmp_path / "folder", *made(), parts=1)
    state = json.loads((folder / "state.json").read_text())
    odd = {
        "[1]": "its state.json cannot be used",
        json.dumps(state | {"_indices_data_files": [{"filename": "i.arrow"}]}): "a selection of its rows",
        '{"_data_files": [{"filename": "../d.npz"}]}': "do not lie beside it",
    }
    for text, why in odd.items():
        (folder / "state.json").write_text(text)
        refused(folder, why, bounds=SCALED)


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("form", ["npz", "imitation", "hdf5", "jsonl"])
def test_whatever_is_damaged_is_refused_in_a_line_or_harmless(
    tmp_path: Path, tried: Tried, form: str
) -> None:
    rng, counts = np.random.default_rng(0), Counter[str]()
    episodes, rewards = made((5, 4), (True, False))
    file = path = tmp_path / "d.npz"
    if form == "npz":
        write(path, episodes, rewards)
    elif form == "hdf5":
        file = path = tmp_path / "d.hdf5"
        with h5py.File(path, "w") as new:
            new["observations"], new["actions"] = np.zeros((9, 3)), np.zeros((9, 1))
            new["terminals"], new["next_observations"] = np.arange(9) == 4, np.zeros((9, 3))
    elif form == "jsonl":
        file = path = tmp_path / "d.jsonl"
        rows = [{"obs": [0.1, 0.2, 0.3], "actions": 0.5, "episode_starts": 1.0 * (i == 0)} for i in range(9)]
        path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    else:
        path = imitation(tmp_path / "folder", episodes, rewards, parts=1)
        file = next(path.glob("*.arrow"))
    whole = file.read_bytes()
    for _ in range(200):
        at = int(rng.integers(len(whole)))
        byte = bytes([int(rng.integers(256))])
        file.write_bytes(whole[:at] if rng.random() < 0.3 else whole[:at] + byte + whole[at + 1 :])
        reason = ""
        try:
            read(path, SWINGUP, SCALED, Reading("repeat"))
        except BadInput as error:
            reason = str(error)
        assert reason.isprintable(), reason
        counts["refused" if reason else "taken"] += 1
    tried(f"damaged files of {form}", counts)
    assert counts["refused"] > 50


MIB = 1 << 20


def test_few_bytes_take_no_more_memory_than_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "d.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("obs", "act", "lengths", "terminated"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                count = 260 * MIB // 8 if name == "obs" else 1
                header = {"descr": "<i8", "fortran_order": False, "shape": (count,)}
                np.lib.format.write_array_header_1_0(file, header)
                file.write(bytes(8 * count))
    assert path.stat().st_size < MIB
    monkeypatch.setattr(apart, "MEMORY", 250 * MIB)
    refused(path, "more memory")


@pytest.mark.parametrize("program", [f"import os; os.kill(os.getpid(), {signal.SIGSEGV:d})", "while True: 1"])
def test_a_file_that_ends_its_reader_or_has_no_end_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    monkeypatch.setattr(apart, "PROGRAM", program)
    monkeypatch.setattr(apart, "SECONDS", 1)
    refused(tmp_path / "d.npz", "its reader ended")


def test_a_pipe_does_not_block_and_a_large_file_is_not_read(
    tmp_path: Path, read_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    refused(tmp_path / "pipe.npz", "no regular file")
    monkeypatch.setattr(content, "LARGEST", 100)
    write(tmp_path / "d.npz", *made())
    refused(tmp_path / "d.npz", "larger than")
