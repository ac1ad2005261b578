"""Scores against costs, with the Pareto front, and scores after equal numbers of interactions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator

from harness.judge.leaderboard import Entry
from harness.judge.rows import Scales, scales_of
from harness.records import CellResult
from harness.registry.bounds import Curve, thinned
from harness.report import columns, figures
from harness.report.charts import LOOKS, MOST_LINES, listed, scale_scores
from harness.report.columns import MEANINGS, METHOD, NAMES, POLICY, SCORE
from harness.report.figures import GREY, Chart, Plot
from harness.report.model import Board
from harness.report.tables import Table, Value, at, number

UNITS = {
    "interactions": "interactions",
    "env_steps": "environment steps",
    "fit_seconds": "seconds",
    "rl_solves": "RL solves",
}
"""Costs of a policy: fields of entries, and their units."""
MOST_STEPS = 200
"""Points of a line."""
MOST_LEVELS = 6
"""Numbers of interactions in the table of scores after equal ones."""
EQUAL = (
    at(0, "all_interactions", "Interactions", "All interactions of the fit and of RL."),
    at(1, "method", "Method", MEANINGS["method"], "choice"),
    at(2, "policy", "Policy", MEANINGS["policy"], "choice"),
    at(
        3,
        "score_so_far",
        "Score so far",
        "Mean score of the policy after these interactions, over all seeds.",
    ),
)
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
    """Return the scores of boards against a cost as one figure for print, one below the other.

    field: a key of `UNITS`. Each board has a policy with that cost.
    """
    figure = Figure(figsize=(6.5, 2.8 * len(boards) + 0.3), layout="constrained")
    for place, board in enumerate(boards):
        axes = figure.add_subplot(len(boards), 1, place + 1)
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
    scale_scores(axes, [entry.drawn_score for _, entry in points])
    corners = [(cost, entry.score_mean) for cost, entry in front]
    corners += [(axes.get_xlim()[1], level) for _, level in corners[-1:]]
    axes.step(*(zip(*corners, strict=True) if corners else ([], [])), where="post", color=GREY, linewidth=1.2)
    for (policy, (colour, marker)), hollow in itertools.product(LOOKS.items(), (False, True)):
        mine = [(cost, e) for cost, e in points if (e.policy, e.is_unsolved) == (policy, hollow)]
        tips = [f"{listed([e])}, {number(cost, ',.0f' if cost >= 10 else '.2g')} {unit}" for cost, e in mine]
        draw([(cost, e.drawn_score) for cost, e in mine], colour, marker, tips, hollow)


def equal(board: Board) -> Chart | None:
    """Return the scores of policies after equal numbers of all interactions; None without curves of RL.

    The table has them at the numbers after which RL on a method's reward ends.
    """
    scales = scales_of(board.rows)
    methods = [e.method for e in board.entries if e.role == "method"]
    stars = {e.method: e for e in board.scored("pi_star") if e.method in methods}
    curves: dict[str, list[Curve]] = {}
    for result in board.results:
        if result.cell.method in (*methods, "control_true") and (curve := _so_far(result, scales)):
            curves.setdefault(result.cell.method, []).append(curve)
    if not curves:
        return None
    points = [point for its in curves.values() for curve in its for point in curve]
    points += [(e.interactions, e.score_mean) for e in stars.values()]
    lines = [line for level in _levels(curves) for line in _scores_at(level, curves, stars)]
    names = [name for name in board.methods if name in {*curves, *stars}]
    said = f"Scores in {board.name} by all interactions, of {', '.join(names)}."
    plot, drawn = Plot.of(said, "score", "interactions (log)"), names[:MOST_LINES]
    scale_costs(plot.axes, [x for x, _ in points])
    scale_scores(plot.axes, [y for _, y in points])
    for place, name in enumerate(drawn):
        colour, style, marker = figures.look(place)
        steps = thinned(sorted({x for curve in curves.get(name, ()) for x, _ in curve}), MOST_STEPS)
        means = [_mean_at(curves[name], x) for x in steps]
        plot.axes.plot(steps, means, color=colour, linestyle=style, drawstyle="steps-post")
        if e := stars.get(name):
            tip = f"{name} π*: {e.score_mean:.2f} after {e.interactions:,.0f} interactions"
            plot.points([(e.interactions, e.score_mean)], colour, marker, [tip])
    left = f"The first {len(drawn)} of {len(names)} methods; the table has all." * (len(names) > len(drawn))
    legend = [figures.sign(place, name) for place, name in enumerate(drawn)]
    return Chart(board.name, [plot.svg()], left, legend, Table(f"equal {board.name}", EQUAL, lines))


def _levels(curves: Mapping[str, Sequence[Curve]]) -> list[float]:
    """Return the interactions after which methods' curves end, at most `MOST_LEVELS`."""
    ends = {float(np.mean([curve[-1][0] for curve in its])) for its in curves.values()}
    return thinned(sorted(ends), MOST_LEVELS)


def _scores_at(
    level: float, curves: Mapping[str, Sequence[Curve]], stars: Mapping[str, Entry]
) -> list[tuple[Value | str, ...]]:
    """Return the lines of `EQUAL` for a number of interactions, the best first."""
    scores = {(name, "pi_R"): _mean_at(its, level) for name, its in curves.items()}
    for name, e in stars.items():
        scores[name, "pi_star"] = e.score_mean if e.interactions <= level else math.nan
    best = sorted(scores.items(), key=lambda item: -item[1] if math.isfinite(item[1]) else math.inf)
    return [
        (
            number(level, ",.0f"),
            name,
            NAMES[policy],
            number(score, "z.2f") if math.isfinite(score) else Value("none yet"),
        )
        for (name, policy), score in best
    ]


def _so_far(result: CellResult, scales: Scales) -> Curve:
    """Return the score of the checkpoint with the highest return under R* so far by all interactions.

    RL's interactions count from the end of the fit. Several solves count as if they ran side by side.
    """
    costs = {row.policy: row.env_steps + row.check_steps for row in result.rows if row.status == "ok"}
    own, true = result.curves.get("pi_R", []), dict(result.curves.get("pi_R_true", []))
    low, scale = scales.get((result.cell.task, result.cell.seed), (math.nan, math.nan))
    fit, rl = costs.get("pi_star", 0.0), costs.get("pi_R", math.nan)
    best, score, points = -math.inf, math.nan, []
    for step, value in own:
        if value > best:
            best, score = value, (true.get(step, math.nan) - low) / scale
        points.append((fit + rl * step / max(1.0, own[-1][0]), score))
    return [point for point in points if math.isfinite(sum(point))]


def _mean_at(curves: Sequence[Curve], level: float) -> float:
    """Return the mean of the curves' last values up to a number of interactions, NaN where one has none."""
    return float(np.mean([next((y for x, y in reversed(c) if x <= level), math.nan) for c in curves]))


def scale_costs(axes: Axes, costs: Sequence[float]) -> None:
    """Make the x axis logarithmic, with a place for 0 where something costs nothing."""
    low = min((cost for cost in costs if cost > 0), default=1.0)
    high = 1.6 * max(*costs, low)
    free = min(costs) == 0
    axes.set_xscale("symlog", linthresh=low, linscale=0.3) if free else axes.set_xscale("log")
    axes.set_xlim(-0.2 * low if free else 0.7 * low, high)
    digits = (1, 2, 5) if high < 100 * low else (1,)
    ticks = [float(tick) for tick in LogLocator(subs=digits, numticks=6).tick_values(low, high)]
    axes.set_xticks([0.0] * free + thinned([tick for tick in ticks if low <= tick <= high], 5))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.minorticks_off()
