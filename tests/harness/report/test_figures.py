"""Figures over what is shown and over dynamics say what the lines say."""

from __future__ import annotations

from harness.benchmarks import scale
from harness.records import NOMINAL, REFERENCE, Cell, CellResult, Shown, row_of
from harness.report import charts
from harness.report.figures import Chart, look, styled
from harness.report.model import Board, build
from tests.harness.made_results import REQUEST


def results(demos: tuple[int, ...], dynamics: tuple[str, ...]) -> list[CellResult]:
    def made(cell: Cell, **returns: float) -> CellResult:
        rows = [row_of(cell, p, "absorbing", return_mean=v) for p, v in returns.items()]  # type: ignore[arg-type]
        return CellResult(cell, rows)

    found = []
    for place in dynamics:
        found += [made(Cell("swingup", REFERENCE, 0, dynamics=place), expert=100.0, random=0.0)]
        found += [made(Cell("swingup", "control_true", 0, dynamics=place), pi_R=100.0)]
        for count in demos:
            for method in ("shaped", "maxent"):
                cell = Cell("swingup", method, 0, Shown(count), place)
                found += [made(cell, pi_star=2.0 * count + len(method), pi_R=float(count))]
    return found


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
    assert "maxent with 20: 0.20" in trained
    assert 'data-tip="maxent, 20 demonstrations: 0.20"' in trained
    for few in ((0,), (5,)):
        assert drawn(results(few, (NOMINAL,)))[1] is None


def test_lines_differ_in_colour_style_and_marker_together() -> None:
    assert len({look(number) for number in range(24)}) == 24


def test_transfer_shows_policies_carried_over_and_the_expert() -> None:
    boards, _ = drawn(results((5, 20), (NOMINAL, "flipped", "heavy")))
    variants = [board for board in boards if not board.is_nominal]
    assert [board.name for board in variants] == [
        f"swingup.{name}, {count} demonstrations" for name in ("flipped", "heavy") for count in (5, 20)
    ]
    with styled():
        plots = [plot for board in variants if (chart := charts.scores(board)) for plot in chart.plots]
        again = charts.scores(variants[0])
    assert "shaped π* 0.16" in plots[0]
    assert "0.46" not in plots[0], "of 20 demonstrations"
    assert plots[0].count("var(--c2)") == 1, "the expert's level"
    assert again is not None
    assert again.plots == plots[:1]


def test_a_figure_has_as_many_lines_as_can_be_distinguished_and_its_table_has_all() -> None:
    _, many = scale.made_up((1, 20, 2, 1))
    _, chart = drawn(many)
    assert chart is not None
    assert "The first 14 of 20 lines" in chart.note
    assert chart.table is not None
    assert len({entry.method for entry in chart.table.items}) == 20
    assert len(chart.legend) == 14


def test_a_page_has_no_style_attributes_and_colours_of_its_own() -> None:
    boards, _ = drawn(results((5,), (NOMINAL,)))
    with styled():
        chart = charts.scores(boards[0])
    assert chart is not None
    (plot,) = chart.plots
    assert "style=" not in plot
    assert "#" not in plot.replace('href="#', "").replace("url(#", "")
