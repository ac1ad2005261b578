"""A run whose methods are shown the demonstrations of a file, with and without an expert."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from harness import commands
from harness import demonstrations as demos
from harness.cli import main
from harness.judge.leaderboard import scored_rows
from harness.judge.results import Cell, Conditions, Shown
from harness.run import experts, given
from harness.run.cells import prepare, run_cell
from harness.run.experts import Shared
from tests.harness.made_demonstrations import SWINGUP, made, same
from tests.harness.small_runs import stored as asked

pytestmark = pytest.mark.usefixtures("own_cache")


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
    stored = asked(tmp_path / "run", "request", "run")["conditions"]
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
        (["--envs", "swingup", "--baseline", "no_such_run"], "no_such_run"),
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
    assert [file.name for file in tmp_path.iterdir()] == ["d.npz"]


def test_pandas_reads_what_was_shown(tmp_path: Path) -> None:
    """The exported arrays are plain: other programs need nothing of this one."""
    demos.write(tmp_path / "d.npz", *made())
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        frame = pd.DataFrame(arrays["act"])
        assert len(frame) == arrays["lengths"].sum()
