"""Charts of what happened over time: RL on R*, as in the thesis's figure 5.3, and methods' own training."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from harness.judge.numbers import as_text
from harness.judge.results import REFERENCE, CellResult, Curve, thinned
from harness.show import svg
from harness.show.boards import Board
from harness.show.charts import Chart, Sign

MOST_PANELS = 60
"""Of a board."""
MOST_DRAWN = 40
"""Points of a line."""
MOST_SEEDS = 50
"""Whose curves are drawn, and counted in means and ranges."""
OWN = ("pi_R", "pi_R_true", "pi_R_chosen", "expert")
SIGNS: list[Sign] = [
    (svg.key("", "c1", line=True), "true return of RL on R*, with the range over seeds"),
    (svg.key("ring", "c1"), "the checkpoint that counts, a ring a seed"),
    (svg.key("", "c3", "2 2", line=True), "return under R* itself (axis on the right)"),
    (svg.key("", "c0", "6 3", line=True), "RL on the true reward"),
    (svg.key("", "c2", "1 3", line=True), "level of π*"),
]


def learning(board: Board, most: int = MOST_PANELS) -> Chart | None:
    """A plot for each method that was retrained, `most` at most."""
    by_method: dict[str, list[CellResult]] = {}
    for result in board.results:
        by_method.setdefault(result.cell.method, []).append(result)
    methods = [
        method
        for method in dict.fromkeys(e.method for e in board.entries)
        if any(result.curves.get("pi_R") for result in by_method.get(method, ()))
    ]
    means = {
        (method, name): summary
        for method in dict.fromkeys([REFERENCE, "control_true", *methods[:most]])
        for name in ("expert", "pi_R", "pi_R_true")
        if len(summary := _summary([r.curves.get(name, []) for r in by_method.get(method, ())]))
    }
    truth = means.get(("control_true", "pi_R_true"))
    stars = {e.method: e.return_mean for e in board.entries if e.policy == "pi_star"}
    low, high = [], []
    for (_, name), summary in means.items():
        if name == "pi_R_true":
            low.append(summary["low"].min())
            high.append(summary["high"].max())
    if not low:
        return None
    y = svg.around([*low, *high, *stars.values()], "")
    longest = max(its.index.max() for (_, name), its in means.items() if name != "expert")
    x = svg.Axis(0, max(1.0, longest), "environment steps")
    plots = []
    for method in methods[:most]:
        own, true = means.get((method, "pi_R")), means.get((method, "pi_R_true"))
        if own is None:
            continue
        said = f"RL on the reward of {method} in {board.name}: true return and return under R* by steps."
        plot = svg.Plot(method, said, x, y, second=svg.around([*own["mean"]], ""))
        if truth is not None and method != "control_true":
            plot.line(_points(truth), "c0", dash="6 3")
        if math.isfinite(stars.get(method, math.nan)):
            plot.rule(y=stars[method], dash="1 3", look="c2")
        plot.line(_points(own), "c3", dash="2 2", second=True)
        if true is not None:
            if by_method[method][1:]:
                plot.band(_points(true, "low"), _points(true, "high"), "c1")
            plot.line(_points(true), "c1")
            for chosen in filter(None, map(_chosen, by_method[method][:MOST_SEEDS])):
                plot.mark(
                    *chosen, "ring", "c1", f"steps {chosen[0]:,.0f}: true return {as_text(chosen[1], '.1f')}"
                )
        plots.append(plot.render())
    data = _data(board.name, means)
    return Chart(board.name, plots, _left_out(board, methods, most), name=f"learning {board.name}", data=data)


def training(board: Board, most: int = MOST_PANELS) -> Chart | None:
    """A plot for each curve that a method tells of its own fit."""
    curves: dict[tuple[str, str], list[Curve]] = {}
    for result in board.results:
        for name, points in result.curves.items():
            if name not in OWN:
                curves.setdefault((result.cell.method, name), []).append(points)
    rank = {method: place for place, method in enumerate(dict.fromkeys(e.method for e in board.entries))}
    known = [key for key, its in curves.items() if any(its) and key[0] in rank]
    known.sort(key=lambda key: rank[key[0]])
    summaries = {key: its for key in known[:most] if len(its := _summary(curves[key]))}
    plots = []
    for key, its in summaries.items():
        x = svg.Axis(its.index.min(), max(its.index.min() + 1.0, its.index.max()), "iteration")
        y = svg.around([*its["low"], *its["high"]], "")
        plot = svg.Plot(": ".join(key), f"Training of {key[0]} in {board.name}: {key[1]}.", x, y)
        plot.band(_points(its, "low"), _points(its, "high"), "c0")
        plot.line(_points(its), "c0")
        plots.append(plot.render())
    if not plots:
        return None
    data = _data(board.name, summaries)
    return Chart(board.name, plots, _left_out(board, known, most), name=f"training {board.name}", data=data)


def _left_out(board: Board, panels: Sequence[object], most: int) -> str:
    """What is not drawn."""
    seeds = len({result.cell.seed for result in board.results})
    of_seeds = [f"Curves are of the first {MOST_SEEDS} of {seeds} seeds."] if seeds > MOST_SEEDS else []
    of_panels = [f"The first {most} of {len(panels)} panels."] if panels[most:] else []
    return " ".join([*of_panels, *of_seeds])


def _summary(seeds: Sequence[Curve]) -> pd.DataFrame:
    """By x, where all seeds that have the curve have a point: the mean, the lowest and the highest y; of
    `MOST_DRAWN` at most."""
    there = [points for points in seeds if points][:MOST_SEEDS]
    points = [(x, y) for its in there for x, y in its if math.isfinite(y)]
    frame = pd.DataFrame(points, columns=["x", "y"]).groupby("x")["y"].agg(["mean", "min", "max", "count"])
    frame = frame[frame["count"] == len(there)].rename(columns={"min": "low", "max": "high"})
    return frame.loc[thinned(list(frame.index), MOST_DRAWN), ["mean", "low", "high"]]


def _points(summary: pd.DataFrame, column: str = "mean") -> list[svg.Point]:
    return list(zip(summary.index, summary[column], strict=True))


def _chosen(result: CellResult) -> svg.Point | None:
    """The steps of the checkpoint that counts, and its true return."""
    marked, true = result.curves.get("pi_R_chosen"), dict(result.curves.get("pi_R_true", []))
    if not marked or not math.isfinite(true.get(marked[0][0], math.nan)):
        return None
    return marked[0][0], true[marked[0][0]]


def _data(board: str, summaries: dict[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """A line for each point that is drawn."""
    frames = [
        its.rename_axis("x").reset_index().assign(board=board, method=method, curve=name)
        for (method, name), its in summaries.items()
    ]
    return pd.concat(frames)[["board", "method", "curve", "x", "mean", "low", "high"]]
