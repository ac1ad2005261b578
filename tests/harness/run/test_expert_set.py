"""The shipped experts: whole, of a version, each of its bar; and how they are made."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from envs import EnvSpec
from envs.spec import Shipped
from harness import expert_training
from harness.cli import main
from harness.expert_training import (
    CANDIDATES,
    Candidate,
    Measured,
    is_good,
    measure,
    meets_bar,
    train_all,
)
from harness.judge.results import Cell, CellResult, Conditions, Request, Row
from harness.learn.seeds import held_out_seeds, tuning_seeds
from harness.registry import SPECS, BadInput, all_specs
from harness.run import expert_set, keys
from harness.run.cache import load
from harness.run.environment import CACHE_VARIABLE, numeric
from harness.run.expert_set import shipped
from harness.run.experts import expert_for
from harness.run.files import sha256
from harness.run.keys import EXPERTS, ROOT, cell_keys, experts_version, program
from harness.run.opening import open_for_report, open_for_run
from methods.network import Network

TASKS = tuple(spec.name for spec in all_specs() if spec.shipped)
FOLDER = ROOT / "results/reference/experts"
CONDITIONS = Conditions("smoke", "absorbing", "sbx")


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The shipped experts in a folder of their own, to be changed; what this process takes for the program's
    is read anew."""
    there = tmp_path / "results/reference/experts"
    there.mkdir(parents=True)
    for file in FOLDER.iterdir():
        (there / file.name).write_bytes(file.read_bytes())
    for module in (keys, expert_set):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    program.cache_clear()
    yield there
    program.cache_clear()


@pytest.mark.parametrize("env", TASKS)
def test_every_task_has_experts_with_all_that_is_known_of_them(env: str) -> None:
    lines = (FOLDER / "SHA256SUMS").read_text().splitlines()
    listed = {name: digest for digest, name in (line.split("  ") for line in lines)}
    its = SPECS[env].shipped
    assert its is not None
    for number in range(its.experts):
        for kind in ("expert", "medium"):
            file = FOLDER / f"{env}__{number}{'__medium' * (kind == 'medium')}.safetensors"
            assert listed[file.name] == sha256(file)
            assert file.stat().st_size < 100_000
            found = load(file)
            assert found is not None
            facts = found.facts
            assert (facts["env"], facts["kind"]) == (env, kind)
            assert {
                "seed",
                "settings",
                "curve",
                "origin",
                "seconds",
                "env_steps",
                "check_steps",
            } <= facts.keys()
            assert is_good(Candidate(**{field: facts[field] for field in Candidate._fields}))
    assert {f"{env}__{n}.safetensors" for n in range(its.experts)} <= listed.keys()
    numbers = [shipped(env, seed)[0] for seed in range(2 * its.experts)]
    assert numbers == [*range(its.experts)] * 2


@pytest.mark.parametrize("env", TASKS)
def test_experts_are_as_good_as_they_say_on_a_few_episodes_that_nothing_else_uses(env: str) -> None:
    spec = SPECS[env]
    _, good = shipped(env, 0)
    _, medium = shipped(env, 0, medium=True)
    seeds = held_out_seeds(20)
    best, half = (measure(spec, Network.from_arrays(kept.arrays), seeds) for kept in (good, medium))
    expected, random = good.facts["mean_return"], good.facts["random_return"]
    assert best.mean_return >= expected - 0.05 * (expected - random)
    assert half.mean_return < best.mean_return


def key(env: str) -> str:
    (its,) = cell_keys([Cell(env, "bc", 0)], Conditions("smoke", "absorbing", "sbx"), numeric(False)).values()
    return its


def test_whatever_changes_an_expert_is_another_version_and_damage(copy: Path) -> None:
    version, before = experts_version("cartpole"), key("cartpole")
    other = experts_version("pendulum"), key("pendulum")
    file = copy / "cartpole__1.safetensors"
    file.write_bytes((copy / "cartpole__2.safetensors").read_bytes())
    program.cache_clear()
    assert experts_version("cartpole") != version
    assert key("cartpole") != before
    assert (experts_version("pendulum"), key("pendulum")) == other
    assert shipped("cartpole", 0)
    with pytest.raises(BadInput, match=r"cartpole__1.safetensors is damaged"):
        shipped("cartpole", 1)


def test_a_task_without_shipped_experts_trains_its_own(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    for file in copy.glob("cartpole__*"):
        file.unlink()
    program.cache_clear()
    assert experts_version("cartpole") == ""
    with pytest.raises(BadInput, match="no experts of cartpole are installed"):
        shipped("cartpole", 0)
    conditions = dataclasses.replace(CONDITIONS, rl="sb3")
    assert expert_for("cartpole", 2, conditions).name == "trained:2"


def result(method: str, seed: int = 0) -> CellResult:
    policies = ("expert", "random") if method == "reference" else ("pi_star", "pi_R")
    rows = [Row("cartpole", method, seed, policy, "absorbing", return_mean=1.0) for policy in policies]  # type: ignore[arg-type]
    return CellResult(Cell("cartpole", method, seed), rows)


def test_results_of_two_versions_of_experts_are_never_mixed(
    copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    request = Request(("bc", "shaped"), ("cartpole",), (0,), CONDITIONS)
    out = tmp_path / "run"
    with open_for_run(out, request) as run:
        for method in ("reference", "bc", "shaped"):
            run.save(result(method))
    (copy / "cartpole__0.safetensors").write_bytes((copy / "cartpole__1.safetensors").read_bytes())
    program.cache_clear()
    with open_for_run(out, request) as run:
        found, unusable = run.load()
        assert found == {}
        assert all("its experts" in reason for reason in unusable.values())
        for method in ("reference", "bc"):  # a run that asked for less
            run.save(result(method))
    with open_for_report(out) as run:  # which of no version knows that it is the present one
        found, unusable = run.load()
        assert [cell.method for cell in found] == ["bc", "reference"]
        assert [path.stem for path in unusable] == ["cartpole__shaped__seed0"]
    assert main(["report", str(out)]) == 1
    assert "computed by another version" in capsys.readouterr().err


def test_the_package_brings_them_where_they_are_looked_for() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    repository, installed = EXPERTS
    assert setup["package-dir"] == {installed.replace("/", "."): repository}
    assert installed.replace("/", ".") in setup["packages"]
    assert setup["package-data"][installed.replace("/", ".")] == ["*.safetensors", "SHA256SUMS"]


# How they are made.


def candidate(env: str, seed: int, mean: float) -> Candidate:
    return Candidate(env, seed, "", mean, 0.0, 0.0, mean, 5.0, 1.0, 100, 10, 1.5)


@pytest.fixture
def task(steady: EnvSpec, monkeypatch: pytest.MonkeyPatch) -> EnvSpec:
    spec = dataclasses.replace(steady, shipped=Shipped(steps=1500, bar=9.0))
    monkeypatch.setitem(SPECS, "steady", dataclasses.replace(spec, name="steady"))
    return SPECS["steady"]


def test_an_agent_is_judged_on_tuning_episodes_and_its_files_hold_its_policies(
    task: EnvSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: set[int] = set()
    plain = expert_training.measure

    def spy(spec: EnvSpec, policy: object, seeds: range) -> Measured:
        asked.update(seeds)
        return plain(spec, policy, seeds)  # type: ignore[arg-type]

    monkeypatch.setattr(expert_training, "measure", spy)
    one, expert, medium = expert_training.train("steady", 3)
    assert asked <= set(tuning_seeds(1000))
    assert one.mean_return > 9
    assert one.random_return < one.medium_return < one.mean_return
    assert one.env_steps == 1500
    for data, kind, level in ((expert, "expert", one.mean_return), (medium, "medium", one.medium_return)):
        (tmp_path / "file").write_bytes(data)
        found = load(tmp_path / "file")
        assert found is not None
        assert (found.facts["kind"], found.facts["seed"]) == (kind, 3)
        measured = measure(task, Network.from_arrays(found.arrays), tuning_seeds(200))
        assert measured.mean_return == pytest.approx(level, abs=0.2)
    again = expert_training.train("steady", 3)
    assert again[0]._replace(seconds=0.0) == one._replace(seconds=0.0)


def test_the_first_that_meet_the_bar_are_kept_and_every_agent_is_told(
    task: EnvSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[int] = []

    def launch(env: str, seed: int) -> object:
        trained.append(seed)
        mean = 8.0 if seed in (0, 3) else 9.5  # two below the bar
        one = candidate(env, seed, mean)
        future: expert_training.Future[object] = expert_training.Future()
        future.set_result((one, f"expert {seed}".encode(), f"medium {seed}".encode()))
        return future

    monkeypatch.setattr(expert_training, "in_a_process", lambda **_: lambda function: launch)
    train_all(("steady",), tmp_path, workers=2)
    kept = {file.name: file.read_text() for file in tmp_path.glob("steady__*")}
    good = [1, 2, 4, 5, 6]
    assert kept == {
        f"steady__{number}{'__medium' * (kind == 'medium')}.safetensors": f"{kind} {seed}"
        for number, seed in enumerate(good)
        for kind in ("expert", "medium")
    }
    lines = (tmp_path / CANDIDATES).read_text().splitlines()[1:]
    assert [line.split(",")[1:3] for line in lines] == [
        [str(seed), str(good.index(seed)) if seed in good else ""] for seed in sorted(trained)
    ]
    assert sorted(path.name for path in tmp_path.glob(".*")) == [".lock"]
    before = list(trained)
    (tmp_path / "notes").write_text("a user's own")
    train_all(("steady",), tmp_path, workers=2)
    assert trained == before
    assert {file.name: file.read_text() for file in tmp_path.glob("steady__*")} == kept
    listed = [line.split("  ")[1] for line in (tmp_path / "SHA256SUMS").read_text().splitlines()]
    assert listed == ["candidates.csv", *sorted(kept)]
    (tmp_path / "steady__2__medium.safetensors").unlink()
    train_all(("steady",), tmp_path, workers=2)
    assert trained == [*before, good[2]]
    assert {file.name: file.read_text() for file in tmp_path.glob("steady__*")} == kept
    assert (tmp_path / CANDIDATES).read_text().splitlines()[1:] == lines


@pytest.mark.parametrize(("early", "good"), [(1 - 0.99, True), (0.01, True), (0.011, False)])
def test_a_bar_may_be_reached_exactly(early: float, good: bool) -> None:
    assert meets_bar(SPECS["highway"], Measured(67.0, early)) == good
    assert not meets_bar(SPECS["highway"], Measured(66.99, 0.0))


@pytest.mark.parametrize(
    ("early", "medium", "good"),
    [(0.005, 38.0, True), (0.006, 38.0, False), (0.0, 30.0, True), (0.0, 26.0, False), (0.0, 50.0, False)],
)
def test_an_expert_has_a_margin_to_its_bar_and_a_medium_one_of_about_half(
    early: float, medium: float, good: bool
) -> None:
    one = Candidate("highway", 0, "", 68.0, early, 0.005, 68.0, medium, 8.0, 100, 10, 1.5)
    assert is_good(one) == good
    assert not is_good(one._replace(confirmed=0.0055))


def test_too_few_good_agents_are_told(task: EnvSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def launch(env: str, seed: int) -> object:
        future: expert_training.Future[object] = expert_training.Future()
        future.set_result((candidate(env, seed, 8.0), b"", b""))
        return future

    monkeypatch.setattr(expert_training, "in_a_process", lambda **_: lambda function: launch)
    with pytest.raises(BadInput, match="steady: 0 of 20 agents meet the bar, 5 are needed"):
        train_all(("steady",), tmp_path, workers=2)


@pytest.mark.parametrize("name", ["SHA256SUMS", "notes", "cartpole__0.safetensors", "photos/one", ".lock"])
def test_experts_are_trained_into_nobody_elses_folder(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("a user's own")
    assert main(["experts", "train", "cartpole", "--dir", str(tmp_path)]) == 2
    assert "is not empty and holds no experts (no candidates.csv)" in capsys.readouterr().err
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()] == [name]
    assert (tmp_path / name).read_text() == "a user's own"


@pytest.mark.parametrize("what", ["train", "check"])
def test_a_task_without_experts_is_refused(
    tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["experts", what, "gridworld", "--dir", str(tmp_path / "new")]) == 2
    assert "no experts of gridworld" in capsys.readouterr().err
    for every in (["swingup, all"], ["swingup", "all"]):
        assert main(["experts", "check", *every, "--dir", str(tmp_path / "new")]) == 2
        assert "holds no experts of" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("there", [False, True])
def test_where_nothing_is_checked_nothing_is_good(
    tmp_path: Path, there: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["experts", "check", "cartpole", "--dir", str(tmp_path if there else tmp_path / "no")]) == 2
    assert "holds no experts of cartpole" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "env,seed\ncartpole,x\n"])
def test_a_damaged_list_of_candidates_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / CANDIDATES).write_text(text)
    with pytest.raises(BadInput, match="is damaged"):
        train_all(("cartpole",), tmp_path, workers=1)


def test_check_measures_on_held_out_episodes_and_names_what_misses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("cartpole__0.safetensors", "cartpole__0__medium.safetensors"):
        (tmp_path / name).write_bytes((FOLDER / name).read_bytes())
    asked: list[range] = []
    returns = iter([499.0, 250.0, 500.0, 250.0])

    def measured(spec: EnvSpec, policy: object, seeds: range) -> Measured:
        asked.append(seeds)
        return Measured(next(returns), 0.0)

    monkeypatch.setattr(expert_training, "measure", measured)
    assert main(["experts", "check", "cartpole", "--dir", str(tmp_path)]) == 1
    assert "cartpole__0.safetensors: mean return 499.00, 0.0% ended early MISSED" in capsys.readouterr().out
    assert main(["experts", "check", "cartpole", "--dir", str(tmp_path)]) == 0
    assert set(asked) == {held_out_seeds(1000)}
