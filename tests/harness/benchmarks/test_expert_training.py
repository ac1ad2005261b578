"""Agents are trained until enough meet their bar, and experts are measured."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.spec import Shipped as Training
from harness.benchmarks import expert_files, expert_training
from harness.benchmarks.expert_files import CANDIDATES, Future, train_all
from harness.benchmarks.expert_training import Candidate, Measured, is_good, measure, meets_bar
from harness.cell.shipped import ShippedExpert, from_file, shipped_experts, to_file
from harness.cli.main import main
from harness.registry import SPECS, BadInput
from harness.rl.seeds import held_out_seeds, tuning_seeds
from methods.network import Network


def agent(seed: int) -> ShippedExpert:
    """Return an agent whose networks are numbered by its seed."""
    expert, medium = (
        Network(np.zeros(1), np.ones(1), (np.full((1, 1), seed + x),), (np.zeros(1),)) for x in (0.0, 0.5)
    )
    return ShippedExpert(expert, medium, {"seed": seed})


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch, steady: EnvSpec) -> list[int]:
    """The seeds of agents, as they are trained at once; those of 0 and 3 and from 10 on miss the bar."""
    spec = dataclasses.replace(steady, name="steady", shipped=Training(steps=1500, bar=9.0, episodes=200))
    monkeypatch.setitem(SPECS, "steady", spec)
    seeds: list[int] = []

    def launch(env: str, seed: int) -> object:
        seeds.append(seed)
        mean = 8.0 if seed in (0, 3, *range(10, 20)) else 9.5
        future: Future[object] = Future()
        judged = Candidate(env, seed, "", mean, 0.0, 0.0, mean, 5.0, 1.0, 100, 10, 1.5)
        future.set_result((judged, agent(seed)))
        return future

    monkeypatch.setattr(expert_files, "in_a_process", lambda **_: lambda function: launch)
    return seeds


def test_an_agent_is_judged_on_tuning_episodes_and_its_file_holds_its_policies(
    trained: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: set[int] = set()

    def spy(spec: EnvSpec, policy: Any, seeds: range) -> Measured:
        asked.update(seeds)
        return measure(spec, policy, seeds)

    monkeypatch.setattr(expert_training, "measure", spy)
    one, agent = expert_training.train("steady", 3)
    assert asked <= set(tuning_seeds(1000))
    assert one.mean_return > 9
    assert one.random_return < one.medium_return < one.mean_return
    assert one.env_steps == 1500
    (stored,) = from_file(to_file("steady", [agent]), "steady")
    assert stored.facts["seed"] == 3
    for policy, level in ((stored.expert, one.mean_return), (stored.medium, one.medium_return)):
        measured = measure(SPECS["steady"], policy, tuning_seeds(200))
        assert measured.mean_return == pytest.approx(level, abs=0.2)


def test_the_first_that_meet_the_bar_are_kept_and_every_agent_is_told(
    trained: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_all(("steady",), tmp_path, workers=2)
    file, before, good = tmp_path / "steady.safetensors", list(trained), [1, 2, 4, 5, 6]
    experts = from_file(file.read_bytes(), "steady")
    assert [one.facts["seed"] for one in experts] == good
    assert [one.medium.weights[0].item() for one in experts] == [seed + 0.5 for seed in good]
    lines = (tmp_path / CANDIDATES).read_text().splitlines()[1:]
    assert [line.split(",")[1:3] for line in lines] == [
        [str(seed), str(good.index(seed)) if seed in good else ""] for seed in sorted(trained)
    ]
    assert sorted(path.name for path in tmp_path.glob(".*")) == [".lock"]
    (tmp_path / "mine.safetensors").write_text("a user's own")
    train_all(("steady",), tmp_path, workers=2)
    assert trained == before
    listed = [line.split("  ")[1] for line in (tmp_path / "SHA256SUMS").read_text().splitlines()]
    assert listed == ["candidates.csv", "steady.safetensors"]
    whole = file.read_bytes()
    for damage in (file.unlink, lambda: file.write_bytes(whole[:-1])):
        damage()
        train_all(("steady",), tmp_path, workers=2)
        assert file.read_bytes() == whole
        assert (tmp_path / CANDIDATES).read_text().splitlines()[1:] == lines
    assert trained == 3 * before
    few = dataclasses.replace(SPECS["steady"], shipped=Training(steps=1500, bar=9.0, experts=9))
    monkeypatch.setitem(SPECS, "steady", few)
    with pytest.raises(BadInput, match="steady: 8 of 20 agents meet the bar, 9 are needed"):
        train_all(("steady",), tmp_path / "few", workers=2)


def test_an_expert_has_a_margin_to_its_bar_which_may_be_reached_exactly_and_a_medium_one_half_of_it() -> None:
    assert meets_bar(SPECS["highway"], Measured(67.0, 1 - 0.99))
    assert not meets_bar(SPECS["highway"], Measured(67.0, 0.011))
    assert not meets_bar(SPECS["highway"], Measured(66.99, 0.0))
    good = Candidate("highway", 0, "", 68.0, 0.005, 0.005, 68.0, 38.0, 8.0, 100, 10, 1.5)
    assert is_good(good)
    for worse in (
        {"terminated": 0.006},
        {"confirmed": 0.0055},
        {"medium_return": 26.0},
        {"medium_return": 50.0},
    ):
        assert not is_good(good._replace(**worse))


def test_experts_are_trained_into_nobody_elses_folder_and_checked_where_there_are_some(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "photos/cartpole.safetensors"
    file.parent.mkdir()
    file.write_text("a user's own")
    for asked, where, why in (
        ("train cartpole", file.parent, "is not empty and holds no experts (no candidates.csv)"),
        ("train gridworld", tmp_path / "new", "no experts of gridworld"),
        ("check swingup", tmp_path / "new", "holds no experts of"),
        ("check cartpole", file.parent, "is damaged"),
    ):
        assert main(["experts", *asked.split(), "--dir", str(where)]) == 2
        assert why in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [file]
    assert file.read_text() == "a user's own"


def test_check_measures_on_held_out_episodes_and_names_what_misses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cartpole.safetensors").write_bytes(to_file("cartpole", shipped_experts("cartpole")[:1]))
    asked: list[range] = []
    returns = iter([499.0, 250.0, 500.0, 250.0])

    def measured(spec: EnvSpec, policy: object, seeds: range) -> Measured:
        asked.append(seeds)
        return Measured(next(returns), 0.0)

    monkeypatch.setattr(expert_files, "measure", measured)
    assert main(["experts", "check", "cartpole", "--dir", str(tmp_path)]) == 1
    assert "cartpole expert0: mean return 499.00, 0.0% ended early MISSED" in capsys.readouterr().out
    assert main(["experts", "check", "cartpole", "--dir", str(tmp_path)]) == 0
    assert set(asked) == {held_out_seeds(1000)}
