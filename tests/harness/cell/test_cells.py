"""A whole cell, on the smallest budget, and the cache of its expert."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from harness.cell.experts import source_for
from harness.cell.phases import Phase
from harness.cell.run import prepare, run_cell
from harness.judge.evaluation import evaluate, totals
from harness.records import LEARNED, Cell, CellResult
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import solver_for
from harness.store.artifacts import learned_in
from tests.harness.small_cells import BC, SMOKE, cache, run  # noqa: F401


def timeless(result: CellResult) -> str:
    """Without seconds, and recordings' checksums: rerun numbers its chunks as it likes."""
    rows = [dataclasses.replace(row, fit_seconds=0.0) for row in result.rows]
    named = dict.fromkeys(result.recordings, "")
    result = dataclasses.replace(result, rows=rows, recordings=named, seconds={})
    return repr(result)  # where NaN equals NaN


def recordings(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.rglob("*.rrd"))


def test_a_method_without_reward_has_pi_star_and_a_reason(tmp_path: Path) -> None:
    result = run(BC, tmp_path)
    star, skipped = result.rows
    assert (star.policy, star.status, star.reason) == ("pi_star", "ok", "")
    assert (star.env, star.method, star.seed, star.protocol) == ("cartpole", "bc", 0, "absorbing")
    assert star.episodes == 5
    assert 1 <= star.length_mean <= 500
    assert 0 < star.discounted_mean < star.return_mean <= star.length_mean
    assert star.fit_seconds > 0
    assert (star.env_steps, star.check_steps, star.rl_solves) == (0, 0, 0)
    assert (skipped.policy, skipped.status, skipped.reason) == ("pi_R", "skipped", "learns no reward")
    assert math.isnan(skipped.return_mean)
    assert sum(result.endings["pi_star"].values()) == 5
    assert [x for x, _ in result.curves["loss"]] == list(range(1, 101))
    assert recordings(tmp_path) == [f"cartpole__bc__seed0__pi_star.{it}.rrd" for it in ("median", "worst")]

    again = run(BC, tmp_path / "again")
    assert timeless(again) == timeless(result)


def test_what_was_learned_is_kept_and_scores_as_it_did(tmp_path: Path) -> None:
    cell = Cell("cartpole", "shaped", 1)
    result = run(cell, tmp_path)
    learned = learned_in((tmp_path / LEARNED).read_bytes())
    assert set(learned) == {"pi_star", "pi_R", "reward"}
    for row in result.rows:
        seeds = evaluation_seeds(1, row.episodes)
        scored = evaluate(SPECS["cartpole"], learned[row.policy], seeds, learned["reward"])
        assert scored.columns() == {name: getattr(row, name) for name in scored.columns()}
        assert "own_return" in scored.columns()
        demos = source_for("cartpole", 1, SMOKE).demonstrations(cell.shown)
        shown = totals(learned["reward"], list(zip(demos.obs, demos.act, strict=True)))
        assert row.own_return_shown == pytest.approx(np.mean(shown))
    told: list[int] = []
    rng = rng_for(1, "cartpole", "shaped", "pi_R 0")
    solver = solver_for(SPECS["cartpole"], "absorbing", rng, "sb3", told=told.append)
    again = solver.solve(learned["reward"], SPECS["cartpole"].rl_steps["smoke"])
    assert told == [x for x, _ in result.curves["pi_R"][1:]]
    assert result.curves["pi_R_chosen"] == [max(result.curves["pi_R"], key=lambda point: point[1])]
    obs = np.random.default_rng(0).standard_normal((20, 4))
    assert np.array_equal(again.policy(obs), learned["pi_R"](obs))


@pytest.mark.parametrize(("control", "steps"), [("control_untrained", 4096), ("control_plus1", 0)])
def test_a_control_has_pi_r_alone(tmp_path: Path, control: str, steps: int) -> None:
    result = run(Cell("cartpole", control, 1), tmp_path)
    (row,) = result.rows
    assert (row.policy, row.status, row.env_steps, row.rl_solves) == ("pi_R", "ok", steps, 1)
    assert row.check_steps > 0
    # Of a constant that the offset makes 0 nothing is learned.
    assert ({y for _, y in result.curves["pi_R"]} == {0.0}) == (control == "control_plus1")


def test_where_nothing_is_recorded_scores_and_what_was_learned_are_the_same(tmp_path: Path) -> None:
    conditions, told = dataclasses.replace(SMOKE, record="none"), list[Phase]()
    result, files = run_cell(BC, conditions, prepare([BC], conditions), told.append)
    assert [phase.stage for phase in told] == ["demonstrate", "fit", "score", "score", "record"]
    assert told[-1].returns == {"pi_star": result.rows[0].return_mean}
    assert files.keys() == result.files.keys() == {LEARNED}
    recorded = run(BC, tmp_path)
    nothing = {"recordings": {}, "files": {}}
    assert timeless(dataclasses.replace(recorded, **nothing)) == timeless(
        dataclasses.replace(result, **nothing)
    )
    kept = learned_in((tmp_path / LEARNED).read_bytes())
    obs = np.random.default_rng(0).standard_normal((20, 4))
    assert np.array_equal(learned_in(files[LEARNED])["pi_star"](obs), kept["pi_star"](obs))


def test_the_reference_scores_the_expert_and_a_random_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out_of_reach = dataclasses.replace(SPECS["cartpole"], bar=lambda seeds: 501.0)
    monkeypatch.setitem(SPECS, "cartpole", out_of_reach)
    result = run(Cell("cartpole", "reference", 0), tmp_path)
    expert, random = result.rows
    assert [(row.policy, row.status) for row in result.rows] == [("expert", "ok"), ("random", "ok")]
    shipped = out_of_reach.shipped
    assert shipped is not None
    assert (expert.env_steps, expert.rl_solves) == (shipped.steps, 1)
    assert (random.env_steps, random.check_steps, random.rl_solves) == (0, 0, 0)
    assert random.length_mean < 100
    assert result.curves["expert"] == list(source_for("cartpole", 0, SMOKE).expert.curve)
    assert set(result.endings) == {"expert", "random"}
    (warning,) = result.warnings
    assert result.below_bar
    assert "misses its bar" in warning
    assert f"{expert.return_mean:.2f}" in warning
