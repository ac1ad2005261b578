"""Curves of RL on R*, as in the thesis's figure 5.3, and of the methods' own training: a panel for each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import EngFormatter, MaxNLocator
from numpy.typing import NDArray

from harness.judge.numbers import as_text
from harness.judge.rows import scales_of
from harness.records import REFERENCE
from harness.registry.bounds import Curve, thinned
from harness.report.figures import BLUE, GREEN, GREY, ORANGE, PINK, Chart, Plot, around
from harness.report.model import Board

MOST_DRAWN = 40
"""Points of a line."""
MOST_SEEDS = 50
"""Seeds whose curves are drawn, and counted in means and ranges."""
OWN = ("pi_R", "pi_R_true", "pi_R_chosen", "expert")
"""Curves of RL; others are those of a method's fit."""
COLUMNS, WIDTH, HEIGHT = 4, 260.0, 150.0
"""Panels in a row, and the size of each in pixels."""
SIGNS = (
    (1, "━", "score of RL on R*, with the range over seeds"),
    (1, "○", "the checkpoint that counts, a ring for each seed"),
    (3, "┉", "return under R* itself (axis on the right)"),
    (0, "╍", "RL on the true reward"),
    (2, "┈", "level of π*"),
)
Limits = tuple[float, float]
Array = NDArray[np.float64]
Summaries = Mapping[tuple[str, str], Array]
"""Summaries of curves by method and name."""


class Panels(Plot):
    """Small plots in one pair of axes, whose units are pixels from the top left. They take as long as one."""

    def __init__(self, said: str, count: int) -> None:
        width, height = COLUMNS * WIDTH, -(-count // COLUMNS) * HEIGHT
        figure = Figure(figsize=(width / 72, height / 72))
        figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0)).set_axis_off()
        super().__init__(said, figure)

    def begin(self, number: int, title: str, x: Limits, y: Limits) -> None:
        """Begin the panel of this number, with its title and the limits of its axes."""
        self._left, self._top = number % COLUMNS * WIDTH + 44, number // COLUMNS * HEIGHT + 18
        self._right, self._bottom = self._left + WIDTH - 78, self._top + HEIGHT - 38
        self._x = x
        frame = [self._left, self._left, self._right], [self._top, self._bottom, self._bottom]
        self.axes.add_artist(Line2D(*frame, color=GREY, linewidth=0.8))
        short = title if len(title) <= 32 else title[:31] + "…"
        self.axes.text(self._left - 36, self._top - 6, short, weight="bold")
        for value, text in _ticks(x):
            across = self.places(np.array([(value, 0.0)]), (0.0, 1.0))[0, 0]
            self.axes.text(across, self._bottom + 12, text, ha="center", color=GREY, fontsize=9)
        self.scale(y)

    def scale(self, y: Limits, right: str = "") -> None:
        """Write the ticks of an upright axis, on the left, or in a colour on the right."""
        place, side = (self._right + 4, "left") if right else (self._left - 4, "right")
        for value, text in _ticks(y):
            down = self.places(np.array([(self._x[0], value)]), y)[0, 1]
            self.axes.text(place, down + 3, text, ha=side, color=right or GREY, fontsize=9)

    def line(self, points: Array | None, y: Limits, colour: str, style: str = "-") -> None:
        """Draw a line through points (N, 2 or more): x and y, where all are finite."""
        if points is not None and np.isfinite(points).all():
            line = Line2D(*self.places(points[:, :2], y).T, color=colour)
            line.set(linestyle=style)
            self.axes.add_artist(line)

    def curve(self, summary: Array | None, y: Limits, colour: str) -> None:
        """Draw a summary: its mean, in a band from the lowest to the highest."""
        if summary is not None:
            ends = np.concatenate([summary[:, [0, 2]], summary[::-1, [0, 3]]])
            self.axes.add_artist(Polygon(self.places(ends, y), color=colour, alpha=0.16, linewidth=0))
            self.line(summary, y, colour)

    def places(self, points: Array, y: Limits) -> Array:
        """Return points in pixels, (N, 2); those beyond the panel lie on its edge."""
        shares = (points - (self._x[0], y[0])) / (self._x[1] - self._x[0], y[1] - y[0])
        span = self._right - self._left, self._top - self._bottom
        return np.asarray(np.clip(shares, 0.0, 1.0) * span + (self._left, self._bottom))


def _ticks(limits: Limits) -> list[tuple[float, str]]:
    """Return values within the limits, and their texts."""
    low, high = limits
    values = [float(v) for v in MaxNLocator(2, steps=[1, 2, 5, 10]).tick_values(low, high)]
    text = EngFormatter(sep="") if max(abs(low), abs(high)) >= 1000 else lambda value: f"{value:.6g}"
    return [(v, text(v).replace("-", "\N{MINUS SIGN}")) for v in values if low <= v <= high]


def learning(board: Board, most: int) -> Chart | None:
    """Return a panel for each method that was retrained, at most `most`; None where none was."""
    by_method = _scored(board)
    methods = [m for m in board.methods if any(r.get("pi_R") for r in by_method.get(m, ()))]
    means = {
        (method, name): summary
        for method in dict.fromkeys([REFERENCE, "control_true", *methods[:most]])
        for name in ("expert", "pi_R", "pi_R_true")
        if len(summary := _summary([r.get(name, []) for r in by_method.get(method, ())]))
    }
    true = [summary for (_, name), summary in means.items() if name == "pi_R_true"]
    drawn = [method for method in methods[:most] if (method, "pi_R") in means]
    if not true or not drawn:
        return None
    stars = {e.method: e.score_mean for e in board.entries if e.policy == "pi_star"}
    y = around([value for summary in true for value in summary[:, 2:].flat] + list(stars.values()))
    longest = max(1.0, *(summary[-1, 0] for (_, name), summary in means.items() if name != "expert"))
    said = f"RL on rewards in {board.name}: score and return under R* by interactions, of {', '.join(drawn)}."
    panels = Panels(said, len(drawn))
    for number, method in enumerate(drawn):
        panels.begin(number, method, (0.0, longest), y)
        if method != "control_true":
            panels.line(means.get(("control_true", "pi_R_true")), y, BLUE, "--")
        star = stars.get(method, math.nan)
        panels.line(np.array([(0.0, star), (longest, star)]), y, GREEN, ":")
        under = around([*means[method, "pi_R"][:, 1]])
        panels.line(means[method, "pi_R"], under, PINK, "-.")
        panels.scale(under, PINK)
        panels.curve(means.get((method, "pi_R_true")), y, ORANGE)
        rings = list(filter(None, map(_chosen, by_method[method][:MOST_SEEDS])))
        tips = [f"{method}, {x:,.0f} interactions: score {as_text(v, 'z.2f')}" for x, v in rings]
        panels.points(panels.places(np.array(rings).reshape(-1, 2), y).tolist(), ORANGE, "o", tips)
    return Chart(board.name, [panels.svg()], _left_out(board, len(methods), most), data=_data(board, means))


def training(board: Board, most: int) -> Chart | None:
    """Return a panel for each curve that a method reports of its fit, at most `most`; None without any."""
    curves: dict[tuple[str, str], list[Curve]] = {}
    for result in board.results:
        for name, points in result.curves.items():
            if name not in OWN and points:
                curves.setdefault((result.cell.method, name), []).append(points)
    summaries = {key: mine for key in list(curves)[:most] if len(mine := _summary(curves[key]))}
    if not summaries:
        return None
    names = ", ".join(": ".join(key) for key in summaries)
    panels = Panels(f"Training of methods in {board.name}, by iteration: {names}.", len(summaries))
    for number, (key, summary) in enumerate(summaries.items()):
        first, last, y = summary[0, 0], summary[-1, 0], around([*summary[:, 2:].flat])
        panels.begin(number, ": ".join(key), (first, max(first + 1.0, last)), y)
        panels.curve(summary, y, BLUE)
    note = _left_out(board, len(curves), most)
    return Chart(board.name, [panels.svg()], note, data=_data(board, summaries))


def _left_out(board: Board, panels: int, most: int) -> str:
    """Return what is not drawn, in words."""
    seeds = len({result.cell.seed for result in board.results})
    of_panels = f"The first {most} of {panels} panels. " if panels > most else ""
    of_seeds = f"Curves are of the first {MOST_SEEDS} of {seeds} seeds." if seeds > MOST_SEEDS else ""
    return (of_panels + of_seeds).strip()


def _summary(seeds: Sequence[Curve]) -> Array:
    """Return x, and the mean, the lowest and the highest y there, (N, 4), where all seeds that have the curve
    have a point; at most `MOST_DRAWN` lines."""
    known = [points for points in seeds if points][:MOST_SEEDS]
    every = [(x, y) for curve in known for x, y in curve if math.isfinite(y)]
    points = np.array(every, np.float64).reshape(-1, 2)
    xs, at, counts = np.unique(points[:, 0], return_inverse=True, return_counts=True)
    low, high = np.full((2, len(xs)), [[np.inf], [-np.inf]])
    np.minimum.at(low, at, points[:, 1])
    np.maximum.at(high, at, points[:, 1])
    means = np.bincount(at, points[:, 1], len(xs)) / counts
    summary = np.stack([xs, means, low, high], axis=1)[counts == len(known)]
    return np.asarray(summary[thinned(range(len(summary)), MOST_DRAWN)])


def _scored(board: Board) -> dict[str, list[dict[str, Curve]]]:
    """Return the curves of RL by method: steps become all interactions, and true returns scores.

    Steps that check checkpoints are spread evenly over the others. Seeds without a scale have no true curve.
    """
    scales, spent = scales_of(board.rows), dict[str, list[float]]()
    for row in board.rows:
        if row.policy in ("pi_R", "expert") and row.status == "ok":
            steps, checks = spent.get(row.method, (0.0, 0.0))
            spent[row.method] = [steps + row.env_steps, checks + row.check_steps]
    curves: dict[str, list[dict[str, Curve]]] = {}
    for result in board.results:
        steps, checks = spent.get(result.cell.method, (0.0, 0.0))
        ratio = 1 + checks / steps if steps else 1.0
        mine = {n: [(ratio * x, y) for x, y in curve] for n, curve in result.curves.items() if n in OWN}
        low, scale = scales.get((result.cell.task, result.cell.seed), (math.nan, math.nan))
        true = [(x, (y - low) / scale) for x, y in mine.pop("pi_R_true", [])]
        curves.setdefault(result.cell.method, []).append(mine | ({"pi_R_true": true} if scale > 0 else {}))
    return curves


def _chosen(curves: Mapping[str, Curve]) -> tuple[float, float] | None:
    """Return the interactions until the checkpoint that counts, and its score."""
    marked, true = curves.get("pi_R_chosen"), dict(curves.get("pi_R_true", []))
    if not marked or not math.isfinite(true.get(marked[0][0], math.nan)):
        return None
    return marked[0][0], true[marked[0][0]]


def _data(board: Board, summaries: Summaries) -> pd.DataFrame:
    """Return a line for each point that is drawn."""
    lines = [(board.name, *key, *line) for key, summary in summaries.items() for line in summary.tolist()]
    return pd.DataFrame(lines, columns=["board", "method", "curve", "x", "mean", "low", "high"])
