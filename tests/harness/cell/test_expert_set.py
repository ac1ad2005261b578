"""The shipped experts: whole, of a version, each as good as its file says."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.benchmarks.expert_training import Candidate, is_good, measure
from harness.cell.experts import source_for
from harness.cell.shipped import shipped_experts
from harness.process.environment import numeric
from harness.records import Cell, Conditions
from harness.registry import SPECS, BadInput, all_specs, keys
from harness.registry.keys import EXPERTS, ROOT, cell_keys, experts_version, program
from harness.rl.seeds import held_out_seeds
from harness.store.cache import as_bytes, from_bytes

TASKS = tuple(spec.name for spec in all_specs() if spec.shipped)
FOLDER = ROOT / EXPERTS[0]
CONDITIONS = Conditions("smoke", "absorbing", "sbx")


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
    names = [source_for(env, seed, CONDITIONS).expert.name for seed in (0, len(experts) - 1, len(experts))]
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
        return experts_version(env), *cell_keys([Cell(env, "bc", 0)], CONDITIONS, numeric(False)).values()

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
