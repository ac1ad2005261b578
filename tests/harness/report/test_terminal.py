"""A terminal shows five lines that are true, and tables within its width."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from harness.records import Cell, CellResult
from harness.report import terminal
from harness.report.heat import heat_map
from harness.report.model import build
from harness.store.request import Request
from tests.harness.made_results import REQUEST, changed, make_results, make_row

RUN = Path("results/latest")
ONE = dataclasses.replace(REQUEST, envs=("cartpole",))


def closing(results: list[CellResult], request: Request = ONE) -> dict[str, str]:
    """Return the closing lines by their labels."""
    lines = terminal.closing(build(request, results), RUN)
    return {line[: terminal.LABEL].strip(): line[terminal.LABEL :] for line in lines}


def table_line(results: list[CellResult], method: str, policy: str) -> str:
    lines = terminal.tables(build(ONE, results))
    return next(line for line in lines if line.split()[:2] == [method, policy])


def test_five_lines_give_the_results_and_where_to_look() -> None:
    results = make_results(("cartpole",))
    lines = closing(results)
    assert list(lines) == ["cells", "pi*", "pi_R", "controls", "look at"]
    # A cell fails that maxmargin has, and both shuffled and clone control are missing.
    counts = "26 ok, 1 failed, 6 missing; budget quick, protocol absorbing, 3 seeds; "
    assert lines["cells"].startswith(counts)
    assert "why some failed: results/latest/run.log; --retry-failed tries them again" in lines["cells"]
    nothing = "no significant difference (2 seeds cannot show any)"
    assert lines["pi*"] == f"cartpole: bc 0.95 [0.35, 0.98], {nothing}"
    assert lines["pi_R"] == f"cartpole: shaped 0.86 [0.32, 0.95], {nothing}"
    where = "results/latest/report.html, and scores.csv there; tables: irl-bench report --print "
    where += "results/latest"
    assert lines["look at"] == where
    results[0] = dataclasses.replace(results[0], recordings={"cartpole.rrd": "0"})
    assert closing(results)["look at"] == f"{where}; recordings: irl-bench view results/latest"


def test_over_tasks_methods_are_named_that_differ_from_the_others() -> None:
    tasks = dataclasses.replace(REQUEST, seeds=tuple(range(10)))
    results = changed(make_results(seeds=10), "control_survival", return_mean=20.0)
    line = closing(results, tasks)["pi*"]
    assert "over 2 tasks, beside the other methods' mean: bc +0.1" in line
    few = changed(make_results(), "control_survival", return_mean=20.0)
    beside = "over 2 tasks, beside the other methods' mean: no significant difference ("
    alike = [r for r in few if r.cell.method != "maxmargin" and r.cell.seed < 2]
    assert beside in closing(alike, REQUEST)["pi*"]


@pytest.mark.parametrize(
    ("method", "level", "expected"),
    [
        ("control_survival", 450.0, "WARNING: an uninformed reward does as well as the best method's on "),
        ("control_plus1", 300.0, "no uninformed reward comes within 0.05 of the best method's; "),
    ],
)
def test_an_uninformed_control_that_ties_is_a_warning(method: str, level: float, expected: str) -> None:
    results = changed(make_results(("cartpole",)), "control_survival", return_mean=20.0)
    line = closing(changed(results, method, return_mean=level))["controls"]
    assert line.startswith(expected)
    assert f"{method} {(level - 20) / 480:.2f}" in line


def test_rl_that_falls_short_on_the_true_reward_is_named_and_no_pi_r_too() -> None:
    results = changed(make_results(("cartpole",)), "control_true", return_mean=300.0)
    assert closing(results)["controls"].endswith("RL on the true reward falls short: 0.58 on cartpole")
    lines = closing([r for r in results if r.cell.method in ("bc", "reference")])
    assert lines["pi_R"] == "no method has a score"
    assert lines["controls"] == "no pi_R to compare with that of an uninformed reward"


def test_numbers_that_are_no_result_are_called_so() -> None:
    one = dataclasses.replace(ONE, seeds=(0,))
    results = make_results(("cartpole",), seeds=1)
    assert closing(results, one)["cells"].endswith("; one seed ranks no methods")
    smoke = dataclasses.replace(one, conditions=dataclasses.replace(one.conditions, budget="smoke"))
    cells = closing(results, smoke)["cells"]
    assert cells.endswith("; NOT A RESULT: budget smoke only shows that everything runs")
    below = [dataclasses.replace(result, below_bar=result.cell.method == "reference") for result in results]
    assert "NOT A RESULT on cartpole: an expert misses its bar" in closing(below)["cells"]


def test_methods_that_are_significantly_worse_or_share_no_seed_are_named() -> None:
    many = dataclasses.replace(ONE, seeds=tuple(range(10)))
    lines = closing(make_results(("cartpole",), 10), many)
    assert lines["pi*"].startswith("cartpole: bc 0.91 [")
    assert lines["pi*"].endswith("], significantly worse: shaped, maxmargin")
    tenth = closing([r for r in make_results(("cartpole",), 10) if r.cell.method != "shaped"], many)
    assert tenth["pi_R"].startswith("cartpole: maxmargin 0.65 [")
    equal = changed(make_results(("cartpole",), 10), "maxmargin", return_mean=457.5, status="ok")
    shows = "no significant difference (10 seeds show 0.67 or more)"
    assert shows in closing([r for r in equal if r.cell.method != "shaped"], many)["pi*"]
    seeds = {"shaped": 0, "maxmargin": 1}
    fewer = [r for r in make_results(("cartpole",)) if seeds.get(r.cell.method, r.cell.seed) == r.cell.seed]
    expected = "cartpole: shaped 0.88 [0.04, 0.99] (1 of 3 seeds), no seed in common: maxmargin"
    assert closing(fewer)["pi_R"] == expected
    line = table_line(fewer, "maxmargin", "pi_R")
    assert "no seed in common" in line
    assert "highest" not in line


def test_a_reward_that_rl_did_not_solve_is_named_and_marked() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "shaped":
            result.rows[1] = dataclasses.replace(result.rows[1], solved=float(result.cell.seed > 0))
        elif result.cell.method == "maxmargin" and result.cell.seed < 2:
            result.rows[1] = dataclasses.replace(result.rows[1], solved=1.0)
    lines = closing(results)
    left = "seeds left out, on which RL did not solve R*: shaped on cartpole (1 of 3)"
    assert lines["pi_R"].startswith("cartpole: shaped 0.86 [0.19, 0.97] (2 of 3 seeds), ")
    assert lines["pi_R"].endswith(f"; {left}")
    assert "RL did not" not in lines["pi*"]
    assert "R* not solved on 1 of 3 seeds" in table_line(results, "shaped", "pi_R")
    groups = heat_map(build(ONE, results).boards).groups.values()
    (tile,) = [tile for group in groups for _, tiles in group for tile in tiles if "†" in tile.mark]
    assert tile.tip.startswith("shaped, π_R, cartpole: ")
    assert tile.tip.endswith("; the highest mean; R* not solved on 1 of 3 seeds (0.88)")
    none = [r for r in results if r.cell.method != "shaped" or r.cell.seed == 0]
    assert "not solved (0.88)" in table_line(none, "shaped", "pi_R")
    assert closing(none)["pi_R"].startswith("cartpole: maxmargin ")
    groups = heat_map(build(ONE, none).boards).groups.values()
    (tile,) = [t for group in groups for _, tiles in group for t in tiles if t.text == "not solved"]
    assert (tile.shade, tile.mark) == (-1, "")


def test_methods_of_plug_ins_are_named_with_score_and_rank() -> None:
    results = make_results(("cartpole",))
    for seed in range(3):
        rows = [make_row("cartpole", "mine", seed, p, return_mean=430.0) for p in ("pi_star", "pi_R")]
        results.append(CellResult(Cell("cartpole", "mine", seed), rows))
    request = dataclasses.replace(ONE, methods=("shaped", "mine", "other"))
    assert closing(results, request)["yours"] == (
        "mine: on cartpole its pi* scores 0.85 [0.31, 0.95] and ranks 3 of 4, "
        "its pi_R scores 0.85 [0.31, 0.95] and ranks 2 of 3; other: no cell of it is finished"
    )
