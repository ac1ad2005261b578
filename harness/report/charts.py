"""Charts of boards: scores seed by seed, and scores against reward distance and demonstrations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from harness.judge.across_tasks import Overall
from harness.judge.leaderboard import Entry
from harness.judge.rows import counts
from harness.judge.statistics import LEVELS, profile
from harness.records import CONTROLS, NOMINAL, REFERENCE, Row, Shown
from harness.report import columns, figures
from harness.report.columns import METHOD, NAMES, POLICY, SCORE, score
from harness.report.facts import NO_RESULT
from harness.report.figures import BLUE, GREEN, GREY, GROUND, ORANGE, PAPER, Chart, Plot, around, rules, spans
from harness.report.model import Board
from harness.report.tables import LEVEL, Table, at, interval, number

MOST_LINES = 14
"""Methods of a figure of lines; its table has all."""
MOST_DOTS = 50
"""Seeds that have dots of their own; means are of all."""
LOOKS = {"pi_star": (BLUE, "o"), "pi_R": (ORANGE, "D")}
"""Colour and marker of each policy."""
SIGNS = ((0, "●", "π*"), (1, "◆", "π_R, RL on R*"))
CARRIED = ((0, "●", "π* carried over"), (1, "◆", "π_R, trained there on R*"))
PROFILES = (
    at(0, "method", "Method", columns.MEANINGS["method"], "choice"),
    at(1, "level", "Score", "The score that runs reach."),
    at(2, "reaching", "Share of runs", "Over all environments that count.", "interval"),
)


def scores(board: Board) -> Chart | None:
    """Return every seed's score, means and intervals, a row for each method; None without any score."""
    mine = [entry for entry in board.entries if entry.method != REFERENCE]
    known = [entry for entry in mine if math.isfinite(entry.drawn_score)]
    if not known:
        return None
    said = f"Normalized scores in {board.name}: {listed(known)}."
    plot = Plot.of(said, label="normalized score", rows=_rows(board))
    _draw_scores(plot.axes, board, plot.points)
    return Chart(board.name, [plot.svg()], table=Table(f"scores {board.name}", (METHOD, POLICY, SCORE), mine))


def scores_figure(boards: Sequence[Board]) -> Figure:
    """Return the scores of the boards as one figure for print, one below the other."""
    rows = [_rows(board) for board in boards]
    heights = [0.22 * max(3, len(names)) + 0.7 for names in rows]
    figure = Figure(figsize=(6.5, sum(heights) + 0.3), layout="constrained")
    grid = figure.add_gridspec(len(boards), 1, height_ratios=heights)
    for number_, (board, names) in enumerate(zip(boards, rows, strict=True)):
        axes = figure.add_subplot(grid[number_])
        figures.label_rows(axes, names)
        axes.set_title(f"{board.name}{f': {NO_RESULT}' if board.flag else ''}")
        _draw_scores(axes, board, partial(figures.scatter, axes))
    axes.set_xlabel(f"normalized score: 0 random, 1 the expert\ndots: seeds, bars: {LEVEL} intervals")
    for policy, (colour, marker) in LOOKS.items():
        axes.scatter([], [], color=colour, marker=marker, label=NAMES[policy])
    if any(entry.is_unsolved for board in boards for entry in board.entries):
        figures.scatter(axes, [], GREY, "D", hollow=True).set_label("R* not solved")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    return figure


def _rows(board: Board) -> list[str]:
    return [method for method in board.methods if method != REFERENCE]


def _draw_scores(axes: Axes, board: Board, points: Callable[..., object]) -> None:
    """Draw dots for seeds, markers for means and bars for intervals; controls on grey. Markers are hollow
    where RL did not solve the reward.

    points: a function that draws markers at x and y, with colour, marker, tooltips, and whether hollow.
    """
    place = {method: row for row, method in enumerate(_rows(board))}
    controls = [row for method, row in place.items() if method in CONTROLS]
    if controls:
        axes.axhspan(controls[0] - 0.5, controls[-1] + 0.5, color=GROUND, linewidth=0, zorder=-1)
    rules(axes, True, 0.0, 1.0)
    for entry in board.scored("expert") if not board.is_nominal else ():
        axes.axvline(entry.score_mean, color=GREEN, linewidth=1.2, linestyle=":", zorder=0)
    dots: dict[tuple[str, str], list[Row]] = {}
    for row in board.rows:
        if math.isfinite(row.normalized_score):
            dots.setdefault((row.method, row.policy), []).append(row)
    both = {e.method for e in board.drawn("pi_star")} & {e.method for e in board.drawn("pi_R")}
    for policy, (colour, marker) in LOOKS.items():
        mine = board.drawn(policy)
        shift = -0.2 if policy == "pi_star" else 0.2
        ys = [place[e.method] + shift * (e.method in both) for e in mine]
        small = [
            (row.normalized_score, y, to_rgba(colour, 0.45) if counts(row) else to_rgba(PAPER))
            for e, y in zip(mine, ys, strict=True)
            for row in dots[e.method, policy][:MOST_DOTS]
        ]
        xs, rows, inner = zip(*small, strict=True) if small else ([], [], [])
        axes.scatter(xs, rows, 8, color=inner, linewidths=0.5, edgecolors=to_rgba(colour, 0.7))
        spans(axes, [((e.score_low, y), (e.score_high, y)) for e, y in zip(mine, ys, strict=True)], colour)
        for hollow in (False, True):
            some = [(e, y) for e, y in zip(mine, ys, strict=True) if e.is_unsolved == hollow]
            tips = [f"{e.method} {NAMES[policy]}: {score(e)}" for e, _ in some]
            points([(e.drawn_score, y) for e, y in some], colour, marker, tips, hollow)
    every = [row.normalized_score for (method, _), its in dots.items() if method in place for row in its]
    axes.set_xlim(around(every, least=(0.0, 1.0)))


def listed(entries: Sequence[Entry]) -> str:
    """Return the entries' scores in words."""
    return "; ".join(f"{e.method} {NAMES[e.policy]} {score(e)}" for e in entries)


def scale_scores(axes: Axes, scores: Sequence[float]) -> None:
    """Fit the y axis to the scores, and mark 0 and 1."""
    axes.set_ylim(around(scores, least=(0.0, 1.0)))
    rules(axes, False, 0.0, 1.0)


def distances(board: Board) -> Chart | None:
    """Return scores of pi_R against the distances of rewards from the true one; None with fewer than two."""
    known = [e for e in board.drawn("pi_R") if math.isfinite(e.reward_distance)]
    if len(known) < 2:
        return None
    tips = {e.method: f"{e.method}: distance {e.reward_distance:.2f}, score {score(e)}" for e in known}
    said = f"Distances of rewards and scores of π_R in {board.name}: {'; '.join(tips.values())}."
    plot = Plot.of(said, "score of π_R", "distance of R* from the true reward")
    plot.axes.set_xlim(-0.03, 1.03)
    scale_scores(plot.axes, [e.drawn_score for e in known])
    kinds = ((False, False, ORANGE, "D"), (False, True, ORANGE, "D"), (True, False, GREY, "s"))
    for is_control, hollow, colour, marker in kinds:
        mine = [e for e in known if (e.method in CONTROLS, e.is_unsolved) == (is_control, hollow)]
        ends = [((e.reward_distance, e.score_low), (e.reward_distance, e.score_high)) for e in mine]
        spans(plot.axes, ends, colour)
        places = [(e.reward_distance, e.drawn_score) for e in mine]
        plot.points(places, colour, marker, [tips[e.method] for e in mine], hollow)
    places = [(e.reward_distance, e.drawn_score) for e in known]
    figures.name_points(plot.axes, places, [e.method.removeprefix("control_") for e in known])
    shown = (METHOD, columns.DISTANCE, columns.RANK, SCORE)
    return Chart(board.name, [plot.svg()], table=Table(f"distances {board.name}", shown, known))


def demonstrations(env: str, entries: Sequence[Entry]) -> Chart | None:
    """Return an environment's scores against demonstrations, a plot for each policy and a line for each
    method; None with one number of demonstrations."""
    mine = [
        e
        for e in entries
        if e.dynamics == NOMINAL and e.demos and e.method not in (REFERENCE, *CONTROLS)
        if math.isfinite(e.drawn_score)
    ]  # fmt: skip
    counts = sorted({e.demos for e in mine})
    if len(counts) < 2:
        return None
    lines: dict[tuple[str, Shown], list[Entry]] = {}
    for e in mine:
        lines.setdefault((e.method, Shown(0, e.every, e.demonstrator)), []).append(e)
    drawn = list(lines)[:MOST_LINES]
    plots = []
    for policy, name in NAMES.items():
        texts = [f"{e.method} with {e.demos}: {score(e)}" for e in mine if e.policy == policy]
        said = f"Scores of {name} in {env} by demonstrations: {'; '.join(texts)}."
        plot = Plot.of(said, f"{name}: score", "demonstrations (log)")
        plot.axes.set_xscale("log")
        plot.axes.set_xlim(0.8 * counts[0], 1.25 * counts[-1])
        plot.axes.set_xticks(counts, [str(count) for count in counts])
        plot.axes.minorticks_off()
        scale_scores(plot.axes, [e.drawn_score for e in mine])
        for place, line in enumerate(drawn):
            _draw_line(plot, [e for e in lines[line] if e.policy == policy], *figures.look(place))
        plots += [plot.svg()] if texts else []
    legend = [
        figures.sign(place, f"{method}, {way}" if str(way) else method)
        for place, (method, way) in enumerate(drawn)
    ]
    left = f" The first {len(drawn)} of {len(lines)} lines; the table has all." * (len(lines) > len(drawn))
    table = Table(f"demonstrations {env}", (METHOD, POLICY, columns.DEMONSTRATIONS, SCORE), mine)
    return Chart(env, plots, f"Bars: {LEVEL} intervals.{left}", legend, table)


def _draw_line(plot: Plot, entries: Sequence[Entry], colour: str, style: str, marker: str) -> None:
    solved = [(e.demos, e.score_mean) for e in entries if not e.is_unsolved]
    plot.axes.plot(*zip(*solved, strict=True) if solved else ([], []), color=colour, linestyle=style)
    spans(plot.axes, [((e.demos, e.score_low), (e.demos, e.score_high)) for e in entries], colour)
    for hollow in (False, True):
        some = [e for e in entries if e.is_unsolved == hollow]
        tips = [f"{e.method}, {e.demos} demonstrations: {score(e)}" for e in some]
        plot.points([(e.demos, e.drawn_score) for e in some], colour, marker, tips, hollow)


def profiles(lines: Sequence[Overall], policy: str) -> Chart | None:
    """Return the performance profile of each method over environments (Agarwal et al. 2021); None without
    methods."""
    mine = [line for line in lines if line.policy == policy and line.method not in CONTROLS][:MOST_LINES]
    if not mine:
        return None
    middles = "; ".join(f"{line.method} {line.score:.2f}" for line in mine)
    said = f"Performance profiles of {NAMES[policy]}. Interquartile means: {middles}."
    plot, points = Plot.of(said, f"{NAMES[policy]}: share of runs", "score that they reach"), []
    for place, line in enumerate(mine):
        colour, style, marker = figures.look(place)
        share, low, high = profile([*line.scores.values()])
        plot.axes.plot(LEVELS, share, color=colour, linestyle=style)
        plot.axes.fill_between(LEVELS, low, high, color=colour, alpha=0.12, linewidth=0)
        shares = [interval(*ends, ".0%") for ends in zip(share, low, high, strict=True)]
        tips = [f"{line.method}, {level:g}: {one}" for level, one in zip(LEVELS, shares, strict=True)]
        plot.points([*zip(LEVELS, share, strict=True)], colour, marker, tips)
        points += [(line.method, number(level, "g"), one) for level, one in zip(LEVELS, shares, strict=True)]
    legend = [figures.sign(place, line.method) for place, line in enumerate(mine)]
    table = Table(f"profiles {NAMES[policy]}", PROFILES, points)
    return Chart(NAMES[policy], [plot.svg()], legend=legend, table=table)
