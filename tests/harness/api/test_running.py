"""Runs from Python, their results as frames, and the names of the public module."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import irl_bench
from harness.cli.arguments import parser
from harness.cli.runs import engine_of, request_of
from harness.registry import BadInput

CELLS = 9


@pytest.mark.usefixtures("own_cache")
def test_a_run_returns_frames_and_load_returns_the_same(tmp_path: Path) -> None:
    asked = irl_bench.RunRequest(methods=["bc"], envs=["gridworld"], budget="smoke", record="none")
    engine = irl_bench.Engine("inline")
    results = irl_bench.run(asked, engine, tmp_path / "run")
    again = irl_bench.load(tmp_path / "run")
    for name in ("scores", "leaderboard", "curves"):
        assert len(getattr(results, name)) > 0
        assert getattr(results, name).equals(getattr(again, name))
    assert set(results.scores["method"]) > {"bc", "reference", "control_true"}
    assert {"env", "method", "seed", "curve", "x", "y"} <= set(results.curves.columns)
    assert len(results.failed) == 0
    assert f"{CELLS} cells, 0 failed rows" in repr(results)


@pytest.mark.parametrize(
    "words",
    [
        {"seeds": "12"},
        {"seeds": [-1]},
        {"seeds": 0},
        {"methods": "bc"},
        {"methods": None},
        {"methods": [int]},
        {"envs": [object()]},
        {"plugins": [int]},
        {"plugins": "mine.py"},
        {"demos": []},
        {"demos": [[1]]},
        {"seeds": 3.0},
        {"solves": True},
        {"action_bounds": (-1, 1)},
        {"action_bounds": [(-1, 0, 1)]},
        {"budget": "huge"},
        {"solves": 2, "retrain": False},
        {"transfer": ["sideways"]},
    ],
)
def test_a_request_that_no_run_can_have_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: dict[str, Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput):
        irl_bench.run(irl_bench.RunRequest(**{"methods": ["bc"], "envs": ["swingup"], **words}), store="run")
    assert not [*tmp_path.iterdir()]


def test_a_class_is_no_name_of_a_method_and_the_refusal_says_where_it_goes() -> None:
    with pytest.raises(BadInput, match="put a class or task of yours into a file that names it in METHODS"):
        irl_bench.RunRequest(methods=[int])  # type: ignore[list-item]


def test_the_command_line_without_options_is_the_request_without_arguments() -> None:
    args = parser().parse_args(["run"])
    assert request_of(args) == irl_bench.RunRequest(
        demos=(0,), methods=["all"], envs=["all"], plugins=[], baseline=[], env_vars=[]
    )
    assert engine_of(args) == irl_bench.Engine()


def test_numbers_of_numpy_are_numbers() -> None:
    request = irl_bench.RunRequest(seeds=np.arange(3), demos=np.array([5]), solves=np.int64(2))
    assert request.all_seeds == (0, 1, 2)
    assert irl_bench.RunRequest(seeds=np.int64(2)).all_seeds == (0, 1)


def test_texts_that_pandas_takes_for_nothing_are_texts(tmp_path: Path) -> None:
    for name in ("scores", "leaderboard"):
        (tmp_path / f"{name}.csv").write_text("method,score\nnull,\nNA,1.5\n")
    scores = irl_bench.load(tmp_path).scores
    assert [*scores.method] == ["null", "NA"]
    assert [*scores.score.isna()] == [True, False]


def test_all_that_the_public_module_names_is_there() -> None:
    for name in irl_bench.__all__:
        assert getattr(irl_bench, name) is not None
    assert set(irl_bench.__all__) == set(dir(irl_bench))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'; it has DDPG"):
        irl_bench.nothing  # noqa: B018
