"""Actions of a file are in the task's own bounds, unless the file or the user says otherwise."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import RescaleAction

from envs import EnvSpec, from_gymnasium
from envs.scaled import scaled
from harness.cli.arguments import parser
from harness.demonstrations.description import described
from harness.demonstrations.reading import read, write
from methods.base import Episodes
from tests.harness.demonstrations.made_demonstrations import SWINGUP, imitation, refused

pytestmark = pytest.mark.usefixtures("read_here")
PAIR = spaces.Box(np.float32([-2, 0]), np.float32([1, 5]))
NATIVE = np.array([[-2, 0], [1, 5], [-0.5, 2.5], [0.25, 1.25]])
MADE = np.array([[-1, -1], [1, 1], [0, 0], [0.5, -0.5]])


def old_imitation(path: Path, act: Any, obs_size: int = 2) -> Path:
    """A file of `imitation` before 1.0, of one episode."""
    obs, ends = np.zeros((len(act) + 1, obs_size)), np.array([True])
    np.savez(path, obs=obs, acts=act, indices=np.array([], int), terminal=ends)
    return path


@pytest.fixture
def pair(task: Callable[..., str]) -> EnvSpec:
    """A task whose actions have other bounds each."""
    return from_gymnasium(task(act=PAIR), "odd")


def asked(*words: str) -> Any:
    pairs = parser().parse_args(["run", *(f"--action-bounds={word}" for word in words)]).action_bounds
    return None if pairs is None else np.array(pairs, np.float64).T


def is_refused(path: Path, why: str, spec: EnvSpec, *words: str) -> None:
    refused(path, why, spec, asked(*words))


def act(path: Path, spec: EnvSpec, *words: str) -> list[Any]:
    (found,) = read(path, spec, asked(*words)).episodes.act
    return found.tolist()


def test_others_files_are_in_the_tasks_own_bounds_component_by_component(
    tmp_path: Path, pair: EnvSpec
) -> None:
    file = old_imitation(tmp_path / "d.npz", NATIVE)
    folder = imitation(
        tmp_path / "d", Episodes((np.zeros((5, 2)),), (MADE,), (True,)), [np.zeros(4)], 1, [NATIVE]
    )
    assert act(file, pair) == act(folder, pair) == act(file, pair, "-2,1", "0,5") == MADE.tolist()
    small = old_imitation(tmp_path / "small.npz", NATIVE[2:3] * [1, 0.2])  # all within [-1, 1]
    assert act(small, pair) == [[0, -0.8]]
    assert act(small, pair, "scaled") == act(small, pair, "-1,1") == [[-0.5, 0.5]]
    is_refused(
        file, "have other bounds each, in the task [-2, 1] x [0, 5]; give --action-bounds for", pair, "-2,5"
    )
    is_refused(file, "is given 3 times, and its actions have 2 components", pair, "-2,1", "0,5", "0,5")
    is_refused(file, "4 of 4 actions (1e+02 %) are outside of [-1, 0] x [0, 1]", pair, "-1,0", "0,1")


@pytest.mark.parametrize(
    "wrap", [scaled, lambda env: scaled(RescaleAction(env, np.float32(0), np.float32(3)))]
)
def test_bounds_beneath_wrappers_that_scale_are_found(tmp_path: Path, pair: EnvSpec, wrap: Any) -> None:
    file = old_imitation(tmp_path / "d.npz", NATIVE)
    assert act(file, replace(pair, wrap=wrap)) == MADE.tolist()


def test_where_a_wrapper_does_more_than_scale_the_user_is_asked(tmp_path: Path, pair: EnvSpec) -> None:
    space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def wrap(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        return gym.wrappers.TransformAction(
            env, lambda act: PAIR.low + np.square(act) * (PAIR.high - PAIR.low), space
        )

    spec, file = replace(pair, wrap=wrap), old_imitation(tmp_path / "d.npz", MADE)
    is_refused(file, "a wrapper of the task changes its actions", spec)
    assert act(file, spec, "scaled") == MADE.tolist()


def test_a_task_that_is_a_public_one_of_other_bounds_asks_which_are_meant(tmp_path: Path) -> None:
    """Torques of Pendulum-v1 within 0.9 of 2 were taken for scaled."""
    within = np.array([[0.9], [-0.5]])
    file = old_imitation(tmp_path / "d.npz", within, 3)
    is_refused(file, "may be in [-2, 2], as in the public environment, or in [-1, 1]", SWINGUP)
    assert np.allclose(act(file, SWINGUP, "-2,2"), within / 2)
    assert act(file, SWINGUP, "scaled") == within.tolist()
    assert np.allclose(act(old_imitation(tmp_path / "e.npz", 2 * within, 3), SWINGUP), within)


def test_own_files_are_scaled_and_say_so(tmp_path: Path, pair: EnvSpec) -> None:
    write(tmp_path / "new.npz", Episodes((np.zeros((5, 2)),), (MADE,), (True,)))
    with np.load(tmp_path / "new.npz") as arrays:
        there = dict(arrays)
    assert there.pop("act_bounds").tolist() == [[-1, -1], [1, 1]]
    np.savez(tmp_path / "old.npz", **there)
    for name, why in (("new", "as the file says"), ("old", "by this project's form")):
        found = read(tmp_path / f"{name}.npz", pair)
        assert found.units is not None
        assert (found.episodes.act[0].tolist(), found.units.why) == (MADE.tolist(), why)
    is_refused(tmp_path / "new.npz", "contradicts the file, which says [-1, 1]", pair, "-2,1", "0,5")
    np.savez(tmp_path / "native.npz", **there | {"act": NATIVE, "act_bounds": [[-2, 0], [1, 5]]})
    assert act(tmp_path / "native.npz", pair) == MADE.tolist()
    for name, odd, said in (
        ("flat", [-2, 1], "its bounds (2,) are no (2, A) of lows and highs"),
        ("other", [[-2, 0], [1, 6]], "its actions are in [-2, 1] x [0, 6], and the task's in [-1, 1] or "),
    ):
        np.savez(tmp_path / f"{name}.npz", **there | {"act_bounds": np.array(odd)})
        is_refused(tmp_path / f"{name}.npz", said, pair)


def test_a_few_actions_outside_are_refused_with_the_advice_to_clip_them(
    tmp_path: Path, pair: EnvSpec
) -> None:
    act = np.zeros((20, 2))
    act[7] = [1.25, 0]
    is_refused(
        old_imitation(tmp_path / "d.npz", act),
        "1 of 20 actions (5 %) are outside of [-2, 1] x [0, 5], by 0.25 at most, in act 0; if the "
        "environment clipped them, clip them in the file",
        pair,
    )


def test_actions_that_rounding_put_outside_are_clipped_and_counted(tmp_path: Path, pair: EnvSpec) -> None:
    rounded = NATIVE + np.array([[0, 0], [1e-7, 0], [0, 0], [0, 0]])
    demonstrations = read(old_imitation(tmp_path / "d.npz", rounded), pair)
    assert (demonstrations.episodes.act[0].tolist(), demonstrations.clipped) == (MADE.tolist(), 1)
    assert "clipped     1 actions" in "\n".join(described(demonstrations, pair))
