"""What rows come to: scores, differences, and a summary over tasks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import pytest

from harness.judge.across_tasks import indistinct, overall
from harness.judge.comparisons import detectable
from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.statistics import interquartile_mean, mean_interval, share_interval
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
    assert (shaped.return_mean, shaped.env_steps, shaped.interactions) == (435, 15_000, 15_000)
    scores = [(earned - 20) / 480 for earned in (440, 435, 430)]
    assert (shaped.seeds_scored, shaped.score_mean) == (3, pytest.approx((435 - 20) / 480))
    assert (shaped.score_low, shaped.score_high) == mean_interval(scores)
    assert (shaped.share, shaped.share_low, shaped.share_high) == share_interval(scores)
    assert shaped.score_iqm == interquartile_mean(scores)
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


@pytest.mark.parametrize(
    ("method", "role"), [("dagger", "asks the expert"), ("trex", "sees ranked demonstrations")]
)
def test_who_knows_more_than_others_is_compared_with_nobody(method: str, role: str) -> None:
    results = make_results()
    for env in ("cartpole", "pendulum"):
        row = make_row(env, method, 0, "pi_star", return_mean=499.0)
        results.append(CellResult(Cell(env, method, 0), [row]))
    knowing, best = (entry_of(results, name, "pi_star") for name in (method, "bc"))
    assert (knowing.role, knowing.best, best.best) == (role, False, True)
    assert knowing.score_mean > best.score_mean
    assert math.isnan(knowing.behind)
    assert math.isnan(best.behind)
    assert {"bc", method} & {line.method for line in overall(scored_rows(results))} == {"bc"}


def with_scores(scores: dict[str, dict[int, float]]) -> list[CellResult]:
    """The reference of seeds 0 to 4, and pi_R of these methods and seeds alone."""
    results = [r for r in make_results(("cartpole",), 5) if r.cell.method == "reference"]
    for method, by_seed in scores.items():
        for seed, score in by_seed.items():
            row = make_row("cartpole", method, seed, "pi_R", return_mean=20 + 480 * score)
            results.append(CellResult(Cell("cartpole", method, seed), [row]))
    return results


@pytest.mark.parametrize(("seeds", "differs"), [(5, ""), (10, "bc")])
def test_methods_are_compared_seed_by_seed_where_so_many_can_differ(seeds: int, differs: str) -> None:
    """All seeds but one are 0.3 better; two controls are as bad as bc."""
    results = [r for r in make_results(("cartpole",), seeds) if r.cell.method == "reference"]
    for method in ("gail", "bc", "control_clone", "control_survival"):
        for seed in range(seeds):
            level = 0.6 if method == "gail" and seed != 3 else 0.3
            row = make_row("cartpole", method, seed, "pi_R", return_mean=20 + 480 * level)
            results.append(CellResult(Cell("cartpole", method, seed), [row]))
    better, worse = (entry_of(results, method, "pi_R") for method in ("gail", "bc"))
    assert better.better_than == (f"{differs} control_clone control_survival" if differs else "")
    assert (better.best, worse.worse_than) == (True, "gail" if differs else "")
    assert worse.behind == pytest.approx(0.3 * (seeds - 1) / seeds)
    assert (worse.behind_p <= 0.05) == bool(differs)
    # Five comparisons: two methods, and both with two controls.
    assert better.detectable == pytest.approx(detectable(seeds, 5), nan_ok=True)
    assert math.isnan(better.detectable) == (seeds == 5)


@pytest.mark.parametrize(
    ("first", "second"), [("shaped", "shaped_ml"), ("shaped_thesis", "shaped_thesis_end")]
)
def test_two_names_of_one_pi_star_count_once(first: str, second: str) -> None:
    results = [r for r in make_results() if r.cell.method != "shaped"]
    alone = results.copy()
    for env in ("cartpole", "pendulum"):
        for seed in range(3):
            for method, best in ((first, 460), (second, 461)):
                names = ("pi_star", "pi_R")
                rows = [make_row(env, method, seed, name, return_mean=best - 5 * seed) for name in names]
                results.append(CellResult(Cell(env, method, seed), rows))
                alone += results[-1:] if method == second else []
    star, own = (entry_of(results, second, policy) for policy in ("pi_star", "pi_R"))
    assert (star.same_policy_as, own.same_policy_as) == (first, "")
    assert (own.best, star.incomparable) == (True, False)
    lines = {(line.method, line.policy) for line in overall(scored_rows(results))}
    assert (second, "pi_R") in lines
    assert (second, "pi_star") not in lines
    assert entry_of(alone, second, "pi_star").same_policy_as == ""


def test_seeds_whose_reward_rl_did_not_solve_are_a_state_of_their_own() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "shaped":
            solved = float(result.cell.seed > 0)
            result.rows[1] = dataclasses.replace(result.rows[1], solved=solved)
        elif result.cell.method == "maxmargin" and result.cell.seed < 2:
            result.rows[1] = dataclasses.replace(result.rows[1], solved=0.0)
    entries = entries_of(results)
    some, none = entries["shaped", "pi_R"], entries["maxmargin", "pi_R"]
    assert (some.seeds_ok, some.seeds_scored, some.unsolved) == (3, 2, 1)
    assert some.score_mean == pytest.approx((432.5 - 20) / 480)
    assert some.score_unsolved == pytest.approx((440 - 20) / 480)
    assert (some.is_unsolved, none.is_unsolved, none.best, none.unsolved) == (False, True, False, 2)
    assert math.isnan(none.score_mean)
    assert none.drawn_score == none.score_unsolved == pytest.approx((347.5 - 20) / 480)
    assert entries["shaped", "pi_star"].unsolved == 0


def test_a_mean_over_easy_seeds_alone_is_not_the_best() -> None:
    """airl has seed 0 alone, where the others do better; gail has a seed that nobody else has."""
    hard = {0: 1.1, 1: 0.8, 2: 0.8, 3: 0.8}
    entries = entries_of(
        with_scores({"airl": {0: 1.0}, "gail": {4: 1.2}, "shaped": hard, "maxent": {0: 1.3, 1: 0.1}})
    )
    best = {method for (method, _), entry in entries.items() if entry.best}
    assert best == {"shaped"}
    assert entries["airl", "pi_R"].behind == pytest.approx(0.1)
    gail = entries["gail", "pi_R"]
    assert gail.incomparable
    lucky = entry_of(with_scores({"airl": {0: 1.2}, "shaped": hard | {4: 5.0}}), "airl", "pi_R")
    assert lucky.behind == pytest.approx(-0.1)


def test_controls_are_compared_with_over_the_seeds_that_both_have() -> None:
    """On seed 0 shaped is no better than its controls, which fail on the other one."""
    lower = {name: {0: 0.9, 1: 0.0} for name in ("control_plus1", "control_minus1", "control_untrained")}
    scores = {"shaped": {0: 0.9}, "maxent": {4: 0.9}, "control_shuffled": {0: 0.1, 1: 0.1}, **lower}
    entries = entries_of(with_scores({**scores, "control_true": {0: 0.9, 1: 0.1}}))
    little = entries_of(with_scores({**scores, "control_true": {0: 0.09, 1: 0.1}}))
    assert math.isnan(little["shaped", "pi_R"].share_of_true)
    shaped, apart = entries["shaped", "pi_R"], entries["maxent", "pi_R"]
    assert (shaped.above_best_lower_control, shaped.share_of_true) == pytest.approx((0, 1))
    assert math.isnan(apart.above_best_lower_control)
    assert math.isnan(apart.share_of_true)


def test_overall_compares_only_what_every_env_has() -> None:
    results = make_results()
    pooled = {(line.method, line.policy): line for line in overall(scored_rows(results))}
    shaped = pooled["shaped", "pi_R"]
    reached = [pooled[method, "pi_R"].reached for method in ("shaped", "control_true")]
    assert (shaped.runs, len(shaped.scores), reached) == (6, 2, [0.0, 1.0])
    # Six equal pairs: one score is cut at either end, four are left.
    assert shaped.score == pytest.approx((435 - 20) / 480)
    fewer = [r for r in results if (r.cell.env, r.cell.method) != ("pendulum", "shaped")]
    assert not [line for line in overall(scored_rows(fewer)) if line.method == "shaped"]
    rows = scored_rows(make_results(("cartpole", "pendulum", "highway")))
    lines = overall(rows, ("pendulum",))
    assert lines == overall([row for row in rows if row.env != "pendulum"])
    assert [line.score for line in lines] == sorted((line.score for line in lines), reverse=True)
