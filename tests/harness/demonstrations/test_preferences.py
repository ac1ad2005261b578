"""Preferences come from returns or from a file, and reach the methods that are registered for them alone."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from harness.api.request import RunRequest, resolve
from harness.cell import fitting, given
from harness.cell.run import prepare, run_cell
from harness.demonstrations.arrays import from_arrays, to_arrays
from harness.demonstrations.preferences import MOST, by_returns, chosen, in_file
from harness.demonstrations.reading import write
from harness.records import Cell, Conditions
from harness.registry import BadInput
from harness.registry.plugins import method_for
from tests.harness.demonstrations.made_demonstrations import made

pytestmark = pytest.mark.usefixtures("own_cache", "read_here")


@pytest.mark.parametrize(("returns", "pairs"), [([3, 1, 2], 3), ([1, 1, 1, 0], 3), ([5], 0)])
def test_higher_returns_are_preferred_in_all_pairs_of_different_ones(
    returns: list[float], pairs: int
) -> None:
    preferences = by_returns(returns)
    assert len({*map(tuple, preferences.tolist())}) == len(preferences) == pairs
    assert all(returns[worse] < returns[better] for worse, better in preferences)


def test_of_many_episodes_there_are_pairs_near_and_far_but_not_all() -> None:
    preferences = by_returns(np.arange(3000.0))
    assert 0.8 * MOST < len(preferences) < 1.2 * MOST
    distances = np.diff(preferences)[:, 0]
    assert distances.min() < 100 < 2500 < distances.max()


def test_preferences_of_a_file_are_read(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("first,second,better\n0,1,0\n1,2,2\n")
    assert in_file(tmp_path / "p.csv", 3).tolist() == [[1, 0], [1, 2]]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("first,second\n0,1\n", "the columns first, second, better are needed"),
        ("first,second,better\n0,3,0\n", "two numbers of episodes, 0 to 2"),
        ("first,second,better\n0,1,2\n", "and the better one again"),
        ("first,second,better\n1,1,1\n", "two numbers of episodes"),
        ("first,second,better\n0,a,0\n", "two numbers of episodes"),
        ("", "are needed: No columns"),
    ],
)
def test_other_files_are_refused_in_a_line(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(BadInput, match=why) as error:
        in_file(tmp_path / "p.csv", 3)
    assert str(error.value).isprintable()


def test_preferences_go_with_their_episodes() -> None:
    episodes = replace(made()[0], preferences=np.array([[0, 1], [2, 1], [0, 2]]))
    again = from_arrays(to_arrays(episodes))
    assert again.preferences is not None
    assert again.preferences.tolist() == [[0, 1], [2, 1], [0, 2]]
    some = chosen(again, np.array([1, 2]))
    assert some.preferences is not None
    assert (some.preferences.tolist(), some.lengths.tolist()) == ([[1, 0]], [7, 3])
    every_other = episodes.every(2, np.random.default_rng(0))
    assert every_other.preferences is episodes.preferences


def test_only_methods_that_are_registered_for_them_see_preferences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, preferred = tmp_path / "d.npz", tmp_path / "p.csv"
    write(path, *made((30, 20, 10)))
    preferred.write_text("first,second,better\n0,1,0\n")
    asked = RunRequest(methods=["bc", "trex"], envs=["swingup"], demos_from=path, preferences=preferred)
    request, found = resolve(asked, True)
    assert found is not None
    assert ", preferences " in str(found)
    assert str(found) != str(resolve(replace(asked, preferences=None), True)[1])
    given.store(str(found), found.episodes, found.rewards)
    conditions = Conditions("smoke", "absorbing", "sbx", retrain=False, demonstrations=str(found))
    seen: dict[str, Any] = {}

    def loaded(name: str, env: str, budget: str) -> Any:
        of_bc = method_for("bc", env, budget)

        def fit(demos: Any, world: Any, rng: Any) -> Any:
            seen[name] = demos.preferences
            return of_bc.fit(demos, world, rng)

        return SimpleNamespace(fit=fit)

    monkeypatch.setattr(fitting, "method_for", loaded)
    cells = [Cell("swingup", method, 100) for method in request.methods]
    inputs = prepare(cells, conditions)
    for cell in cells:
        run_cell(cell, conditions, inputs)
    assert seen["bc"] is None
    assert seen["trex"].tolist() == [[1, 0]]
