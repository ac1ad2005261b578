"""Scores against costs, with the Pareto front."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator

from harness.judge.leaderboard import Entry
from harness.report import columns, figures
from harness.report.charts import LOOKS, listed, scale_scores
from harness.report.columns import METHOD, NAMES, POLICY, SCORE
from harness.report.figures import GREY, Chart, Plot
from harness.report.model import Board
from harness.report.tables import Table, number

UNITS = {
    "interactions": "interactions",
    "env_steps": "environment steps",
    "fit_seconds": "seconds",
    "rl_solves": "RL solves",
}
"""Costs of a policy: fields of entries, and their units."""
Points = Sequence[tuple[float, Entry]]


def costs(board: Board) -> Chart | None:
    """Return scores against each cost; None where nothing costs anything.

    The cost of pi_R is that of the fit and of RL on R*.
    """
    plots, fronts = {}, []
    for field, unit in UNITS.items():
        if points := priced(board, field):
            front = _front(points)
            fronts.append(f"{unit}: {', '.join(f'{e.method} {NAMES[e.policy]}' for _, e in front)}")
            said = f"Scores in {board.name} against {unit}. On the Pareto front: "
            plot = Plot.of(
                f"{said}{listed([e for _, e in front])}.", f"score against {unit}", f"{unit} (log)"
            )
            _draw(plot.axes, points, front, unit, plot.points)
            plots[unit] = plot.svg()
    shown = (METHOD, POLICY, SCORE, columns.SECONDS, columns.STEPS, columns.CHECKS, columns.SOLVES)
    table = Table(f"cost {board.name}", shown, [entry for entry in board.entries if entry.role == "method"])
    note = f"On the front by {'; by '.join(fronts)}."
    return Chart(board.name, [*plots.values()], note, table=table, choices=[*plots]) if plots else None


def costs_figure(boards: Sequence[Board], field: str) -> Figure:
    """Return the scores of boards against a cost as one figure for print, two boards in a row.

    field: a key of `UNITS`. Each board has a policy with that cost.
    """
    rows, across = -(-len(boards) // 2), min(2, len(boards))
    figure = Figure(figsize=(3.25 * across, 2.8 * rows + 0.3), layout="constrained")
    for place, board in enumerate(boards):
        axes = figure.add_subplot(rows, across, place + 1)
        axes.set(title=board.name, xlabel=f"{UNITS[field]} (log)", ylabel="normalized score")
        points = priced(board, field)
        front = _front(points)
        _draw(axes, points, front, UNITS[field], partial(figures.scatter, axes))
        named = [*front, *(point for point in points if point not in front)]
        figures.name_points(axes, [(c, e.drawn_score) for c, e in named], [e.method for _, e in named])
    for policy, (colour, marker) in LOOKS.items():
        axes.scatter([], [], color=colour, marker=marker, label=NAMES[policy])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    return figure


def priced(board: Board, field: str) -> Points:
    """Return the scored policies of methods with their costs, empty where all cost nothing. `field`: a key of
    `UNITS`."""
    methods = [entry for entry in board.entries if entry.role == "method"]
    stars = {e.method: getattr(e, field) for e in methods if e.policy == "pi_star"}
    points = [
        (getattr(e, field) + (stars.get(e.method, math.nan) if e.policy == "pi_R" else 0), e) for e in methods
    ]
    points = [(cost, e) for cost, e in points if math.isfinite(cost + e.drawn_score)]
    return points if any(cost > 0 for cost, _ in points) else []


def _front(points: Points) -> Points:
    """Return the points that no other one beats, by cost."""
    front: list[tuple[float, Entry]] = []
    for cost, entry in sorted(points, key=lambda point: (point[0], -point[1].score_mean)):
        if not entry.is_unsolved and (not front or entry.score_mean > front[-1][1].score_mean):
            front.append((cost, entry))
    return front


def _draw(axes: Axes, points: Points, front: Points, unit: str, draw: Callable[..., object]) -> None:
    """Draw policies and their front. `draw`: as `points` of `charts._draw_scores`."""
    scale_costs(axes, [cost for cost, _ in points])
    scale_scores(axes, [entry for _, entry in points])
    corners = [(cost, entry.score_mean) for cost, entry in front]
    corners += [(axes.get_xlim()[1], level) for _, level in corners[-1:]]
    axes.step(*(zip(*corners, strict=True) if corners else ([], [])), where="post", color=GREY, linewidth=1.2)
    for (policy, (colour, marker)), hollow in itertools.product(LOOKS.items(), (False, True)):
        mine = [(cost, e) for cost, e in points if (e.policy, e.is_unsolved) == (policy, hollow)]
        tips = [f"{listed([e])}, {number(cost, ',.0f' if cost >= 10 else '.2g')} {unit}" for cost, e in mine]
        draw([(cost, e.drawn_score) for cost, e in mine], colour, marker, tips, hollow)


def scale_costs(axes: Axes, costs: Sequence[float]) -> None:
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
