"""Figures over what is shown and over dynamics say what the lines say."""

from __future__ import annotations

import dataclasses
import math
from typing import cast

import pytest
from harness.show.axes import draw_axes
from matplotlib.figure import Figure

from harness import scale
from harness.judge.leaderboard import leaderboard, scored_rows
from harness.judge.results import NOMINAL, REFERENCE, Cell, CellResult, Shown, row_of
from harness.show import axes


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


def test_scores_are_drawn_against_demonstrations_where_there_are_several() -> None:
    (picture,) = draw_axes("swingup", leaderboard(scored_rows(results((1, 5, 20), (NOMINAL,)))))
    assert picture.file == "swingup_demonstrations.png"
    assert "shaped pi_star with 5: 0.16" in picture.alt
    assert "maxent pi_R with 20: 0.20" in picture.alt
    assert picture.png.startswith(b"\x89PNG")
    assert draw_axes("swingup", leaderboard(scored_rows(results((0,), (NOMINAL,))))) == []
    assert draw_axes("swingup", leaderboard(scored_rows(results((5,), (NOMINAL,))))) == []


def test_what_was_not_retrained_has_no_panel_and_intervals_do_not_stretch_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(axes, "picture", lambda file, title, alt, figure: figure)
    both = results((1, 5, 20), (NOMINAL,))
    for result in both:
        if result.cell.method in ("shaped", "maxent"):
            result.rows[1] = dataclasses.replace(result.rows[1], status="skipped", return_mean=math.nan)
    entries = [
        dataclasses.replace(entry, score_low=-90.0, score_high=90.0)
        for entry in leaderboard(scored_rows(both))
    ]
    (figure,) = draw_axes("swingup", entries)
    (panel,) = cast(Figure, figure).axes
    low, high = panel.get_ylim()
    assert -0.2 < low < 0
    assert 1 < high < 1.2


def test_methods_are_told_apart_by_colour_and_marker_together() -> None:
    count = len(axes.COLOURS) + 5
    looks = {axes.look(number) for number in range(count)}
    assert len(looks) == count


def test_transfer_has_a_panel_for_each_variant_of_what_is_shown_first() -> None:
    entries = leaderboard(scored_rows(results((5, 20), (NOMINAL, "flipped", "heavy"))))
    pictures = {picture.file: picture for picture in draw_axes("swingup", entries)}
    assert list(pictures) == ["swingup_demonstrations.png", "swingup_transfer.png"]
    alt = pictures["swingup_transfer.png"].alt
    for text in ("flipped: shaped pi_star 0.16", "heavy: maxent pi_R 0.05", "heavy: reference expert 1.00"):
        assert text in alt
    assert "0.46" not in alt, "of 20 demonstrations"
    assert draw_axes("swingup", entries)[1].png == pictures["swingup_transfer.png"].png


def test_a_figure_has_as_many_lines_as_its_legend_leaves_room_for() -> None:
    _, many = scale.made_up((1, 60, 2, 1))
    (drawn,) = draw_axes("task0", leaderboard(scored_rows(many)))
    assert drawn.title.endswith("(the first 56 of 60 lines)")
