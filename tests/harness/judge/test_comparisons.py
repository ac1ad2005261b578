"""Comparisons are exact, rarely name a difference between equals, and say what they would have found."""

from __future__ import annotations

import csv
import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, permutation_test

from harness.judge.comparisons import compare, detectable, holm, p_value, pooled, sign_flips, stand_out

STUDY = Path(__file__).parents[3] / "results/studies/coverage.py"


@pytest.fixture(scope="module")
def study() -> Any:
    """The script of the simulations."""
    spec = importlib.util.spec_from_file_location("coverage_study", STUDY)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_p_values_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    gaps = rng.normal(0.2, 0.5, 9).round(2)
    pairs = (gaps, np.zeros(9))
    kind: Any = {"permutation_type": "samples", "n_resamples": math.inf}
    exact = permutation_test(pairs, lambda a, b: (a - b).sum(), **kind).pvalue
    assert sign_flips(gaps) == pytest.approx(exact)
    assert sign_flips([1.0] * 9 + [-1.0] * 2 + [0.0] * 5) == pytest.approx(binomtest(9, 11).pvalue)
    assert sign_flips([0.004, 0.003, -0.004]) == sign_flips([]) == 1.0  # too small for anybody to care
    assert sign_flips([1e9, 1e9, 1e9]) == 0.25
    many = rng.normal(0.08, 0.5, 200)
    assert sign_flips([*many, 0.0]) == pytest.approx(sign_flips(many), rel=0.05)  # normal from 201 on


def test_a_score_that_could_be_any_of_three_has_the_p_value_of_their_orders() -> None:
    """Nine equally likely sums of two blocks; 2 and -2 are as far from 0."""
    blocks = [np.array([1.0, 0.0, -1.0])] * 2
    assert p_value(np.array([1.0, 1.0]), blocks) == pytest.approx(2 / 9)
    assert p_value(np.array([1.0, 0.0]), blocks) == pytest.approx(6 / 9)


def test_holm_multiplies_by_the_tests_that_are_left_and_keeps_the_order() -> None:
    assert holm({"a": 0.01, "b": 0.02, "c": 0.5}) == pytest.approx({"a": 0.03, "b": 0.04, "c": 0.5})
    assert holm({"a": 0.4, "b": 0.3}) == pytest.approx({"b": 0.6, "a": 0.6})


def test_tasks_weigh_the_same_and_only_shared_seeds_count() -> None:
    one = {("a", 0): 1.0, ("b", 0): 1.0, ("b", 1): 1.0, ("b", 2): 1.0}
    other = {("a", 0): 0.0, ("b", 0): 1.0, ("b", 1): 1.0, ("c", 0): 0.0}
    differences = compare({"one": one, "other": other, "control_clone": one, "control_survival": {}})
    assert differences["one", "other"][:1] + differences["one", "other"][2:3] == (0.5, 3)
    assert differences["other", "one"].mean == -0.5
    beside = stand_out({"one": one, "other": other})
    assert beside["one"].mean == pytest.approx(0.5)
    assert beside["one"].p == pytest.approx(differences["one", "other"].p)
    assert ("control_clone", "control_survival") not in differences


def test_pairs_over_tasks_need_a_method_that_stands_out() -> None:
    keys = [(task, seed) for task in "abcd" for seed in range(5)]
    high, low = (dict.fromkeys(keys, level) for level in (1.0, 0.0))
    beside, pairs = pooled({"good": high, "bad": low, "poor": low})
    assert beside["good"].is_significant
    assert beside["good"].mean == 1.0
    assert pairs["good", "poor"].is_significant
    scores = {"a": dict.fromkeys(keys, 0.6), "b": dict.fromkeys(keys, 0.5), "noise": {}}
    scores["noise"] = {key: float(place % 2) for place, key in enumerate(keys)}
    assert compare(scores)["a", "b"].is_significant
    beside, pairs = pooled(scores)
    assert not any(one.is_significant for one in beside.values())
    assert {one.p for one in pairs.values()} == {1.0}


def test_five_seeds_show_no_difference_and_ten_a_large_one() -> None:
    scores = {
        "good": {("a", seed): 1.0 for seed in range(10)},
        "bad": {("a", seed): 0.0 for seed in range(10)},
    }
    five = {name: {key: its[key] for key in [*its][:5]} for name, its in scores.items()}
    assert not compare(five)["good", "bad"].is_significant
    assert math.isnan(compare(five)["good", "bad"].detectable)
    assert compare(scores)["good", "bad"].is_significant
    assert compare(scores)["good", "bad"].detectable == pytest.approx(0.67, abs=0.005)


@pytest.mark.parametrize(("pairs", "comparisons"), [(10, 1), (20, 3), (50, 78)])
def test_the_detectable_difference_is_found_with_the_power_it_says(pairs: int, comparisons: int) -> None:
    rng = np.random.default_rng(0)
    least, found = detectable(pairs, comparisons), []
    for _ in range(1000):
        lost = (rng.random(pairs) < least).astype(float)
        found.append(sign_flips(lost) <= 0.05 / comparisons)
    assert np.mean(found) == pytest.approx(0.8, abs=0.04)


@pytest.mark.parametrize("n", [5, 10])
@pytest.mark.parametrize("rate", [0.5, 0.8, 0.9])
def test_intervals_of_successes_cover_and_students_do_not(study: Any, n: int, rate: float) -> None:
    pool = [1.0] * round(10 * rate) + [0.0] * round(10 - 10 * rate)
    assert study.coverage("mean_interval", [pool], n, 2000)[0] >= 0.9
    if rate == 0.9:
        assert study.coverage("student", [pool], n, 2000)[0] < 0.8


@pytest.mark.parametrize("n", [5, 10])
def test_intervals_of_stored_scores_cover(study: Any, n: int) -> None:
    assert study.coverage("mean_interval", study.stored()[::40], n, 40)[0] >= 0.9


@pytest.mark.parametrize(("n", "tasks"), [(10, 1), (5, 10)])
def test_boards_of_thirteen_equal_methods_name_no_difference(study: Any, n: int, tasks: int) -> None:
    """More than four of 25 boards would do so with a probability of 0.007, if 5 in 100 did."""
    boards = [study.board([0.8] * 13, n, tasks, seed) for seed in range(25)]
    assert sum(board.names_any for board in boards) <= 4


def test_a_method_that_succeeds_30_points_more_often_is_found_over_ten_tasks(study: Any) -> None:
    boards = [study.board([0.8] + [0.5] * 12, 5, 10, seed) for seed in range(20)]
    assert np.mean([board.stands_out for board in boards]) >= 0.8


def test_the_stored_simulation_meets_its_bars() -> None:
    rows = list(csv.DictReader(STUDY.with_suffix(".csv").read_text(encoding="utf-8").splitlines()))
    values = {
        (r["what"], r["how"], r["n"], r["tasks"], r["methods"], r["rate"]): float(r["value"]) for r in rows
    }
    covered = [value for key, value in values.items() if key[:2] == ("coverage", "mean_interval")]
    assert len(covered) == 8
    assert min(covered) >= 0.9
    assert max(value for key, value in values.items() if key[0] == "false") <= 0.05
    found = [value for key, value in values.items() if key[:2] == ("power", "beside the others")]
    assert len(found) == 9
    assert min(found) >= 0.8


@pytest.mark.parametrize("pairs", range(2, 8))
def test_a_difference_is_detectable_where_the_largest_one_would_be_significant(pairs: int) -> None:
    a, b = ({("x", seed): score for seed in range(pairs)} for score in (1.0, 0.0))
    for one in stand_out({"a": a, "b": b}).values():
        assert math.isfinite(one.detectable) == one.is_significant == (pairs >= 6)


def test_equal_pairs_change_no_p_value() -> None:
    assert sign_flips([1.0] * 5 + [0.0] * 300) == sign_flips([1.0] * 5) == 0.0625
