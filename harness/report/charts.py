"""Charts of boards: scores seed by seed, and scores against cost, reward distance and demonstrations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator

from harness.judge.comparisons import front
from harness.judge.leaderboard import Entry
from harness.records import CONTROLS, NOMINAL, REFERENCE, Row, Shown
from harness.report import figures
from harness.report.columns import (
    DEMONSTRATIONS,
    DISTANCE,
    METHOD,
    NAMES,
    POLICY,
    RANK,
    SCORE,
    SECONDS,
    SOLVES,
    STEPS,
    score,
)
from harness.report.facts import NO_RESULT
from harness.report.figures import BLUE, GREEN, GREY, GROUND, ORANGE, Chart, Plot, around, rules, spans
from harness.report.model import Board
from harness.report.tables import Table, number

MOST_LINES = 14
"""Methods of a figure of lines; its table has all."""
MOST_DOTS = 50
"""Seeds that have dots of their own; means are of all."""
LOOKS = {"pi_star": (BLUE, "o"), "pi_R": (ORANGE, "D")}
"""Colour and marker of each policy."""
SIGNS = ((0, "●", "π*"), (1, "◆", "π_R, RL on R*"))
CARRIED = ((0, "●", "π* carried over"), (1, "◆", "π_R, trained there on R*"))
UNITS = {"fit_seconds": "seconds", "env_steps": "environment steps", "rl_solves": "RL solves"}
"""Costs of a policy."""


def scores(board: Board) -> Chart | None:
    """Return every seed's score, means and intervals, a row for each method; None without any score."""
    mine = [entry for entry in board.entries if entry.method != REFERENCE]
    known = [entry for entry in mine if math.isfinite(entry.score_mean)]
    if not known:
        return None
    said = f"Normalized scores in {board.name}: {_listed(known)}."
    plot = Plot(said, label="normalized score", rows=_rows(board))
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
        axes.set_title(f"{board.name}{f' ({NO_RESULT}: {board.flag})' if board.flag else ''}")
        _draw_scores(axes, board, partial(figures.scatter, axes))
    axes.set_xlabel("normalized score: 0 random, 1 the expert; dots: seeds, bars: 95 % intervals")
    for policy, (colour, marker) in LOOKS.items():
        axes.scatter([], [], color=colour, marker=marker, label=NAMES[policy])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    return figure


def _rows(board: Board) -> list[str]:
    return [method for method in board.methods if method != REFERENCE]


def _draw_scores(axes: Axes, board: Board, points: Callable[..., None]) -> None:
    """Draw dots for seeds, markers for means and bars for intervals; controls on grey.

    points: a function that draws markers at x and y, with colour, marker and tooltips.
    """
    place = {method: row for row, method in enumerate(_rows(board))}
    controls = [row for method, row in place.items() if method in CONTROLS]
    if controls:
        axes.axhspan(controls[0] - 0.5, controls[-1] + 0.5, color=GROUND, linewidth=0, zorder=-1)
    rules(axes, True, 0.0, 1.0)
    for entry in board.scored("expert") if not board.is_nominal else ():
        axes.axvline(entry.score_mean, color=GREEN, linewidth=1.2, linestyle=":", zorder=0)
    dots = _by_policy(board.rows)
    both = {e.method for e in board.scored("pi_star")} & {e.method for e in board.scored("pi_R")}
    for policy, (colour, marker) in LOOKS.items():
        mine = board.scored(policy)
        shift = -0.2 if policy == "pi_star" else 0.2
        ys = [place[e.method] + shift * (e.method in both) for e in mine]
        small = [(x, y) for e, y in zip(mine, ys, strict=True) for x in dots[e.method, policy][:MOST_DOTS]]
        xs, rows = zip(*small, strict=True) if small else ([], [])
        axes.scatter(xs, rows, 8, color=colour, alpha=0.45, linewidths=0)
        spans(axes, [((e.score_low, y), (e.score_high, y)) for e, y in zip(mine, ys, strict=True)], colour)
        tips = [f"{e.method} {NAMES[policy]}: {score(e)}" for e in mine]
        points([(e.score_mean, y) for e, y in zip(mine, ys, strict=True)], colour, marker, tips)
    every = [value for (method, _), values in dots.items() if method in place for value in values]
    axes.set_xlim(around(every, least=(0.0, 1.0)))


def _by_policy(rows: Sequence[Row]) -> dict[tuple[str, str], list[float]]:
    """Return the scores of all seeds by method and policy."""
    scores: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if math.isfinite(row.normalized_score):
            scores.setdefault((row.method, row.policy), []).append(row.normalized_score)
    return scores


def _listed(entries: Sequence[Entry]) -> str:
    return "; ".join(f"{e.method} {NAMES[e.policy]} {score(e)}" for e in entries)


def costs(board: Board) -> Chart | None:
    """Return scores against costs, with the Pareto front; None where nothing costs anything."""
    points = {name: _costs(board, unit) for unit, name in UNITS.items()}
    plots = [
        _cost_plot(board.name, name, its).svg()
        for name, its in points.items()
        if any(cost > 0 for cost, _ in its)
    ]
    columns = (METHOD, POLICY, SCORE, SECONDS, STEPS, SOLVES)
    methods = [entry for entry in board.entries if entry.role == "method"]
    return Chart(board.name, plots, table=Table(f"cost {board.name}", columns, methods)) if plots else None


def _costs(board: Board, unit: str) -> list[tuple[float, Entry]]:
    """Return the methods' policies with their costs. The cost of pi_R is that of the fit and of RL on R*."""
    stars = {e.method: getattr(e, unit) for e in board.entries if e.policy == "pi_star"}
    points = []
    for entry in board.entries:
        cost = getattr(entry, unit) + (stars.get(entry.method, math.nan) if entry.policy == "pi_R" else 0)
        if entry.role == "method" and math.isfinite(entry.score_mean + cost):
            points.append((cost, entry))
    return points


def _cost_plot(board: str, unit: str, points: Sequence[tuple[float, Entry]]) -> Plot:
    places = [(cost, entry.score_mean) for cost, entry in points]
    best = [points[at] for at in front(places)]
    said = f"Scores in {board} against {unit}. On the Pareto front: {_listed([entry for _, entry in best])}."
    plot = Plot(said, f"score against {unit}", f"{unit} (log)")
    _scale_costs(plot.axes, [cost for cost, _ in points])
    plot.axes.set_ylim(around([value for _, value in places], least=(0.0, 1.0)))
    rules(plot.axes, False, 0.0, 1.0)
    end = (plot.axes.get_xlim()[1], best[-1][1].score_mean)
    corners = [*((cost, entry.score_mean) for cost, entry in best), end]
    plot.axes.step(*zip(*corners, strict=True), where="post", color=GREY, linewidth=1.2)
    for policy, (colour, marker) in LOOKS.items():
        mine = [(cost, entry) for cost, entry in points if entry.policy == policy]
        tips = [f"{_listed([e])}, {number(cost, ',.0f' if cost >= 10 else '.2g')} {unit}" for cost, e in mine]
        plot.points([(cost, entry.score_mean) for cost, entry in mine], colour, marker, tips)
    plot.names([(cost, entry.score_mean, entry.method) for cost, entry in best], places)
    return plot


def _scale_costs(axes: Axes, costs: Sequence[float]) -> None:
    """Make the x axis logarithmic, with a place for 0 where something costs nothing."""
    low, high = min(cost for cost in costs if cost > 0), 1.6 * max(costs)
    free = min(costs) == 0
    axes.set_xscale("symlog", linthresh=low, linscale=0.3) if free else axes.set_xscale("log")
    axes.set_xlim(-0.2 * low if free else 0.7 * low, high)
    digits = (1, 2, 5) if high < 100 * low else (1,)
    ticks = [float(tick) for tick in LogLocator(subs=digits, numticks=6).tick_values(low, high)]
    axes.set_xticks([0.0] * free + [tick for tick in ticks if low <= tick <= high])
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.minorticks_off()


def distances(board: Board) -> Chart | None:
    """Return scores of pi_R against the distances of rewards from the true one; None with fewer than two."""
    known = [e for e in board.scored("pi_R") if math.isfinite(e.reward_distance)]
    if len(known) < 2:
        return None
    texts = [f"{e.method} {e.reward_distance:.2f}, {score(e)}" for e in known]
    said = f"Distances of rewards and scores of π_R in {board.name}: {'; '.join(texts)}."
    plot = Plot(said, "score of π_R", "distance of R* from the true reward")
    plot.axes.set_xlim(-0.03, 1.03)
    plot.axes.set_ylim(around([e.score_mean for e in known], least=(0.0, 1.0)))
    rules(plot.axes, False, 0.0, 1.0)
    for controls, colour, marker in ((False, ORANGE, "D"), (True, GREY, "s")):
        mine = [e for e in known if (e.method in CONTROLS) == controls]
        ends = [((e.reward_distance, e.score_low), (e.reward_distance, e.score_high)) for e in mine]
        spans(plot.axes, ends, colour)
        tips = [f"{e.method}: distance {e.reward_distance:.2f}, score {score(e)}" for e in mine]
        plot.points([(e.reward_distance, e.score_mean) for e in mine], colour, marker, tips)
    names = [(e.reward_distance, e.score_mean, e.method.removeprefix("control_")) for e in known]
    plot.names(names, [(e.reward_distance, e.score_mean) for e in known])
    table = Table(f"distances {board.name}", (METHOD, DISTANCE, RANK, SCORE), known)
    return Chart(board.name, [plot.svg()], table=table)


def demonstrations(env: str, entries: Sequence[Entry]) -> Chart | None:
    """Return an environment's scores against demonstrations, a plot for each policy and a line for each
    method; None with one number of demonstrations."""
    mine = [
        e
        for e in entries
        if e.dynamics == NOMINAL and e.demos and e.method not in (REFERENCE, *CONTROLS)
        if math.isfinite(e.score_mean)
    ]  # fmt: skip
    counts = sorted({e.demos for e in mine})
    if len(counts) < 2:
        return None
    kinds = list(dict.fromkeys((e.method, _way(e)) for e in mine))
    drawn = kinds[:MOST_LINES]
    limits = around([e.score_mean for e in mine], least=(0.0, 1.0))
    plots = []
    for policy, name in NAMES.items():
        of_policy = [e for e in mine if e.policy == policy]
        if of_policy:
            plot = _demonstrations_plot(env, name, of_policy, drawn, counts)
            plot.axes.set_ylim(limits)
            plots.append(plot.svg())
    legend = [
        figures.sign(at, f"{method}, {way}" if str(way) else method) for at, (method, way) in enumerate(drawn)
    ]
    left = f" The first {len(drawn)} of {len(kinds)} lines; the table has all." if kinds[MOST_LINES:] else ""
    table = Table(f"demonstrations {env}", (METHOD, POLICY, DEMONSTRATIONS, SCORE), mine)
    return Chart(env, plots, f"Bars: 95 % intervals.{left}", legend, table)


def _demonstrations_plot(
    env: str,
    name: str,
    entries: Sequence[Entry],
    drawn: Sequence[tuple[str, Shown]],
    counts: Sequence[int],
) -> Plot:
    texts = [f"{e.method} with {e.demos}: {score(e)}" for e in entries]
    said = f"Scores of {name} in {env} by demonstrations: {'; '.join(texts)}."
    plot = Plot(said, f"{name}: score", "demonstrations (log)")
    plot.axes.set_xscale("log")
    plot.axes.set_xlim(0.8 * counts[0], 1.25 * counts[-1])
    plot.axes.set_xticks(counts, [str(count) for count in counts])
    plot.axes.minorticks_off()
    rules(plot.axes, False, 0.0, 1.0)
    for at, kind in enumerate(drawn):
        colour, style, marker = figures.look(at)
        line = [e for e in entries if (e.method, _way(e)) == kind]
        places = [(e.demos, e.score_mean) for e in line]
        plot.axes.plot(*zip(*places, strict=True) if places else ([], []), color=colour, linestyle=style)
        spans(plot.axes, [((e.demos, e.score_low), (e.demos, e.score_high)) for e in line], colour)
        tips = [f"{e.method}, {e.demos} demonstrations: {score(e)}" for e in line]
        plot.points(places, colour, marker, tips)
    return plot


def _way(entry: Entry) -> Shown:
    """Return how demonstrations are shown, apart from their number."""
    return Shown(0, entry.every, entry.demonstrator)
