"""What a terminal shows of results: five lines that are true, and tables within its width."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.records import Cell, CellResult
from harness.report import terminal
from harness.report.heat import heat_map
from harness.report.model import build
from harness.store.request import Request
from tests.harness.made_results import REQUEST, make_results, make_row

RUN = Path("results/latest")
ONE = dataclasses.replace(REQUEST, envs=("cartpole",))


def found(results: list[CellResult], request: Request = ONE) -> dict[str, str]:
    """Return the closing lines by their labels."""
    lines = terminal.closing(build(request, results), RUN)
    return {line[: terminal.LABEL].strip(): line[terminal.LABEL :] for line in lines}


def changed(results: list[CellResult], method: str, **values: object) -> list[CellResult]:
    """With these values in all rows of the method."""
    for result in results:
        if result.cell.method == method:
            result.rows[:] = [dataclasses.replace(row, **values) for row in result.rows]  # type: ignore[arg-type]
    return results


def test_five_lines_say_what_was_found_and_where_to_look() -> None:
    lines = found(make_results(("cartpole",)))
    assert list(lines) == ["cells", "pi*", "pi_R", "controls", "look at"]
    # A cell fails that maxmargin has, and both shuffled and clone control are missing.
    assert lines["cells"].startswith(
        "26 ok, 1 failed, 6 missing; budget quick, protocol absorbing, 3 seeds; "
    )
    assert "why some failed: results/latest/run.log; --retry-failed tries them again" in lines["cells"]
    assert lines["pi*"] == "cartpole: bc 0.95 [0.92, 0.97]"
    assert lines["pi_R"] == "cartpole: shaped 0.86 [0.84, 0.89]"
    assert lines["look at"] == (
        "results/latest/report.html, and scores.csv there; tables: irl-bench report --print results/latest"
    )


def test_a_control_that_ties_is_a_warning() -> None:
    results = make_results(("cartpole",))
    # Survival has 450 of 500, the best method 440.
    assert found(results)["controls"] == (
        "WARNING: an uninformed reward does as well as the best method's on cartpole (control_survival 0.89)"
    )
    lower = found(changed(results, "control_survival", return_mean=300.0))["controls"]
    assert lower == (
        "no uninformed reward comes within 0.05 of the best method's; "
        "the highest: control_survival 0.58 on cartpole"
    )


def test_a_lower_control_that_ties_is_a_warning_too() -> None:
    results = changed(make_results(("cartpole",)), "control_survival", return_mean=20.0)
    told = found(changed(results, "control_plus1", return_mean=430.0))["controls"]
    assert "cartpole (control_plus1 0.85)" in told


def test_rl_that_falls_short_on_the_true_reward_is_told() -> None:
    results = changed(make_results(("cartpole",)), "control_true", return_mean=300.0)
    assert found(results)["controls"].endswith("RL on the true reward falls short: 0.58 on cartpole")


def test_one_seed_ranks_no_methods_and_smoke_is_no_result() -> None:
    one = dataclasses.replace(ONE, seeds=(0,))
    assert found(make_results(("cartpole",), seeds=1), one)["cells"].endswith("; one seed ranks no methods")
    smoke = dataclasses.replace(one, conditions=dataclasses.replace(one.conditions, budget="smoke"))
    told = found(make_results(("cartpole",), seeds=1), smoke)["cells"]
    assert told.endswith("; NOT A RESULT: budget smoke only shows that everything runs")


def test_an_expert_below_its_bar_is_told() -> None:
    results = [
        dataclasses.replace(result, below_bar=result.cell.method == "reference")
        for result in make_results(("cartpole",))
    ]
    assert "NOT A RESULT on cartpole: an expert misses its bar" in found(results)["cells"]


def test_what_is_not_told_apart_from_the_best_is_named() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "shaped":
            swing = (30.0, -40.0, 10.0)[result.cell.seed]
            result.rows[:] = [dataclasses.replace(row, return_mean=470 + swing) for row in result.rows]
    assert found(results)["pi*"] == "cartpole: bc 0.95 [0.92, 0.97], not significantly worse: shaped"


def test_a_reward_that_rl_did_not_solve_is_named_and_marked() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "shaped":
            result.rows[1] = dataclasses.replace(result.rows[1], solved=float(result.cell.seed > 0))
        elif result.cell.method == "maxmargin" and result.cell.seed < 2:
            result.rows[1] = dataclasses.replace(result.rows[1], solved=1.0)
    lines = found(results)
    assert lines["pi_R"].endswith(
        "; RL did not solve R* on every seed, so the score says nothing about the reward: shaped on cartpole"
    )
    assert "RL did not" not in lines["pi*"]
    (marked,) = [line for line in terminal.tables(build(ONE, results)) if "R* solved on 67% of seeds" in line]
    assert marked.split()[:2] == ["shaped", "pi_R"]
    groups = heat_map(build(ONE, results).boards).groups
    (tile,) = [t for group in groups for tiles in group.tiles for t in tiles if "†" in t.mark]
    assert tile.tip.startswith("shaped, π_R, cartpole: ")
    assert tile.tip.endswith("; the best; RL solved R* on 67% of seeds")


def test_methods_of_plug_ins_are_named_with_score_and_rank() -> None:
    results = make_results(("cartpole",))
    mine = [dataclasses.replace(r.cell, method="mine") for r in results if r.cell.method == "shaped"]
    rows = [
        [make_row("cartpole", "mine", c.seed, p, return_mean=430.0) for p in ("pi_star", "pi_R")]
        for c in mine
    ]
    results += [CellResult(cell, its) for cell, its in zip(mine, rows, strict=True)]
    request = dataclasses.replace(ONE, methods=("shaped", "mine", "other"))
    assert found(results, request)["yours"] == (
        "mine: on cartpole its pi* scores 0.85 [0.85, 0.85] and ranks 3 of 4, "
        "its pi_R scores 0.85 [0.85, 0.85] and ranks 2 of 3; other: no cell of it is finished"
    )
    assert "yours" not in found(make_results(("cartpole",)))


def test_who_shares_no_seed_with_the_best_is_named_apart() -> None:
    kept = {"shaped": 0, "maxmargin": 1}
    results = [r for r in make_results(("cartpole",)) if kept.get(r.cell.method, r.cell.seed) == r.cell.seed]
    assert found(results)["pi_R"] == (
        "cartpole: shaped 0.88 [0.87, 0.88] (1 of 3 seeds), no seed in common: maxmargin"
    )
    (line,) = [
        line for line in terminal.tables(build(ONE, results)) if line.split()[:2] == ["maxmargin", "pi_R"]
    ]
    assert "no seed in common" in line
    assert "the best" not in line


def test_a_number_beyond_all_bounds_is_short() -> None:
    results = changed(make_results(("cartpole",)), "shaped", return_mean=1e99)
    assert "shaped 2.083e+96" in found(results)["pi_R"]
    assert max(map(len, terminal.tables(build(ONE, results)))) <= 100


def test_a_best_of_fewer_seeds_says_so() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "maxmargin" and result.rows[0].status == "ok":
            result.rows[:] = [dataclasses.replace(row, return_mean=490.0) for row in result.rows]
    assert found(results)["pi_R"].startswith("cartpole: maxmargin 0.98 [0.98, 0.98] (2 of 3 seeds)")


def test_of_many_boards_it_counts() -> None:
    envs = ("cartpole", "pendulum", "highway", "acrobot")
    lines = found(make_results(envs), dataclasses.replace(REQUEST, envs=envs))
    assert lines["pi*"] == "best, or not significantly worse, of 4 boards: bc on 4"
    assert lines["pi_R"] == "best, or not significantly worse, of 4 boards: shaped on 4"


def test_who_asks_the_expert_is_marked_and_no_rival() -> None:
    results = make_results(("cartpole",))
    for seed in range(3):
        row = make_row("cartpole", "dagger", seed, "pi_star", return_mean=499.0)
        results.append(CellResult(Cell("cartpole", "dagger", seed), [row]))
    assert found(results)["pi*"] == "cartpole: bc 0.95 [0.92, 0.97]; dagger asks the expert and is not ranked"
    table = "\n".join(terminal.tables(build(ONE, results)))
    assert "asks the expert: not ranked" in table


def test_cells_of_a_baseline_are_counted_apart() -> None:
    results = changed(make_results(("cartpole",)), "bc", source="baseline one")
    assert found(results)["cells"].startswith("23 ok, 1 failed, 6 missing, 3 of a baseline; ")


def test_without_pi_r_there_is_nothing_to_compare() -> None:
    results = [r for r in make_results(("cartpole",)) if r.cell.method in ("bc", "reference")]
    lines = found(results)
    assert lines["pi_R"] == "no method has a score"
    assert lines["controls"] == "no pi_R to compare with that of an uninformed reward"


def test_recordings_are_named_where_there_are_any() -> None:
    first, *others = make_results(("cartpole",))
    recorded = dataclasses.replace(first, recordings={"cartpole.rrd": "0"})
    assert found([recorded, *others])["look at"].endswith("; recordings: irl-bench view results/latest")


@pytest.fixture
def width(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Makes standard output a terminal of so many columns."""

    def set_to(columns: int) -> None:
        monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
        monkeypatch.setenv("COLUMNS", str(columns))

    return set_to


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_tables_have_five_columns_within_the_terminals_width(
    columns: int, width: Callable[[int], None]
) -> None:
    width(columns)
    lines = terminal.tables(build(REQUEST, make_results()))
    assert max(map(len, lines)) <= columns
    heading = next(line for line in lines if "Method" in line)
    assert all(name in heading for name in ("Method", "Policy", "Score", "Behind the best", "Note"))
    shaped = next(line for line in lines if line.startswith(" shaped") and "pi_R" in line)
    assert shaped.split()[:3] == ["shaped", "pi_R", "0.86"]
    assert ("[0.84, 0.89]" in shaped) == (columns >= terminal.WITH_INTERVALS)
    assert "the best" in shaped
    assert sum("Method" in line for line in lines) == 2, "a table for each board"
    told = " ".join(" ".join(lines).split())
    for control in ("upper", "survival", "lower"):
        assert control in told
    assert "…" not in told


@pytest.mark.parametrize("columns", [60, 200])
def test_lines_are_wrapped_on_a_terminal_alone(columns: int, width: Callable[[int], None]) -> None:
    lines = terminal.closing(build(ONE, make_results(("cartpole",))), RUN)
    assert [terminal.wrapped(line) for line in lines] == lines, "of a file a line is one line"
    width(columns)
    for line in lines:
        wrapped = terminal.wrapped(line)
        assert " ".join(wrapped.split()) == " ".join(line.split())
        assert max(map(len, wrapped.splitlines())) <= columns
        assert all(more.startswith(" " * terminal.LABEL) for more in wrapped.splitlines()[1:])
