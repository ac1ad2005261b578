"""Who demonstrates: the shipped experts, each as good as its file says, or a user's file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from harness.benchmarks.expert_training import Candidate, is_good, measure
from harness.cell import given
from harness.cell.experts import Trained, from_kept, source_for, to_kept
from harness.cell.run import prepare, run_cell
from harness.cell.shared import Shared
from harness.cell.shipped import shipped_experts
from harness.cli import runs
from harness.cli.main import main
from harness.demonstrations.reading import Demonstrations, read, write
from harness.judge.leaderboard import scored_rows
from harness.process.environment import numeric
from harness.records import Cell, Conditions, Shown
from harness.registry import SPECS, BadInput, all_specs, keys
from harness.registry.keys import EXPERTS, ROOT, cell_keys, experts_version, program
from harness.rl.seeds import held_out_seeds
from harness.store.cache import as_bytes, from_bytes
from tests.harness import small_runs
from tests.harness.demonstrations.made_demonstrations import SWINGUP, made, same

pytestmark = pytest.mark.usefixtures("own_cache")
RUN = ["run", "--methods", "bc", "--envs", "swingup", "--out", "run"]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def stored(lengths: tuple[int, ...], factor: float = 1.0) -> Demonstrations:
    """Return demonstrations that a run may name, of a file."""
    episodes, rewards = made(lengths, (False, True, True))
    write(Path("d.npz"), episodes, [factor * paid for paid in rewards])
    found = read(Path("d.npz"), SWINGUP)
    given.store(str(found), found.episodes, found.rewards)
    return found


def test_a_controller_is_the_expert_unless_one_is_to_be_trained() -> None:
    conditions = Conditions("smoke", "absorbing", "sbx")
    expert = source_for("carracing", 3, conditions).expert
    assert expert.name == "controller"
    assert from_kept(to_kept(expert)) == expert
    assert isinstance(source_for("carracing", 3, replace(conditions, experts="trained")), Trained)


def test_a_run_is_shown_what_a_file_holds() -> None:
    found = stored(lengths=(30, 20, 10))
    conditions = Conditions("smoke", "absorbing", "sbx", retrain=False, demonstrations=str(found))
    shown = [Shown(), Shown(2), Shown(2, every=5)]
    cells = [Cell("swingup", "bc", 0, one) for one in shown]
    inputs = prepare(cells, conditions)
    all_three, two, few = (Shared(inputs).demonstrations(one) for one in shown)
    assert same(all_three, found.episodes)
    assert {len(act) for act in two.act} < {30, 20, 10}
    assert few.times is not None
    assert [len(times) for times in few.times] == [int(n) // 5 for n in few.lengths]
    result, _ = run_cell(cells[1], conditions, inputs)
    assert {row.expert for row in result.rows} == {f"file:{found.digest}"}
    assert result.rows[0].pairs == sum(len(act) for act in two.act)
    reference, _ = run_cell(Cell("swingup", "reference", 0), conditions, inputs)
    assert not any(row.expert.startswith("file") for row in reference.rows)
    with pytest.raises(ValueError, match="are gone from the cache"):
        given.stored("other: 3 episodes")


def test_without_an_expert_a_score_of_1_is_what_the_demonstrations_return(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing is trained for it, and rewards are compared in states that a clone visits."""

    def train(*_: object) -> None:
        raise AssertionError("an expert is trained")

    monkeypatch.setattr(Trained, "_train", train)
    found = stored((200, 7, 3), factor=5)
    rewards = found.rewards or ()
    conditions = Conditions("smoke", "absorbing", "sbx", experts="none", demonstrations=str(found))
    cells = [Cell("swingup", method, 0) for method in ("reference", "bc", "control_untrained")]
    inputs = prepare(cells, conditions)
    rows = scored_rows([run_cell(cell, conditions, inputs)[0] for cell in cells])
    by_policy = {(row.method, row.policy): row for row in rows}
    shown, random = by_policy["reference", "demonstrations"], by_policy["reference", "random"]
    discounted = [paid @ SWINGUP.gamma ** np.arange(len(paid)) for paid in rewards]
    assert shown.return_mean == pytest.approx(np.mean([paid.sum() for paid in rewards]))
    assert shown.discounted_mean == pytest.approx(np.mean(discounted))
    assert (shown.episodes, shown.length_mean) == (3, pytest.approx(np.mean(found.episodes.lengths)))
    assert (shown.normalized_score, random.normalized_score) == (1, 0)
    star = by_policy["bc", "pi_star"]
    scale = shown.return_mean - random.return_mean
    assert star.normalized_score == pytest.approx((star.return_mean - random.return_mean) / scale)
    assert {row.expert for row in rows} == {f"file:{found.digest}"}
    assert 0 < by_policy["control_untrained", "pi_R"].reward_distance < 1


def test_without_actions_methods_of_states_learn_and_others_are_skipped(
    capsys: pytest.CaptureFixture[str],
) -> None:
    episodes, rewards = made((30, 20, 10))
    write(Path("d.npz"), replace(episodes, act=tuple(act[:, :0] for act in episodes.act)), rewards)
    found = read(Path("d.npz"), SWINGUP)
    assert not found.episodes.has_actions
    given.store(str(found), found.episodes, found.rewards)
    conditions = Conditions("smoke", "absorbing", "sbx", record="none", demonstrations=str(found))
    learns = ("gail_mean_state", "gaifo", "f_irl", "maxent_state", "control_untrained")
    skipped = ("bc", "gail", "airl_state", "control_clone", "control_shuffled")
    cells = [Cell("swingup", method, 0) for method in (*learns, *skipped)]
    inputs = prepare(cells, conditions)
    rows = [row for cell in cells for row in run_cell(cell, conditions, inputs)[0].rows]
    assert {row.method for row in rows if row.status == "ok"} == {*learns}
    why = "it learns from actions, and the demonstrations have none"
    assert {(row.method, row.reason) for row in rows if row.status != "ok"} == {
        (name, why) for name in skipped
    }
    assert {row.pairs for row in rows} == {0}
    assert main([*RUN, "--demos-from", "d.npz", "--experts", "none"]) == 2
    assert "has no actions to clone in the expert's place" in capsys.readouterr().err
    assert main(["demos", "inspect", "d.npz", "--env", "swingup"]) == 0
    assert "actions     none" in capsys.readouterr().out


def test_episodes_that_were_cut_short_are_no_score(capsys: pytest.CaptureFixture[str]) -> None:
    """What an episode of 7 steps of 200 returns says nothing of the other 193."""
    write(Path("d.npz"), *made(ended=(False, True, False)))
    from_file = [*RUN, "--plan", "--demos-from", "d.npz"]
    assert main(from_file) == 0
    assert main([*from_file, "--experts", "none"]) == 2
    assert "1 of the 3 episodes of" in capsys.readouterr().err
    assert main(["demos", "inspect", "d.npz", "--env", "swingup"]) == 0
    assert "1 neither terminated nor last until the horizon" in capsys.readouterr().out


def test_other_content_is_another_run_and_another_key(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runs, "handle_signals", lambda: None)
    monkeypatch.setattr("harness.schedule.grid.Grid.run", lambda self, cells: None)
    for name, lengths in (("one", (9, 8)), ("two", (9, 7))):
        write(Path(f"{name}.npz"), made(lengths, (True, True))[0])
    assert main([*RUN, "--demos-from", "one.npz", "--plan"]) == 0
    assert {path.name for path in Path().iterdir()} == {"one.npz", "two.npz"}
    main([*RUN, "--demos-from", "one.npz"])
    asked = small_runs.stored(Path("run"), "request", "run")["conditions"]
    assert asked["demonstrations"].endswith(": 2 episodes, 17 steps")
    assert "--demos-from FILE" in Path("run/leaderboard.md").read_text()
    capsys.readouterr()
    assert main([*RUN, "--demos-from", "two.npz"]) == 2
    assert "holds a run with demonstrations" in capsys.readouterr().err
    assert main(RUN) == 2
    assert ": 2 episodes, 17 steps, not none; give another --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--envs swingup,hopper", "is for one environment"),
        ("--experts none --methods dagger", "dagger asks the expert"),
        ("--experts none", "tells no rewards"),
        ("--demos 4", "has 3 demonstrations, not 4"),
        ("--envs hopper", "it has observations float64 (213, 3); (213, 11) are needed"),
        ("--action-bounds=nan,2", "is not a lower number and a higher one"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_anything_is_written(
    capsys: pytest.CaptureFixture[str], words: str, why: str
) -> None:
    episodes, rewards = made()
    write(Path("d.npz"), episodes, None if "no rewards" in why else rewards)
    assert main([*RUN, "--demos-from", "d.npz", *words.split()]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
    assert [file.name for file in Path().iterdir()] == ["d.npz"]


TASKS = tuple(spec.name for spec in all_specs() if spec.shipped)
FOLDER = ROOT / EXPERTS[0]
SMOKE = Conditions("smoke", "absorbing", "sbx")


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Copy the shipped experts into a folder, to be changed, that this process reads anew."""
    there = tmp_path / EXPERTS[0]
    there.mkdir(parents=True)
    for file in FOLDER.glob("cart*.safetensors"):
        (there / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(keys, "ROOT", tmp_path)
    program.cache_clear()
    yield there
    program.cache_clear()


@pytest.mark.parametrize("env", TASKS)
def test_every_task_has_experts_with_all_that_is_known_of_them(env: str) -> None:
    file, experts = FOLDER / f"{env}.safetensors", shipped_experts(env)
    lines = (FOLDER / "SHA256SUMS").read_text().splitlines()
    listed = {name: digest for digest, name in (line.split("  ") for line in lines)}
    assert listed[file.name] == hashlib.sha256(file.read_bytes()).hexdigest()
    training = SPECS[env].shipped
    assert training is not None
    assert len(experts) == training.experts
    for one in experts:
        assert {"seed", "settings", "curve", "origin", "checkpoint", "medium_checkpoint"} <= one.facts.keys()
        assert "(" in one.facts["origin"]["irl-bench"]  # the commit
        assert is_good(Candidate(**{field: one.facts[field] for field in Candidate._fields}))
    names = [source_for(env, seed, SMOKE).expert.name for seed in (0, len(experts) - 1, len(experts))]
    version = experts_version(env)
    assert names == [f"{version}:0", f"{version}:{len(experts) - 1}", f"{version}:0"]


@pytest.mark.parametrize("env", TASKS)
def test_experts_are_as_good_as_they_say_on_a_few_episodes_that_nothing_else_uses(env: str) -> None:
    one, seeds = shipped_experts(env)[0], held_out_seeds(20)
    best, half = (measure(SPECS[env], policy, seeds) for policy in (one.expert, one.medium))
    expected, random = one.facts["mean_return"], one.facts["random_return"]
    assert best.mean_return >= expected - 0.05 * (expected - random)
    assert half.mean_return < best.mean_return


def test_whatever_changes_an_expert_is_another_version_and_damage(copy: Path) -> None:
    def version(env: str) -> tuple[str, ...]:
        program.cache_clear()
        return experts_version(env), *cell_keys([Cell(env, "bc", 0)], SMOKE, numeric(False)).values()

    before = {env: version(env) for env in ("cartpole", "cartpole_discrete")}
    file, other = copy / "cartpole.safetensors", copy / "cartpole_discrete.safetensors"
    content = from_bytes(file.read_bytes())
    content.arrays["expert1/bias0"] = content.arrays["expert1/bias0"] + 1
    file.write_bytes(as_bytes(content))  # with its checksum renewed
    assert all(one != its for one, its in zip(version("cartpole"), before["cartpole"], strict=True))
    assert version("cartpole_discrete") == before["cartpole_discrete"]
    whole = file.read_bytes()
    for odd in (whole[:-1], whole[:-9] + b"x" + whole[-8:], other.read_bytes()):
        file.write_bytes(odd)
        program.cache_clear()
        with pytest.raises(BadInput, match=r"cartpole.safetensors is damaged"):
            shipped_experts("cartpole")
