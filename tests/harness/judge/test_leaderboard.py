"""What rows come to: scores, differences, ties, a summary over tasks, and intervals as in the literature."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
import pytest
from scipy.stats import norm, sem, spearmanr, t

from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.statistics import (
    CONFIDENCE,
    RESAMPLES,
    interquartile_interval,
    interquartile_mean,
    mean_interval,
    normal_interval,
    rank_correlation,
)
from harness.records import Cell, CellResult
from tests.harness.made_results import RETURNS, entry_of, make_results, make_row


def entries_of(results: Iterable[CellResult]) -> dict[tuple[str, str], Entry]:
    return {(e.method, e.policy): e for e in leaderboard(scored_rows([*results]))}


def test_the_leaderboard_has_means_over_seeds_in_order_and_hides_no_failure() -> None:
    entries = entries_of(make_results(("cartpole",)))
    methods = list(dict.fromkeys(method for method, _ in entries))
    # Methods by pi_R, bc by pi_star after them for want of a reward; then controls.
    assert methods[:5] == ["shaped", "maxmargin", "bc", "control_true", "control_survival"]
    assert methods[5:] == ["control_untrained", "control_plus1", "control_minus1", "reference"]
    assert len(entries) == len(RETURNS) + 1
    shaped = entries["shaped", "pi_R"]
    assert (shaped.seeds, shaped.seeds_ok, shaped.status, shaped.role) == (3, 3, "ok", "method")
    assert (shaped.return_mean, shaped.env_steps, shaped.varies) == (435, 15_000, "seeds")
    assert shaped.score_mean == pytest.approx((435 - 20) / 480)
    expected = t.interval(0.95, 2, 435, sem([430, 435, 440]))
    assert (shaped.return_low, shaped.return_high) == pytest.approx(expected)
    skipped, failed = entries["bc", "pi_R"], entries["maxmargin", "pi_R"]
    assert skipped.note == "skipped (seeds 0, 1, 2): learns no reward"
    assert (skipped.seeds_ok, skipped.status) == (0, "skipped")
    assert math.isnan(skipped.score_mean)
    assert (failed.seeds, failed.seeds_ok, failed.status) == (3, 2, "failed")
    assert failed.note.startswith("failed (seed 2): no | progress")


def test_rewards_are_measured_against_the_best_lower_control_and_only_with_all_of_them() -> None:
    results = make_results(("cartpole",))
    entries = entries_of(results)
    assert entries["shaped", "pi_R"].above_best_lower_control == pytest.approx((435 - 105) / 480)
    assert math.isnan(entries["shaped", "pi_star"].above_best_lower_control)
    fewer = entries_of(r for r in results if r.cell.method != "control_minus1")
    assert all(math.isnan(entry.above_best_lower_control) for entry in fewer.values())


@pytest.mark.parametrize("protocol", ["native", "state"])
def test_where_an_end_pays_nothing_plus1_is_the_survival_control_and_survival_a_lower_one(
    protocol: str,
) -> None:
    results = make_results(("cartpole",))
    for result in results:
        result.rows[:] = [dataclasses.replace(row, protocol=protocol) for row in result.rows]
    entries = entries_of(results)
    assert entries["control_plus1", "pi_R"].role == "survival control"
    lower = ("control_survival", "control_minus1", "control_untrained")
    assert {entries[name, "pi_R"].role for name in lower} == {"lower control"}
    # The bar is what the others score, here control_survival.
    assert entries["shaped", "pi_R"].above_best_lower_control == pytest.approx((435 - 445) / 480)


@pytest.mark.parametrize("method", ["control_untrained", "control_survival", "control_shuffled"])
def test_a_task_where_an_uninformed_control_ties_distinguishes_no_rewards(method: str) -> None:
    results = [r for r in make_results(("cartpole",)) if r.cell.method not in ("control_survival", method)]
    assert indistinct(leaderboard(scored_rows(results))) == {}
    for seed in range(3):
        row = make_row("cartpole", method, seed, "pi_R", return_mean=430.0)
        results.append(CellResult(Cell("cartpole", method, seed), [row]))
    reasons = indistinct(leaderboard(scored_rows(results)))
    assert reasons == {"cartpole": f"{method} scores 0.85 there, the best method 0.86"}


def test_without_a_scale_there_is_no_score_and_the_seed_is_named() -> None:
    flat = [make_row("cartpole", "reference", 0, p, return_mean=20.0) for p in ("expert", "random")]
    rows = scored_rows([CellResult(Cell("cartpole", "reference", 0), flat)])
    assert all(math.isnan(row.normalized_score) for row in rows)
    results = [r for r in make_results() if (r.cell.method, r.cell.seed) != ("reference", 1)]
    shaped = [entry for entry in leaderboard(scored_rows(results)) if entry.method == "shaped"]
    assert shaped
    assert all("not scored (seed 1)" in entry.note for entry in shaped)


def test_who_asks_the_expert_is_compared_with_nobody() -> None:
    results = make_results()
    for env in ("cartpole", "pendulum"):
        row = make_row(env, "dagger", 0, "pi_star", return_mean=499.0)
        results.append(CellResult(Cell(env, "dagger", 0), [row]))
    asking, best = (entry_of(results, method, "pi_star") for method in ("dagger", "bc"))
    assert (asking.role, asking.best, best.best) == ("asks the expert", False, True)
    assert asking.score_mean > best.score_mean
    assert math.isnan(asking.behind_mean)
    assert math.isnan(best.behind_mean)
    assert {"bc", "dagger"} & {line.method for line in overall(scored_rows(results))} == {"bc"}


@pytest.mark.parametrize(
    ("losses", "tied"),
    [((30.0, -20.0, 10.0), True), ((0.9, 5.9, 10.9), True), ((50.0, 55.0, 60.0), False)],
    ids=["its interval holds 0", "nobody would care", "it is worse"],
)
def test_what_is_not_significantly_worse_than_the_best_is_tied(losses: tuple[float, ...], tied: bool) -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "maxmargin":
            level = 440 - losses[result.cell.seed]
            result.rows[:] = [make_row("cartpole", "maxmargin", result.cell.seed, "pi_R", return_mean=level)]
    assert entry_of(results, "maxmargin", "pi_R").tied == tied


def with_scores(scores: dict[str, dict[int, float]]) -> list[CellResult]:
    """The reference of seeds 0 to 4, and pi_R of these methods and seeds alone."""
    results = [r for r in make_results(("cartpole",), 5) if r.cell.method == "reference"]
    for method, by_seed in scores.items():
        for seed, score in by_seed.items():
            row = make_row("cartpole", method, seed, "pi_R", return_mean=20 + 480 * score)
            results.append(CellResult(Cell("cartpole", method, seed), [row]))
    return results


def test_a_mean_over_easy_seeds_alone_is_not_the_best() -> None:
    """airl has seed 0 alone, where the others do better; gail has a seed that nobody else has."""
    hard = {0: 1.1, 1: 0.8, 2: 0.8, 3: 0.8}
    entries = entries_of(
        with_scores({"airl": {0: 1.0}, "gail": {4: 1.2}, "shaped": hard, "maxent": {0: 1.3, 1: 0.1}})
    )
    best = {method for (method, _), entry in entries.items() if entry.best}
    assert best == {"shaped"}
    assert entries["airl", "pi_R"].behind_mean == pytest.approx(0.1)
    gail = entries["gail", "pi_R"]
    assert (gail.incomparable, gail.tied) == (True, False)
    lucky = entry_of(with_scores({"airl": {0: 1.2}, "shaped": hard | {4: 5.0}}), "airl", "pi_R")
    assert lucky.behind_mean == pytest.approx(-0.1)  # not significantly worse
    assert lucky.tied


def test_controls_are_compared_with_over_the_seeds_that_both_have() -> None:
    """On seed 0 shaped is no better than its controls, which fail on the other one."""
    lower = {name: {0: 0.9, 1: 0.0} for name in ("control_plus1", "control_minus1", "control_untrained")}
    scores = {"shaped": {0: 0.9}, "maxent": {4: 0.9}, "control_shuffled": {0: 0.1, 1: 0.1}, **lower}
    entries = entries_of(with_scores({**scores, "control_true": {0: 0.9, 1: 0.1}}))
    shaped, apart = entries["shaped", "pi_R"], entries["maxent", "pi_R"]
    assert (shaped.above_best_lower_control, shaped.share_of_true) == pytest.approx((0, 1))
    assert math.isnan(apart.above_best_lower_control)
    assert math.isnan(apart.share_of_true)


def test_overall_compares_only_what_every_env_has() -> None:
    results = make_results()
    pooled = {(line.method, line.policy): line for line in overall(scored_rows(results))}
    shaped = pooled["shaped", "pi_R"]
    assert (shaped.runs, shaped.envs, shaped.below, pooled["control_true", "pi_R"].below) == (6, 2, 1.0, 0.0)
    # Six equal pairs: one score is cut at either end, four are left.
    assert shaped.score == pytest.approx((435 - 20) / 480)
    fewer = [r for r in results if (r.cell.env, r.cell.method) != ("pendulum", "shaped")]
    assert not [line for line in overall(scored_rows(fewer)) if line.method == "shaped"]
    rows = scored_rows(make_results(("cartpole", "pendulum", "highway")))
    lines = overall(rows, ("pendulum",))
    assert lines == overall([row for row in rows if row.env != "pendulum"])
    assert [line.score for line in lines] == sorted((line.score for line in lines), reverse=True)


def test_the_interval_is_students_whatever_the_order() -> None:
    values = [1.0, 2.0, 4.0, 4.5]
    expected = t.interval(0.95, 3, loc=np.mean(values), scale=sem(values))
    assert mean_interval(values) == pytest.approx(expected)
    assert mean_interval(values[::-1]) == mean_interval(values)
    assert normal_interval(3.0, 0.5) == pytest.approx(norm.interval(0.95, 3.0, 0.5))
    assert all(math.isnan(bound) for bound in (*mean_interval([4.0]), *mean_interval([])))
    assert mean_interval([4.0, 4.0, 4.0]) == (4.0, 4.0)


def test_interquartile_mean_ignores_the_outer_quarters_and_refuses_what_is_not_finite() -> None:
    assert interquartile_mean([-1e9, 1.0, 2.0, 1e9]) == 1.5
    assert interquartile_mean([3.0, 1.0, 2.0]) == 2.0  # too few to cut: the plain mean
    assert interquartile_mean([8, 1, 2, 3, 4, 5, 6, 7]) == 4.5
    assert math.isnan(interquartile_mean([]))
    for function in (mean_interval, interquartile_mean):
        with pytest.raises(ValueError, match="finite"):
            function([1.0, math.nan])


def test_interquartile_interval_resamples_within_tasks_only() -> None:
    """Runs that do not vary within their task leave nothing to resample, however far tasks lie apart."""
    assert interquartile_interval([[0.0, 0.0], [1.0, 1.0]]) == (0.5, 0.5)
    assert all(math.isnan(bound) for bound in interquartile_interval([[1.0, 2.0], [3.0]]))
    rng = np.random.default_rng(3)
    tasks = [rng.normal(size=count).tolist() for count in (2, 7, 300)]
    draws = np.random.default_rng(5)
    drawn = [draws.choice(np.sort(runs), (RESAMPLES, len(runs))) for runs in tasks]
    middle = np.sort(np.concatenate(drawn, axis=1))[:, 77 : 309 - 77].mean(axis=1)
    expected = np.quantile(middle, [(1 - CONFIDENCE) / 2, 1 - (1 - CONFIDENCE) / 2])
    assert interquartile_interval(tasks, seed=5) == tuple(expected)


def test_ranks_correlate_as_scipy_has_it() -> None:
    rng = np.random.default_rng(0)
    for size in (3, 10, 1000):
        one, other = rng.normal(size=size), rng.normal(size=size)
        for a, b in ((one, other), (one.round(), other.round(1)), (one, one**3), (one, -one)):
            assert rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic, abs=1e-12)
    assert math.isnan(rank_correlation(np.array([1.0, math.nan]), np.array([1.0, 2.0])))
