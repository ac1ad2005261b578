"""Figures and tables say what the lines say, on pages and in files for papers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.records import NOMINAL, REFERENCE, Cell, CellResult, Shown, row_of
from harness.report import charts, curves, pareto
from harness.report.figures import Chart, styled
from harness.report.files import figure, table
from harness.report.model import Board, build
from tests.harness.made_results import ENVS, REQUEST, changed, make_results
from tests.harness.small_runs import run

__all__ = ["run"]


def results(demos: tuple[int, ...], dynamics: tuple[str, ...]) -> list[CellResult]:
    def scored(cell: Cell, **returns: float) -> CellResult:
        rows = [row_of(cell, p, "absorbing", return_mean=v) for p, v in returns.items()]  # type: ignore[arg-type]
        return CellResult(cell, rows)

    cells = []
    for place in dynamics:
        cells += [scored(Cell("swingup", REFERENCE, 0, dynamics=place), expert=100.0, random=0.0)]
        cells += [scored(Cell("swingup", "control_true", 0, dynamics=place), pi_R=100.0)]
        for count in demos:
            for method in ("shaped", "maxent"):
                cell = Cell("swingup", method, 0, Shown(count), place)
                cells += [scored(cell, pi_star=2.0 * count + len(method), pi_R=float(count))]
    return cells


def drawn(results: list[CellResult]) -> tuple[list[Board], Chart | None]:
    """Return the boards of results, and the chart of scores against demonstrations."""
    report = build(REQUEST, results)
    with styled():
        return list(report.boards), charts.demonstrations(report.boards[0].env, report.entries)


def test_scores_are_drawn_against_demonstrations_where_there_are_several() -> None:
    _, chart = drawn(results((1, 5, 20), (NOMINAL,)))
    assert chart is not None
    star, trained = chart.plots
    assert "shaped with 5: 0.16" in star
    assert 'data-tip="maxent, 20 demonstrations: 0.20 [0.01, 0.96]"' in trained
    for few in ((0,), (5,)):
        assert drawn(results(few, (NOMINAL,)))[1] is None


def test_transfer_shows_policies_carried_over_and_the_expert_in_the_pages_colours() -> None:
    boards, _ = drawn(results((5, 20), (NOMINAL, "flipped", "heavy")))
    variants = [board for board in boards if not board.is_nominal]
    assert len(variants) == 4
    with styled():
        chart = charts.scores(variants[0])
    assert chart is not None
    (plot,) = chart.plots
    assert "shaped π* 0.16" in plot
    assert "0.46" not in plot, "of 20 demonstrations"
    assert plot.count("var(--c2)") == 1, "the expert's level"
    assert "style=" not in plot
    assert "#" not in plot.replace('href="#', "").replace("url(#", "")


def test_learning_curves_and_costs_count_the_steps_of_checks() -> None:
    results = changed(make_results(("cartpole",)), "shaped", check_steps=30_000)
    (board,) = build(REQUEST, results).boards
    with styled():
        curve, cost = curves.learning(board, 60), pareto.costs(board)
    assert curve is not None
    assert curve.data is not None
    mine = curve.data[(curve.data["method"] == "shaped") & (curve.data["curve"] == "pi_R_true")]
    true = [r.curves["pi_R_true"] for r in results if r.cell.method == "shaped"]
    assert mine["x"].tolist() == [3 * x for x, _ in true[0]]
    means = [sum(y for _, y in points) / 3 for points in zip(*true, strict=True)]
    assert mine["mean"].tolist() == pytest.approx([(mean - 20) / 480 for mean in means])
    assert cost is not None
    plots = dict(zip(cost.choices, cost.plots, strict=True))
    both = "shaped π_R 0.86 [0.32, 0.95], "  # fit and RL
    assert f"{both}90,000 interactions" in plots["interactions"]
    assert f"{both}30,000 environment steps" in plots["environment steps"]


def test_scores_after_equal_interactions_count_the_fit_and_are_of_the_best_checkpoint_so_far() -> None:
    results = changed(make_results(("cartpole",), seeds=1), "shaped", env_steps=20_000, check_steps=10_000)
    for result in results:
        if result.cell.method == "shaped":
            result.curves["pi_R"] = [(0.0, 1.0), (5000.0, 3.0), (10_000.0, 2.0)]
            result.curves["pi_R_true"] = [(0.0, 20.0), (5000.0, 260.0), (10_000.0, 500.0)]
    (board,) = build(REQUEST, results).boards
    with styled():
        chart = pareto.equal(board)
    assert chart is not None
    assert chart.table is not None
    scores = {(str(n), method, policy): str(text) for n, method, policy, text in chart.table.items}
    assert {n for n, _, _ in scores} == {"15,000", "30,000", "60,000"}  # control_true, maxmargin, shaped
    told = [scores[n, "shaped", policy] for policy in ("π_R", "π*") for n in ("15,000", "30,000", "60,000")]
    assert told == ["none yet", "0.00", "0.50", "none yet", "0.92", "0.92"]


def test_profiles_have_each_method_over_environments() -> None:
    results = changed(make_results(), "control_survival", return_mean=20.0)
    lines = build(REQUEST, results).across.lines
    with styled():
        chart = charts.profiles(lines, "pi_star")
        assert charts.profiles([], "pi_star") is None
    assert chart is not None
    assert chart.table is not None
    shares = {(method, str(level)): str(share) for method, level, share in chart.table.items}
    assert {method for method, _ in shares} == {"bc", "shaped", "maxmargin"}
    assert (shares["bc", "0.9"], shares["bc", "1"]) == ("100% [100%, 100%]", "0% [0%, 0%]")
    assert shares["shaped", "0.9"].startswith("67% [")


@pytest.mark.parametrize(("kind", "begins"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_figures_for_papers_are_equal_for_equal_results_and_mark_what_is_no_result(
    kind: str, begins: bytes
) -> None:
    report = build(REQUEST, make_results(seeds=1))
    file = figure(report, kind, "cartpole")
    assert file.startswith(begins)
    assert file == figure(report, kind, "cartpole")
    below = [replace(r, below_bar=r.cell.method == "reference") for r in report.results]
    assert file != figure(build(REQUEST, below), kind, "cartpole")


def test_a_figure_for_papers_is_of_scores_against_each_cost_where_one_is_known(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = build(REQUEST, make_results(seeds=1))
    assert len({figure(report, "svg", "cartpole", cost) for cost in (None, *pareto.UNITS)}) == 1 + len(
        pareto.UNITS
    )
    drawn = figure(report, "svg", None, "env_steps").decode()
    assert drawn.count("environment steps (log)") == len(ENVS)
    for cost in pareto.UNITS:
        assert main(["figure", str(run), "--cost", cost, "--to", str(tmp_path / "a.svg")]) == 2
        assert f"is known to cost {pareto.UNITS[cost]}" in capsys.readouterr().err


def test_tables_for_papers_have_the_boards_scores() -> None:
    report = build(REQUEST, make_results())
    tex, md, text = (table(report, kind, "cartpole") for kind in ("tex", "md", "csv"))
    assert tex.count(r"\begin{tabular}{llrrrrlrrl}") == tex.count(r"\bottomrule") == 1
    assert r"shaped & $\pi_R$ & 0.86 [0.32, 0.95] & 0\% [0\%, 63\%] & 0.86 & highest &" in tex
    assert r"maxmargin & $\pi_R$ & 0.68 [0.15, 0.93] & 0\% [0\%, 78\%] & 0.68 & +0.19 ns (none) &" in tex
    assert md.startswith("## cartpole\n\n| Method | Policy | Score [90 %] |")
    assert text.count("\ncartpole,") == sum(entry.env == "cartpole" for entry in report.entries)
    assert table(report, "tex").count(r"\begin{tabular}") == len(ENVS)
    smoke = replace(REQUEST, conditions=replace(REQUEST.conditions, budget="smoke"))
    for kind in ("tex", "md"):
        assert table(build(smoke, make_results()), kind).count("NOT A RESULT") == len(ENVS)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (["--to", "a.docx"], "--to must end in .pdf, .svg, .png, not 'a.docx'"),
        (["--to", "{run}/report.svg"], "lies in the run"),
        (["--to", "a.svg", "--env", "pendulm"], "no env of this run named 'pendulm'"),
    ],
)
def test_a_file_for_a_paper_is_written_and_bad_input_is_a_line_and_writes_nothing(
    run: Path,
    tmp_path: Path,
    more: list[str],
    why: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["figure", str(run), "--to", "good.svg", "--env", "cartpole"]) == 0
    assert main(["table", str(run), "--to", "good.tex"]) == 0
    capsys.readouterr()
    before = {*tmp_path.rglob("*")}
    assert main(["figure", str(run), *(word.format(run=run) for word in more)]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
    assert {*tmp_path.rglob("*")} == before
