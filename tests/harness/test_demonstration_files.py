"""Demonstrations go out and come back bit by bit; what does not fit is refused in a line."""

import io
import json
import os
import pickle
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from harness import commands
from harness import demonstrations as demos
from harness.cli import main
from harness.judge.leaderboard import scored_rows
from harness.judge.results import Cell, Conditions, Shown
from harness.registry import SPECS, BadInput
from harness.run import experts, given
from harness.run.cells import prepare, run_cell
from harness.run.environment import CACHE_VARIABLE
from harness.run.experts import Shared
from methods.base import Episodes
from tests.harness.made_minari import minari_folder

RUNS_SOMETHING = '{"py/reduce": [{"py/function": "os.abort"}, {"py/tuple": []}]}'
"""Where it is decoded."""
SWINGUP, CHOICES = SPECS["swingup"], SPECS["cartpole_discrete"]
Tried = Callable[[str, Counter[str]], None]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))


def made(
    lengths: tuple[int, ...] = (200, 7, 3), ended: tuple[bool, ...] = (False, True, True), spec: Any = SWINGUP
) -> tuple[Episodes, tuple[np.ndarray, ...]]:
    """Episodes and rewards."""
    rng = np.random.default_rng(0)
    obs = tuple(
        rng.uniform(-0.4, 0.4, (n + 1, spec.obs_size)).astype(np.float32).astype(float) for n in lengths
    )
    act = tuple(spec.random_actions(n, rng) for n in lengths)
    return Episodes(obs, act, ended), tuple(rng.normal(size=n) for n in lengths)


def same(one: Episodes, other: Episodes) -> bool:
    pairs = zip((*one.obs, *one.act), (*other.obs, *other.act), strict=True)
    return all(map(np.array_equal, *zip(*pairs, strict=True))) and one.terminated == other.terminated


def imitation(path: Path, episodes: Episodes, rewards: Any, parts: int = 2, act: Any = None) -> Path:
    """A folder as `datasets` of imitation's trajectories is saved, with every end called terminal, and texts
    in `infos` that would run something if they were decoded."""
    path.mkdir()
    rows = {
        "obs": [obs.tolist() for obs in episodes.obs],
        "acts": [a.tolist() for a in (episodes.act if act is None else act)],
        "infos": [
            ['{"py/reduce": [{"py/function": "os.abort"}, {"py/tuple": []}]}'] * n for n in episodes.lengths
        ],
        "terminal": [True] * len(episodes),
        "rews": [r.tolist() for r in rewards],
    }
    names = []
    for part in range(parts):
        table = pa.table({name: values[part::parts] for name, values in rows.items()})
        names.append(f"data-{part:05d}-of-{parts:05d}.arrow")
        with pa.OSFile(str(path / names[-1]), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
            stream.write_table(table)
    (path / "state.json").write_text(json.dumps({"_data_files": [{"filename": name} for name in names]}))
    return path


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
    from harness.run.experts import demonstrations_for

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
    shown = demonstrations_for(spec.name, 1, Shown(3), Conditions("full", "absorbing", "sbx"))
    assert same(demos.read(tmp_path / "d.npz", spec).episodes, shown)


def test_imitations_folders_are_read_and_their_infos_are_not(tmp_path: Path) -> None:
    episodes, rewards = made()
    found = demos.read(imitation(tmp_path / "folder", episodes, rewards, parts=1), SWINGUP)
    assert same(found.episodes, episodes)  # of which the one as long as the horizon was cut there
    assert (found.guessed, found.form) == (1, "imitation")
    two = demos.read(imitation(tmp_path / "two", episodes, rewards), SWINGUP)
    assert [len(act) for act in two.episodes.act] == [200, 3, 7]
    native = [2 * act for act in episodes.act]
    scaled = imitation(tmp_path / "native", episodes, rewards, 1, native)
    with pytest.raises(BadInput, match=r"an action outside of \[-1, 1\], .* give others as --action-b"):
        demos.read(scaled, SWINGUP)
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


def test_a_run_is_shown_what_a_file_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    episodes, rewards = made((30, 20, 10), (True, True, True))
    demos.write(tmp_path / "d.npz", episodes, rewards)
    found = demos.read(tmp_path / "d.npz", SWINGUP)
    given.keep(str(found), found.episodes, found.rewards)
    conditions = Conditions("smoke", "absorbing", "sbx", retrain=False, demonstrations=str(found))
    shown = [Shown(), Shown(2), Shown(2, every=5)]
    cells = [Cell("swingup", "bc", 0, one) for one in shown]
    inputs = prepare(cells, conditions)
    all_three, two, few = (Shared(inputs).demonstrations(one) for one in shown)
    assert same(all_three, episodes)
    assert len(two) == 2
    assert {len(act) for act in two.act} < {30, 20, 10}
    assert few.times is not None
    assert [len(times) for times in few.times] == [int(n) // 5 for n in few.lengths]
    result, _ = run_cell(cells[1], conditions, inputs)
    assert {row.expert for row in result.rows} == {f"file:{found.digest}"}
    assert result.rows[0].pairs == sum(len(act) for act in two.act)
    reference, _ = run_cell(Cell("swingup", "reference", 0), conditions, inputs)
    assert not any(row.expert.startswith("file") for row in reference.rows)
    with pytest.raises(ValueError, match="4 demonstrations are asked for, and there are 3"):
        given.shown(str(found), "swingup", 0, Shown(4))
    with pytest.raises(ValueError, match="are gone from the cache"):
        given.shown("other: 3 episodes", "swingup", 0, Shown())


def test_without_an_expert_a_score_of_1_is_what_the_demonstrations_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is trained for it, and rewards are compared in states that a clone visits."""

    def train(*_: object) -> None:
        raise AssertionError("an expert is trained")

    monkeypatch.setattr(experts, "_trained", train)
    episodes, rewards = made()
    demos.write(tmp_path / "d.npz", episodes, [5 * paid for paid in rewards])
    found = demos.read(tmp_path / "d.npz", SWINGUP)
    given.keep(str(found), found.episodes, found.rewards)
    conditions = Conditions("smoke", "absorbing", "sbx", experts="none", demonstrations=str(found))
    cells = [Cell("swingup", method, 0) for method in ("reference", "bc", "control_untrained")]
    inputs = prepare(cells, conditions)
    rows = scored_rows([run_cell(cell, conditions, inputs)[0] for cell in cells])
    by_policy = {(row.method, row.policy): row for row in rows}
    shown, random = by_policy["reference", "demonstrations"], by_policy["reference", "random"]
    assert shown.return_mean == pytest.approx(np.mean([5 * paid.sum() for paid in rewards]))
    assert shown.discounted_mean == pytest.approx(
        np.mean([5 * paid @ SWINGUP.gamma ** np.arange(len(paid)) for paid in rewards])
    )
    assert (shown.episodes, shown.length_mean) == (3, pytest.approx(np.mean(episodes.lengths)))
    assert (shown.normalized_score, random.normalized_score) == (1, 0)
    star = by_policy["bc", "pi_star"]
    scale = shown.return_mean - random.return_mean
    assert star.normalized_score == pytest.approx((star.return_mean - random.return_mean) / scale)
    assert {row.expert for row in rows} == {f"file:{found.digest}"}
    assert 0 < by_policy["control_untrained", "pi_R"].reward_distance < 1


def test_a_file_without_rewards_needs_an_expert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demos.write(tmp_path / "d.npz", made()[0])
    run = ["run", "--methods", "bc", "--envs", "swingup", "--out", str(tmp_path / "run"), "--experts", "none"]
    assert main([*run, "--demos-from", str(tmp_path / "d.npz")]) == 2
    assert "tells no rewards" in capsys.readouterr().err
    assert main(run) == 2
    assert "is for demonstrations of a file" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_episodes_that_were_cut_short_are_no_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What an episode of 7 steps of 200 returns says nothing of the other 193."""
    demos.write(tmp_path / "d.npz", *made(ended=(False, True, False)))
    run = ["run", "--methods", "bc", "--envs", "swingup", "--out", str(tmp_path / "run"), "--plan"]
    from_file = ["--demos-from", str(tmp_path / "d.npz")]
    assert main([*run, *from_file]) == 0
    assert main([*run, *from_file, "--experts", "none"]) == 2
    assert "1 of the 3 episodes of" in capsys.readouterr().err
    assert main(["demos", "inspect", from_file[1], "--env", "swingup"]) == 0
    assert "1 neither terminated nor last until the horizon" in capsys.readouterr().out


def test_other_rewards_are_another_run() -> None:
    episodes, rewards = made()
    shuffled = tuple(paid[::-1].copy() for paid in rewards)
    one, other = (demos.Found(episodes, paid, "npz") for paid in (rewards, shuffled))
    assert one.digest == other.digest
    assert str(one) != str(other)


def test_nothing_that_is_there_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demos.write(tmp_path / "d.npz", *made())
    before = (tmp_path / "d.npz").read_bytes()
    to = ["--env", "swingup", "--to", str(tmp_path / "d.npz")]
    for words in (["import", str(tmp_path / "d.npz")], ["export", "--demos", "1"]):
        assert main(["demos", *words, *to]) == 2
        assert "d.npz is there already" in capsys.readouterr().err
    assert (tmp_path / "d.npz").read_bytes() == before


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
    assert "returns     2.00 on average" in demos.described(demos.read(tmp_path / "near.npz", SWINGUP))
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


def test_other_content_is_another_run_and_another_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "handle_signals", lambda: None)
    monkeypatch.setattr("harness.run.grid.Grid.run", lambda self, cells: None)
    for name, seed in (("one", (9, 8)), ("two", (9, 7))):
        demos.write(tmp_path / f"{name}.npz", made(seed, (True, True))[0])
    run = ["run", "--methods", "bc", "--envs", "swingup", "--out", str(tmp_path / "run"), "--demos-from"]
    assert main([*run, str(tmp_path / "one.npz"), "--plan"]) == 0
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / "cache").exists()
    main([*run, str(tmp_path / "one.npz")])
    stored = json.loads((tmp_path / "run/run.json").read_text())
    assert stored["demonstrations"].endswith(": 2 episodes, 17 steps")
    assert "--demos-from FILE" in (tmp_path / "run/leaderboard.md").read_text()
    capsys.readouterr()
    assert main([*run, str(tmp_path / "two.npz")]) == 2
    assert "holds a run with demonstrations" in capsys.readouterr().err
    assert main([*run[:-1]]) == 2
    assert ": 2 episodes, 17 steps, not none; give another --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--envs", "swingup,hopper"], "is for one environment"),
        (["--envs", "swingup", "--demonstrator", "noisy"], "leaves out --demonstrator"),
        (["--envs", "swingup", "--experts", "none", "--methods", "dagger"], "dagger asks the expert"),
        (["--envs", "swingup", "--experts", "none", "--transfer"], "--transfer carries the expert over"),
        (["--envs", "swingup", "--demos", "4"], "has 3 demonstrations, not 4"),
        (["--envs", "hopper"], "observations float64 (201, 3); (T, 11) are needed"),
        (["--envs", "swingup", "--action-bounds", "2"], "is not two numbers"),
        (["--envs", "swingup", "--action-bounds=2,-2"], "is not a lower number and a higher one"),
        (["--envs", "swingup", "--action-bounds=nan,2"], "is not a lower number and a higher one"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], why: str
) -> None:
    demos.write(tmp_path / "d.npz", *made())
    asked = [
        "--methods",
        "bc",
        "--demos-from",
        str(tmp_path / "d.npz"),
        "--out",
        str(tmp_path / "run"),
        *words,
    ]
    assert main(["run", *asked]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_inspect_says_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imitation(tmp_path / "folder", *made())
    assert main(["demos", "inspect", str(tmp_path / "folder"), "--env", "swingup"]) == 0
    out = capsys.readouterr().out
    assert "episodes    3, of which 2 terminated" in out
    assert "steps       210; 3 to 200 an episode" in out
    assert "1 called terminal at the horizon are taken for cut there" in out
    assert out.count("#") >= 3
    arguments = ["demos", "import", str(tmp_path / "folder"), "--env", "swingup", "--to"]
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
                demos.read(path, SWINGUP)
            except BadInput as error:
                said = str(error)
            assert said.isprintable(), said
            counts[f"{file.suffix} {'refused' if said else 'taken'}"] += 1
        file.write_bytes(whole)
    tried("damaged files of demonstrations", counts)
    assert all(counts[f"{suffix} refused"] > 50 for suffix in (".npz", ".arrow", ".hdf5", ".parquet"))


def test_pandas_reads_what_was_shown(tmp_path: Path) -> None:
    """The exported arrays are plain: other programs need nothing of this one."""
    demos.write(tmp_path / "d.npz", *made())
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        frame = pd.DataFrame(arrays["act"])
        assert len(frame) == arrays["lengths"].sum()
