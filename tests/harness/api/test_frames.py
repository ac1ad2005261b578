"""Runs from Python, and all that the public module names."""

from pathlib import Path

import pytest

import irl_bench
from harness.registry import BadInput


@pytest.mark.parametrize(
    "words",
    [
        {"seeds": "12"},
        {"methods": "bc"},
        {"methods": None},
        {"methods": [int]},
        {"envs": [object()]},
        {"plugins": [int]},
        {"plugins": "mine.py"},
        {"options": [1]},
        {"options": ["--out=other"]},
        {"options": ["--seeds", "3"]},
        {"options": ["--plan"]},
        {"options": ["--help"]},
        {"seeds": [-1]},
    ],
)
def test_what_a_run_from_python_cannot_mean_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: dict
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput):
        irl_bench.run(**{"methods": ["bc"], "envs": ["swingup"], "budget": "smoke", "out": "run", **words})
    assert not [*tmp_path.iterdir()]


def test_texts_that_pandas_takes_for_nothing_are_texts(tmp_path: Path) -> None:
    for name in ("scores", "leaderboard"):
        (tmp_path / f"{name}.csv").write_text("method,score\nnull,\nNA,1.5\n")
    found = irl_bench.load(tmp_path).scores
    assert [*found.method] == ["null", "NA"]
    assert [*found.score.isna()] == [True, False]


def test_all_that_the_public_module_names_is_there() -> None:
    for name in irl_bench.__all__:
        assert getattr(irl_bench, name) is not None
    assert set(irl_bench.__all__) == set(dir(irl_bench))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'; it has DDPG"):
        irl_bench.nothing  # noqa: B018
