"""Choices of files: numbers, parts of combinations, and observations that the task makes vectors."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from envs import EnvSpec, from_gymnasium
from harness.demonstrations import units
from harness.demonstrations.reading import read
from harness.demonstrations.recording import Reading
from methods.base import Episodes
from tests.harness.demonstrations.made_demonstrations import CHOICES, FORMS, minari_folder, refused
from tests.harness.odd_env import Odd

pytestmark = pytest.mark.usefixtures("read_here", "own_cache")
LAKE = from_gymnasium("FrozenLake-v1", "lake")
STATES = np.array([0, 4, 8, 15])


def of_steps(path: Path, act: Any, obs: Any = None) -> Path:
    """Make a file of D4RL's arrays, of one episode that terminates."""
    count = len(act)
    obs = np.zeros((count, 2)) if obs is None else obs
    np.savez(path, observations=obs, actions=act, terminals=np.arange(count) == count - 1)
    return path


def chosen(path: Path, spec: EnvSpec) -> list[int]:
    return np.concatenate(read(path, spec, how=Reading("repeat")).episodes.act).argmax(axis=1).tolist()


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int32, np.uint8, bool])
@pytest.mark.parametrize("shape", [(3,), (3, 1)])
def test_numbers_of_choices_may_have_any_type(tmp_path: Path, kind: Any, shape: tuple[int, ...]) -> None:
    act = np.array([0, 1, 1], kind).reshape(shape)
    assert chosen(of_steps(tmp_path / "d.npz", act, np.zeros((3, 4))), CHOICES) == [0, 1, 1]


@pytest.mark.parametrize(
    ("act", "why"),
    [
        ([0, 0.5, 1], "its choices must be whole numbers from 0 to 1"),
        ([0, np.nan, 1], "its choices must be whole numbers from 0 to 1"),
        (np.zeros((3, 5)), "it has actions float64 (3, 5); for each step the number of a choice is needed"),
    ],
)
def test_what_is_no_number_of_a_choice_is_refused(tmp_path: Path, act: Any, why: str) -> None:
    path = of_steps(tmp_path / "d.npz", np.array(act), np.zeros((3, 4)))
    refused(path, why, CHOICES, how=Reading("repeat"))


PARTS = spaces.MultiDiscrete([2, 3], start=[3, 5])
COMBINED: dict[str, tuple[spaces.Space[Any], Any, list[int]]] = {
    "parts": (PARTS, [[3, 5], [4, 7]], [0, 5]),
    "numbers of combinations": (PARTS, [0, 5], [0, 5]),
    "flags": (spaces.MultiBinary(2), [[0, 1], [1, 1]], [1, 3]),
    "whole numbers": (spaces.Box(-1, 1, (1,), np.int32), [[-1], [1]], [0, 2]),
    "a table": (spaces.MultiDiscrete([[2, 2, 1]]), [[1, 0, 0], [1, 1, 0]], [2, 3]),
    "as many parts as choices": (spaces.MultiDiscrete([2, 1]), [[0, 0], [1, 0]], [0, 1]),
}


@pytest.mark.parametrize("what", COMBINED)
def test_parts_of_a_choice_are_read_as_the_combination(
    what: str, task: Callable[..., str], tmp_path: Path
) -> None:
    space, act, expected = COMBINED[what]
    spec = from_gymnasium(task(act=space), "odd")
    assert chosen(of_steps(tmp_path / "d.npz", np.array(act)), spec) == expected


@pytest.mark.parametrize("form", FORMS)
def test_minaris_parts_of_choices_are_read_as_the_combination(
    form: str, task: Callable[..., str], tmp_path: Path
) -> None:
    spec = from_gymnasium(task(act=PARTS), "odd")
    content = Episodes((np.zeros((3, 2)),), (np.eye(6)[[5, 0]],), (True,)), [np.zeros(2)]
    path = minari_folder(tmp_path / "d", form, content, PARTS, actions=np.array([[4, 7], [3, 5]]))
    assert read(path, spec).episodes.act[0].argmax(axis=1).tolist() == [5, 0]
    path = of_steps(tmp_path / "odd.npz", np.array([[3, 5], [3, 8]]))
    refused(path, "has the action [3, 8], which is none of the task's 6", spec, how=Reading("repeat"))


@pytest.mark.parametrize("form", FORMS)
def test_minaris_numbers_of_states_are_read_as_the_task_observes_them(form: str, tmp_path: Path) -> None:
    content = Episodes((np.eye(16)[STATES],), (np.eye(4)[[1, 1, 2]],), (True,)), [np.array([0.0, 0, 1])]

    def folder(name: str, space: spaces.Space[Any], states: Any = STATES) -> Path:
        return minari_folder(
            tmp_path / name, form, content, spaces.Discrete(4), observations=states, observation_space=space
        )

    result = read(folder("d", spaces.Discrete(16)), LAKE)
    np.testing.assert_array_equal(result.episodes.obs[0], content[0].obs[0])
    assert result.episodes.act[0].argmax(axis=1).tolist() == [1, 1, 2]
    said = "its observations are numbers from 0 to 63, and the task's are Discrete(16)"
    refused(folder("large", spaces.Discrete(64)), said, LAKE)
    refused(folder("of_others", spaces.Discrete(16)), "and the task's are vectors", CHOICES)


def test_states_that_the_task_does_not_have_are_refused(tmp_path: Path) -> None:
    path = of_steps(tmp_path / "d.npz", np.array([1, 1]), np.array([0, 16]))
    refused(path, "it observes 16 as obs, which is a number from 0 to 15", LAKE, how=Reading("repeat"))


@pytest.mark.parametrize("form", FORMS)
def test_parts_of_observations_are_chosen_by_key_and_made_vectors(
    form: str, task: Callable[..., str], tmp_path: Path
) -> None:
    place = spaces.Box(-2.0, 2.0, (2,), np.float32)
    space = spaces.Dict({"car": spaces.Dict({"gear": spaces.Discrete(3), "place": place})})

    class Car(Odd):
        observation_space = space

        def seen(self) -> Any:
            return {"car": {"gear": 2, "place": np.zeros(2, np.float32)}}

    spec = from_gymnasium(task(Car), "car")
    seen = {"car": {"gear": np.array([0, 2]), "place": np.array([[1, 2], [-1, 0]], np.float32)}}
    content = Episodes((np.zeros((2, 5)),), (np.zeros((1, 2)),), (True,)), [np.zeros(1)]
    path = minari_folder(tmp_path / "d", form, content, observations=seen, observation_space=space)
    refused(path, "its observations are car/gear (1), car/place (2); give those of the task", spec)
    result = read(path, spec, how=Reading(obs_keys=("car/gear", "car/place")))
    assert result.episodes.obs[0].tolist() == [[1, 0, 0, 1, 2], [0, 0, 1, -1, 0]]


def test_demonstrations_of_combinations_come_back_from_minari(
    tmp_path: Path, task: Callable[..., str]
) -> None:
    from harness.demonstrations import minari

    spec = from_gymnasium(task(act=PARTS), "odd")
    assert units.first_choice(spec.make()) == 0
    shown = Episodes((np.zeros((4, 2)),), (np.eye(6)[[3, 5, 0]],), (True,))
    minari.write(tmp_path / "new", "irl-bench/odd/expert-v0", spec, shown, [np.zeros(3)], 0)
    assert read(tmp_path / "new", spec).episodes.act[0].argmax(axis=1).tolist() == [3, 5, 0]
