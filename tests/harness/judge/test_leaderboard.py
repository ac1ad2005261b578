"""What rows come to: scores, differences, ties, a summary over tasks."""

from __future__ import annotations

import dataclasses
import math

import pytest
from scipy.stats import sem, t

from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import leaderboard, scored_rows
from harness.records import Cell, CellResult
from tests.harness.made_results import RETURNS, entry_of, make_results, make_row


def test_leaderboard_aggregates_over_seeds_and_measures_rewards_against_the_best_lower_control() -> None:
    entries = leaderboard(scored_rows(make_results(("cartpole",))))
    found = {(entry.method, entry.policy): entry for entry in entries}
    shaped = found["shaped", "pi_R"]
    assert (shaped.seeds, shaped.seeds_ok, shaped.status, shaped.role) == (3, 3, "ok", "method")
    assert shaped.return_mean == 435
    assert shaped.score_mean == pytest.approx((435 - 20) / 480)
    assert (shaped.return_low, shaped.return_high) == pytest.approx(
        t.interval(0.95, 2, 435, sem([430, 435, 440]))
    )
    assert shaped.varies == "seeds"
    assert shaped.env_steps == 15_000
    assert shaped.above_best_lower_control == pytest.approx((435 - 105) / 480)
    assert math.isnan(found["shaped", "pi_star"].above_best_lower_control)
    assert found["control_untrained", "pi_R"].above_best_lower_control == 0
    roles = {entry.method: entry.role for entry in entries}
    assert (roles["control_true"], roles["control_plus1"]) == ("upper control", "lower control")


@pytest.mark.parametrize("protocol", ["native", "state"])
def test_where_an_end_pays_nothing_plus1_is_the_survival_control_and_survival_a_lower_one(
    protocol: str,
) -> None:
    results = make_results(("cartpole",))
    for result in results:
        result.rows[:] = [dataclasses.replace(row, protocol=protocol) for row in result.rows]
    entries = {(e.method, e.policy): e for e in leaderboard(scored_rows(results))}
    roles = {method: entry.role for (method, _), entry in entries.items()}
    assert roles["control_plus1"] == "survival control"
    assert (
        roles["control_survival"] == roles["control_minus1"] == roles["control_untrained"] == "lower control"
    )
    # The bar is no more what +1 scores but what the others do, here control_survival.
    assert entries["shaped", "pi_R"].above_best_lower_control == pytest.approx((435 - 445) / 480)


@pytest.mark.parametrize("method", ["control_untrained", "control_survival", "control_shuffled"])
def test_a_task_where_a_control_that_knows_nothing_ties_tells_no_reward_from_none(method: str) -> None:
    results = [r for r in make_results(("cartpole",)) if r.cell.method != "control_survival"]
    assert indistinct(leaderboard(scored_rows(results))) == {}
    for seed in range(3):
        row = make_row("cartpole", method, seed, "pi_R", return_mean=430.0)
        results = [r for r in results if r.cell != Cell("cartpole", method, seed)]
        results.append(CellResult(Cell("cartpole", method, seed), [row]))
    told = indistinct(leaderboard(scored_rows(results)))
    assert told == {"cartpole": f"{method} scores 0.85 there, the best method 0.86"}


def test_leaderboard_is_sorted_by_score_and_hides_no_failure() -> None:
    entries = leaderboard(scored_rows(make_results(("cartpole",))))
    methods = list(dict.fromkeys(entry.method for entry in entries))
    # Methods by pi_R, bc by pi_star after them for want of a reward; then controls.
    assert methods[:5] == ["shaped", "maxmargin", "bc", "control_true", "control_survival"]
    assert methods[5:] == ["control_untrained", "control_plus1", "control_minus1", "reference"]
    found = {(entry.method, entry.policy): entry for entry in entries}
    assert len(found) == len(RETURNS) + 1
    assert found["bc", "pi_R"].note == "skipped (seeds 0, 1, 2): learns no reward"
    assert (found["bc", "pi_R"].seeds_ok, found["bc", "pi_R"].status) == (0, "skipped")
    assert math.isnan(found["bc", "pi_R"].score_mean)
    failed = found["maxmargin", "pi_R"]
    assert (failed.seeds, failed.seeds_ok, failed.status) == (3, 2, "failed")
    assert failed.note.startswith("failed (seed 2): no | progress")


def test_one_lower_control_less_leaves_nothing_to_be_above_of() -> None:
    results = [r for r in make_results(("cartpole",)) if r.cell.method != "control_minus1"]
    entries = leaderboard(scored_rows(results))
    assert all(math.isnan(entry.above_best_lower_control) for entry in entries)


def test_an_expert_no_better_than_random_is_no_scale() -> None:
    results = [
        CellResult(
            Cell("cartpole", "reference", 0),
            [make_row("cartpole", "reference", 0, p, return_mean=20.0) for p in ("expert", "random")],
        )
    ]
    assert all(math.isnan(row.normalized_score) for row in scored_rows(results))


def test_a_seed_without_a_reference_is_named() -> None:
    results = [r for r in make_results() if (r.cell.method, r.cell.seed) != ("reference", 1)]
    shaped = [entry for entry in leaderboard(scored_rows(results)) if entry.method == "shaped"]
    assert shaped
    for entry in shaped:
        assert (entry.seeds_ok, entry.status) == (3, "ok")
        assert (
            entry.note
            == "not scored (seed 1): what would score 1 is missing, or no better than a random policy"
        )


def test_differences_to_the_best_are_paired_by_seed() -> None:
    results = make_results(("cartpole",))
    assert math.isnan(entry_of(results, "shaped", "pi_R").behind_mean)  # it is the best
    behind = entry_of(results, "maxmargin", "pi_R")  # it failed in the last seed
    # Both lose 5 a seed, so the difference does not vary, though both do.
    assert behind.behind_mean == behind.behind_low == behind.behind_high == pytest.approx(90 / 480)
    assert not behind.tied
    star = entry_of(results, "shaped", "pi_star")  # bc's is the best
    assert star.behind_mean == pytest.approx(20 / 480)
    assert math.isnan(entry_of(results, "control_true", "pi_R").behind_mean)


def test_who_asks_the_expert_is_no_rival() -> None:
    rows = [make_row("cartpole", "dagger", seed, "pi_star", return_mean=499.0) for seed in range(3)]
    results = [CellResult(Cell("cartpole", "dagger", row.seed), [row]) for row in rows]
    results += make_results(("cartpole",))
    asking, best = (entry_of(results, method, "pi_star") for method in ("dagger", "bc"))
    assert asking.role == "asks the expert"
    assert asking.score_mean > best.score_mean
    assert math.isnan(asking.behind_mean)
    assert math.isnan(best.behind_mean)


def test_what_is_not_told_apart_from_the_best_is_tied() -> None:
    results = make_results(("cartpole",))
    swing = iter([30.0, -20.0, 10.0])
    for result in results:
        if result.cell.method == "maxmargin":
            level = 440 - next(swing)
            result.rows[:] = [
                make_row("cartpole", "maxmargin", result.cell.seed, p, return_mean=level)
                for p in ("pi_star", "pi_R")
            ]
    tied = entry_of(results, "maxmargin", "pi_R")
    assert tied.behind_low < 0 < tied.behind_high
    assert tied.tied


def test_a_difference_that_nobody_would_care_for_is_none() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "maxmargin":
            level = 440 - 5 * result.cell.seed - 0.9  # 0.002 of the scale, on every seed
            result.rows[:] = [make_row("cartpole", "maxmargin", result.cell.seed, "pi_R", return_mean=level)]
    near = entry_of(results, "maxmargin", "pi_R")
    assert 0 < near.behind_low <= near.behind_high < 0.005
    assert near.tied


def test_without_a_seed_in_common_with_the_best_a_method_is_neither_best_nor_tied() -> None:
    results = [r for r in make_results(("cartpole",)) if r.cell.method != "shaped" or r.cell.seed == 0]
    results = [r for r in results if r.cell.method != "maxmargin" or r.cell.seed == 1]
    best, apart, clone = (entry_of(results, method, "pi_star") for method in ("bc", "shaped", "maxmargin"))
    assert (best.best, best.incomparable) == (True, False)
    assert not clone.best  # bc has all seeds, so both are compared with it
    assert math.isfinite(apart.behind_mean)
    assert math.isfinite(clone.behind_mean)
    best, apart = (entry_of(results, method, "pi_R") for method in ("shaped", "maxmargin"))
    assert (best.best, best.incomparable) == (True, False)
    assert (apart.best, apart.tied, apart.incomparable) == (False, False, True)
    control = entry_of(results, "control_true", "pi_R")
    assert (control.best, control.incomparable) == (False, False)


def with_scores(scores: dict[str, dict[int, float]]) -> list[CellResult]:
    """The reference of seeds 0 to 4, and pi_R of these methods and seeds alone."""
    results = [r for r in make_results(("cartpole",), 5) if r.cell.method == "reference"]
    for method, its in scores.items():
        for seed, score in its.items():
            row = make_row("cartpole", method, seed, "pi_R", return_mean=20 + 480 * score)
            results.append(CellResult(Cell("cartpole", method, seed), [row]))
    return results


def test_a_mean_over_easy_seeds_alone_is_not_the_best() -> None:
    """airl has seed 0 alone, where the others do better; gail has a seed that nobody else has."""
    hard = {0: 1.1, 1: 0.8, 2: 0.8, 3: 0.8}
    results = with_scores({"airl": {0: 1.0}, "gail": {4: 1.2}, "shaped": hard, "maxent": {0: 1.3, 1: 0.1}})
    best, airl, gail, maxent = (entry_of(results, m, "pi_R") for m in ("shaped", "airl", "gail", "maxent"))
    assert (best.best, airl.best, gail.best, maxent.best) == (True, False, False, False)
    assert airl.behind_mean == pytest.approx(0.1)
    assert gail.incomparable
    lucky = entry_of(with_scores({"airl": {0: 1.2}, "shaped": hard | {4: 5.0}}), "airl", "pi_R")
    assert lucky.behind_mean == pytest.approx(-0.1)  # not told to be worse
    assert lucky.tied


def test_controls_are_compared_with_over_the_seeds_that_both_have() -> None:
    """On seed 0 shaped is no better than its controls, which fail on the other one."""
    lower = {name: {0: 0.9, 1: 0.0} for name in ("control_plus1", "control_minus1", "control_untrained")}
    scores = {"shaped": {0: 0.9}, "maxent": {4: 0.9}, "control_shuffled": {0: 0.1, 1: 0.1}, **lower}
    results = with_scores({**scores, "control_true": {0: 0.9, 1: 0.1}})
    shaped, apart = (entry_of(results, method, "pi_R") for method in ("shaped", "maxent"))
    assert (shaped.above_best_lower_control, shaped.share_of_true) == pytest.approx((0, 1))
    assert math.isnan(apart.above_best_lower_control)
    assert math.isnan(apart.share_of_true)


def test_a_board_has_one_best_of_each_policy_that_has_a_score() -> None:
    equal = make_results(("cartpole",))
    for result in equal:
        if result.cell.method in ("shaped", "maxmargin"):
            result.rows[:] = [dataclasses.replace(row, return_mean=400.0) for row in result.rows]
    entries = leaderboard(scored_rows(equal))
    assert {(e.policy, e.method) for e in entries if e.best} == {("pi_star", "bc"), ("pi_R", "maxmargin")}


def test_the_share_of_bad_runs_is_told() -> None:
    results = make_results()
    (shaped,) = (x for x in overall(scored_rows(results)) if (x.method, x.policy) == ("shaped", "pi_R"))
    assert shaped.below == 1.0  # all below 0.95
    (true,) = (x for x in overall(scored_rows(results)) if x.method == "control_true")
    assert true.below == 0.0


def test_overall_compares_only_what_every_env_has() -> None:
    results = make_results()
    pooled = {(line.method, line.policy): line for line in overall(scored_rows(results))}
    assert pooled["shaped", "pi_R"].runs == 6
    # Six equal pairs: one score is cut at either end, four are left.
    assert pooled["shaped", "pi_R"].score == pytest.approx((435 - 20) / 480)
    results = [r for r in results if (r.cell.env, r.cell.method) != ("pendulum", "shaped")]
    assert not [line for line in overall(scored_rows(results)) if line.method == "shaped"]
    assert overall(scored_rows(make_results(("cartpole",)))) == []


def test_overall_without_an_env_is_that_of_the_others() -> None:
    rows = scored_rows(make_results(("cartpole", "pendulum", "highway")))
    lines = overall(rows, ("pendulum",))
    assert [line.score for line in lines] == sorted((line.score for line in lines), reverse=True)
    assert lines[0].score > lines[-1].score
    assert lines == overall([row for row in rows if row.env != "pendulum"])
    assert {line.envs for line in lines} == {2}


def test_who_asks_the_expert_is_not_among_them() -> None:
    results = make_results(("cartpole", "pendulum"))
    for env in ("cartpole", "pendulum"):
        row = make_row(env, "dagger", 0, "pi_star", return_mean=499.0)
        results.append(CellResult(Cell(env, "dagger", 0), [row]))
    found = {line.method for line in overall(scored_rows(results))}
    assert "bc" in found
    assert "dagger" not in found


def test_a_score_beyond_all_scales_is_none() -> None:
    expert, random = (
        make_row("cartpole", "reference", 0, policy, return_mean=1e-208 * (policy == "expert"))
        for policy in ("expert", "random")
    )
    far = make_row("cartpole", "bc", 0, "pi_star", return_mean=1e100)
    rows = scored_rows(
        [
            CellResult(Cell("cartpole", "reference", 0), [expert, random]),
            CellResult(Cell("cartpole", "bc", 0), [far]),
        ]
    )
    assert [one.normalized_score for one in rows][:2] == [1.0, 0.0]
    assert math.isnan(rows[-1].normalized_score)
    assert math.isnan(leaderboard(rows)[0].score_mean)
