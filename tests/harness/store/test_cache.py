"""What is kept between runs: computed once, whole or not at all, under a key of all that can change it."""

import os
from pathlib import Path

import numpy as np
import pytest

from harness.cell import experts
from harness.cell import shared as shared_module
from harness.cell.experts import source_for
from harness.cell.shared import Shared, prepare
from harness.process.environment import CACHE_VARIABLE, SAME_INSTRUCTIONS
from harness.records import Conditions, Shown
from harness.registry import packages
from harness.registry.keys import experts_version, program
from harness.store.cache import Kept, cache_file, kept, load

VALUE = Kept({"x": np.linspace(0, 1, 50), "y": np.ones((2, 3))}, {"seconds": 1.5, "curve": [[1, 2.5]]})
CONDITIONS = Conditions("smoke", "absorbing", "sb3")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def never(*_: object) -> Kept:
    pytest.fail("computed again")


def assert_same(found: Kept) -> None:
    assert found.facts == VALUE.facts
    assert found.arrays.keys() == VALUE.arrays.keys()
    for name, array in VALUE.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)


def test_it_is_computed_once_and_whatever_bit_is_flipped_again(folder: Path) -> None:
    assert kept("thing", "cartpole", ["smoke"], lambda: VALUE) is VALUE
    assert_same(kept("thing", "cartpole", ["smoke"], never))
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for place in map(int, np.random.default_rng(0).integers(len(whole), size=200)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        if found := load(path):  # Spaces that fill up the header may be anything.
            assert_same(found)
    for damaged in (b"", whole[: len(whole) // 2], bytes(range(256)) * 9, b"{}"):
        path.write_bytes(damaged)
        assert load(path) is None
    path.unlink()
    os.mkfifo(path)
    assert load(path) is None
    kept("thing", "cartpole", ["smoke"], lambda: VALUE)
    assert_same(kept("thing", "cartpole", ["smoke"], never))


def test_what_all_methods_share_is_made_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    conditions = Conditions("smoke", "absorbing", "sb3", experts="trained")
    asked = ("cartpole", 3, [Shown(4), Shown(5)], conditions)
    source = source_for("cartpole", 3, conditions)
    one, demos = source.expert, source.demonstrations(Shown(4))
    shared = Shared(prepare(*asked))
    before = len(list(folder.iterdir()))
    for module, names in ((experts, ("solver_for", "Simulator")), (shared_module, ("replay", "ranked"))):
        for name in names:
            monkeypatch.setattr(module, name, never)
    again = Shared(prepare(*asked))
    for other in (shared, again):
        its, drawn = other.expert, other.demonstrations(Shown(4))
        assert (one.name, one.curve, one.seconds) == (its.name, its.curve, its.seconds)
        np.testing.assert_array_equal(one.policy(np.eye(4)), its.policy(np.eye(4)))
        for mine, theirs in zip((*demos.obs, *demos.act), (*drawn.obs, *drawn.act), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert len(other.demonstrations(Shown(5))) == 5
    for name, array in vars(shared.replays).items():
        np.testing.assert_array_equal(getattr(again.replays, name), array)
    assert len(list(folder.iterdir())) == before == 5
    with pytest.raises(pytest.fail.Exception, match="again"):
        prepare("cartpole", 4, [Shown(4)], conditions)


def test_run_seeds_take_the_shipped_experts_in_turn() -> None:
    names = [source_for("cartpole", seed, CONDITIONS).expert.name for seed in range(7)]
    version = experts_version("cartpole")
    assert names == [f"{version}:{seed % 5}" for seed in range(7)]


def test_whatever_can_change_it_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    def key(name: str = "expert", env: str = "cartpole", asked: object = "smoke") -> Path:
        return cache_file(name, env, asked)

    for variable in SAME_INSTRUCTIONS:  # which whoever runs this may have set
        monkeypatch.delenv(variable, raising=False)
    keys = [key(), key("other"), key(env="pendulum"), key(asked="quick")]
    with monkeypatch.context() as changed:
        changed.setattr(packages, "version_of", lambda package: "0")
        keys.append(key())
    for variable, value in SAME_INSTRUCTIONS.items():
        with monkeypatch.context() as changed:
            changed.setenv(variable, value)
            keys.append(key())
    with monkeypatch.context() as changed:
        changed.setattr(Path, "read_bytes", lambda path: b"pass")
        program.cache_clear()
        keys.append(key())
    program.cache_clear()
    assert len(set(keys)) == len(keys)
    assert key() == keys[0]
