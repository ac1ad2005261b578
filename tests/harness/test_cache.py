"""What is kept between runs: computed once, whole or not at all, under a key of all that can change it."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from envs import SPECS, EnvSpec
from harness import cache, experts
from harness.cache import Kept, cache_file, kept, load
from harness.environment import CACHE_VARIABLE, DEFAULT_CACHE, SAME_INSTRUCTIONS
from harness.experts import deviations_for, expert_for
from harness.keys import program
from harness.results import Library
from harness.rl_settings import SETTINGS, Settings

CARTPOLE = SPECS["cartpole"]
VALUE = Kept({"x": np.linspace(0, 1, 50), "y": np.ones((2, 3))}, {"seconds": 1.5, "curve": [[1, 2.5]]})


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def never() -> Kept:
    pytest.fail("computed again")


def test_it_is_computed_once(folder: Path) -> None:
    first = kept("thing", CARTPOLE, "smoke", "sb3", lambda: VALUE)
    again = kept("thing", CARTPOLE, "smoke", "sb3", never)
    assert first is VALUE
    assert again.facts == VALUE.facts
    assert again.arrays.keys() == VALUE.arrays.keys()
    for name, array in VALUE.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)
    assert [path.name.split("__")[:3] for path in folder.iterdir()] == [["thing", "cartpole", "smoke"]]


def test_whatever_bit_is_flipped_it_is_computed_again(folder: Path) -> None:
    kept("thing", CARTPOLE, "smoke", "sb3", lambda: VALUE)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    places = [int(place) for place in rng.integers(len(whole), size=200)]
    for place in places:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        found = load(path)
        # What is not read, such as spaces that fill up the header, may be anything.
        assert found is None or (found.facts == VALUE.facts and found.arrays.keys() == VALUE.arrays.keys())
        assert found is None or all(np.array_equal(found.arrays[n], VALUE.arrays[n]) for n in VALUE.arrays)
    for damaged in (b"", whole[: len(whole) // 2], bytes(range(256)) * 9, b"{}"):
        path.write_bytes(damaged)
        assert load(path) is None
    kept("thing", CARTPOLE, "smoke", "sb3", lambda: VALUE)
    again = load(path)
    assert again is not None
    assert again.facts == VALUE.facts
    path.unlink()
    assert load(path) is None


@pytest.mark.parametrize("kind", ["a file", "of a stranger", "full"])
def test_where_it_cannot_be_written_it_is_kept_for_the_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    if kind == "a file":
        folder.write_text("mine")
    write = cache.write_atomic

    def refuse(path: Path, data: bytes) -> None:
        if path.parent == folder:
            raise OSError(28, "No space left on device")
        write(path, data)

    if kind != "a file":
        monkeypatch.setattr(cache, "write_atomic", refuse)
    assert kept("thing", CARTPOLE, "smoke", "sb3", lambda: VALUE) is VALUE
    assert kept("thing", CARTPOLE, "smoke", "sb3", never).facts == VALUE.facts
    assert len(list((tmp_path / "run/cache").iterdir())) == 1


def test_no_name_is_the_usual_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, "")
    assert cache_file("thing", CARTPOLE, "smoke", "sb3").parent == DEFAULT_CACHE
    assert Path("results/cache") == DEFAULT_CACHE


@pytest.mark.parametrize("kind", ["deep", "pipe", "folder", "link"])
def test_what_is_odd_there_is_computed_again(folder: Path, kind: str) -> None:
    kept("thing", CARTPOLE, "smoke", "sb3", lambda: VALUE)
    (path,) = folder.iterdir()
    path.unlink()
    if kind == "deep":
        facts = "[" * 100_000
        metadata = {"facts": facts, "checksum": cache._checksum(VALUE.arrays, facts)}
        path.write_bytes(safetensors.numpy.save(VALUE.arrays, metadata))
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    assert load(path) is None


def test_an_expert_and_its_advantages_are_computed_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, sample = expert_for("cartpole", "smoke", "sb3"), deviations_for("cartpole", "smoke", "sb3", 3)
    for name in ("solver_for", "deviations"):
        monkeypatch.setattr(experts, name, lambda *_: never())
    other, again = expert_for("cartpole", "smoke", "sb3"), deviations_for("cartpole", "smoke", "sb3", 3)
    obs = np.eye(4)
    np.testing.assert_array_equal(one.policy(obs), other.policy(obs))
    assert one.curve == other.curve
    assert one.seconds == other.seconds > 0
    for name, array in vars(sample).items():
        np.testing.assert_array_equal(getattr(again, name), array)
    assert len(list(folder.iterdir())) == 2
    with pytest.raises(pytest.fail.Exception, match="again"):
        deviations_for("cartpole", "smoke", "sb3", 4)


def test_whatever_can_change_it_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    def key(
        name: str = "expert", spec: EnvSpec = CARTPOLE, budget: str = "smoke", library: Library = "sb3"
    ) -> Path:
        return cache_file(name, spec, budget, library)

    longer = dataclasses.replace(CARTPOLE, rl_steps={**CARTPOLE.rl_steps, "smoke": 2000})
    keys = [key(), key("other"), key(spec=SPECS["pendulum"]), key(budget="quick"), key(library="sbx")]
    keys.append(key(spec=longer))
    with monkeypatch.context() as changed:
        changed.setitem(SETTINGS, "cartpole", Settings(noise=0.5))
        keys.append(key())
    with monkeypatch.context() as changed:
        changed.setattr(importlib.metadata, "version", lambda package: "0")
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
