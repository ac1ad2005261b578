"""Charts of boards: scores seed by seed, against cost, reward distance, and demonstrations."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd
from markupsafe import Markup

from harness.judge.comparisons import front
from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.results import CONTROLS, NOMINAL, REFERENCE, Shown
from harness.show import svg
from harness.show.boards import Board
from harness.show.tables import Item, Table, number, score

MOST_LINES = 14
"""Methods of a figure of lines; its table has all."""
MOST_DOTS = 50
"""Seeds whose own dots are drawn; means are of all."""
POLICIES = {"pi_star": ("disc", "c0"), "pi_R": ("diamond", "c1")}
"""Marker and colour."""
NAMES = {"pi_star": "π*", "pi_R": "π_R"}
COSTS = {
    "fit_seconds": "seconds",
    "env_steps": "environment steps",
    "rl_solves": "RL solves",
}
Sign = tuple[Markup, str]
"""Of a legend, and what it stands for."""


@dataclass(frozen=True)
class Chart:
    """Plots that belong together. note: how to read them. table: what is drawn; or data, too much for a
    table, and the name of its file."""

    title: str
    plots: list[Markup]
    note: str = ""
    legend: list[Sign] = field(default_factory=list)
    table: Table | None = None
    name: str = ""
    data: pd.DataFrame | None = None


def policy_signs(star: str = "π*", trained: str = "π_R, RL on R*") -> list[Sign]:
    texts = {"pi_star": star, "pi_R": trained}
    return [(svg.key(*POLICIES[policy]), text) for policy, text in texts.items()]


def scores(board: Board) -> Chart | None:
    """Every seed's score, means and intervals, a row for each method. In a variant the expert that is carried
    over is a line."""
    mine = [e for e in board.entries if e.method != REFERENCE]
    if not any(math.isfinite(e.score_mean) for e in mine):
        return None
    methods = list(dict.fromkeys(e.method for e in mine))
    dots: dict[tuple[str, str], list[float]] = {}
    for row in board.rows:
        if math.isfinite(row.normalized_score):
            dots.setdefault((row.method, row.policy), []).append(row.normalized_score)
    shown = [v for (method, _), its in dots.items() if method != REFERENCE for v in its]
    x = svg.around(shown, "normalized score", least=(0.0, 1.0))
    told = "; ".join(f"{e.method} {NAMES[e.policy]} {score(e)}" for e in mine if math.isfinite(e.score_mean))
    plot = svg.Plot("", f"Normalized scores in {board.name}: {told}.", x, rows=methods)
    plot.rule(x=0.0)
    plot.rule(x=1.0)
    for entry in board.entries:
        if entry.policy == "expert" and not board.is_nominal and math.isfinite(entry.score_mean):
            plot.rule(x=entry.score_mean, dash="1 3", look="c2")
    place = {method: row for row, method in enumerate(methods)}
    for method in [method for method in place if method in CONTROLS]:
        plot.shade(place[method])
    lines: list[list[Item]] = []
    known = Counter(e.method for e in mine if math.isfinite(e.score_mean))
    for entry in mine:
        shape, look = POLICIES[entry.policy]
        alone = known[entry.method] == 1
        y = place[entry.method] + (0.0 if alone else -0.2 if entry.policy == "pi_star" else 0.2)
        lines.append([entry.method, entry.policy, score(entry)])
        if math.isfinite(entry.score_mean):
            plot.dots([(value, y) for value in dots[entry.method, entry.policy][:MOST_DOTS]], look)
            plot.span(entry.score_low, entry.score_high, y, look)
            plot.mark(
                entry.score_mean, y, shape, look, f"{entry.method} {NAMES[entry.policy]}: {score(entry)}"
            )
    table = Table(f"scores {board.name}", ("Method", "Policy", "Score [95 %]"), lines)
    return Chart(board.name, [plot.render()], table=table)


def costs(board: Board) -> Chart | None:
    """Scores against what policies cost, and the Pareto front. Of pi_R that is the fit and RL together."""
    mine = [e for e in board.entries if e.role == "method" and math.isfinite(e.score_mean)]
    stars = {e.method: e for e in board.entries if e.policy == "pi_star"}
    plots, lines = [], list[list[Item]]()
    for key, unit in COSTS.items():
        points = []
        for entry in mine:
            cost = getattr(entry, key)
            if entry.policy == "pi_R":
                cost += getattr(stars[entry.method], key) if entry.method in stars else math.nan
            if math.isfinite(cost):
                points.append((cost, entry))
        if not any(cost > 0 for cost, _ in points):
            continue
        at = [(cost, entry.score_mean) for cost, entry in points]
        best = front(at)
        y = svg.around([s for _, s in at], "", least=(0.0, 1.0))
        said = ", ".join(
            f"{points[i][1].method} {NAMES[points[i][1].policy]} {as_text(at[i][1], '.2f')}" for i in best
        )
        x = svg.decades([cost for cost, _ in at], f"{unit} (log)")
        plot = svg.Plot(f"score against {unit}", f"Scores against {unit}. On the Pareto front: {said}.", x, y)
        plot.rule(y=1.0)
        plot.rule(y=0.0)
        plot.line([*(at[i] for i in best), (x.high, at[best[-1]][1])], "cg", steps=True)
        for cost, value in at:
            plot.taken(cost, value)
        for place, (cost, entry) in enumerate(points):
            told = number(cost, ",.0f" if cost >= 10 else ".2g")
            tip = f"{entry.method} {NAMES[entry.policy]}: {score(entry)}, {told} {unit}"
            plot.mark(cost, entry.score_mean, *POLICIES[entry.policy], tip)
            lines.append(
                [entry.method, entry.policy, unit, told, score(entry), "yes" if place in best else ""]
            )
        for i in best:
            plot.name(*at[i], points[i][1].method)
        plots.append(plot.render())
    if not plots:
        return None
    headings = ("Method", "Policy", "Unit", "Cost", "Score [95 %]", "On the front")
    return Chart(board.name, plots, table=Table(f"cost {board.name}", headings, lines))


def distances(board: Board) -> Chart | None:
    """What pi_R made of rewards, against their distances from the true one."""
    known = [
        e
        for e in board.entries
        if e.policy == "pi_R" and math.isfinite(e.score_mean) and math.isfinite(e.reward_distance)
    ]
    if len(known) < 2:
        return None
    y = svg.around([e.score_mean for e in known], "", least=(0.0, 1.0))
    x = svg.Axis(-0.03, 1.03, "distance of R* from the true reward")
    told = "; ".join(f"{e.method} {e.reward_distance:.2f}, {as_text(e.score_mean, '.2f')}" for e in known)
    plot = svg.Plot("score of π_R", f"Distances of rewards and scores of π_R in {board.name}: {told}.", x, y)
    plot.rule(y=1.0)
    plot.rule(y=0.0)
    for entry in known:
        plot.taken(entry.reward_distance, entry.score_mean)
    lines: list[list[Item]] = []
    for entry in known:
        shape, look = ("square", "cg") if entry.method in CONTROLS else POLICIES["pi_R"]
        plot.upright(entry.reward_distance, entry.score_low, entry.score_high, look)
        tip = f"{entry.method}: distance {entry.reward_distance:.2f}, score {score(entry)}"
        plot.mark(entry.reward_distance, entry.score_mean, shape, look, tip)
        floor, far = number(entry.reward_floor, "z.2f"), number(entry.reward_distance, "z.2f")
        lines.append([entry.method, far, floor, number(entry.reward_rank, "z.2f"), score(entry)])
    for entry in known:
        plot.name(entry.reward_distance, entry.score_mean, entry.method.removeprefix("control_"))
    headings = ("Method", "Distance", "Floor", "Reward: rank", "Score [95 %]")
    return Chart(board.name, [plot.render()], table=Table(f"distances {board.name}", headings, lines))


def demonstrations(env: str, entries: Sequence[Entry]) -> Chart | None:
    """Of one env's lines, scores against demonstrations: a plot for each policy, a line for each method."""
    mine = [
        e
        for e in entries
        if e.dynamics == NOMINAL and e.demos and e.seeds_ok
        if e.method not in (REFERENCE, *CONTROLS) and math.isfinite(e.score_mean)
    ]  # fmt: skip
    counts = sorted({e.demos for e in mine})
    if len(counts) < 2:
        return None
    kinds = list(dict.fromkeys((e.method, _way(e)) for e in mine))
    drawn = kinds[:MOST_LINES]
    x = svg.Axis(0.8 * counts[0], 1.25 * counts[-1], "demonstrations (log)", log=True)
    y = svg.around([e.score_mean for e in mine], "", least=(0.0, 1.0))
    plots = []
    for policy in ("pi_star", "pi_R"):
        its = [e for e in mine if e.policy == policy]
        if not its:
            continue
        told = "; ".join(f"{e.method} with {e.demos}: {as_text(e.score_mean, '.2f')}" for e in its)
        plot = svg.Plot(
            f"{NAMES[policy]}: score", f"Scores of {NAMES[policy]} by demonstrations: {told}.", x, y
        )
        plot.rule(y=1.0)
        plot.rule(y=0.0)
        for place, (method, way) in enumerate(drawn):
            look, dash, shape = svg.look(place)
            line = [e for e in its if (e.method, _way(e)) == (method, way)]
            plot.line([(e.demos, e.score_mean) for e in line], look, dash=dash)
            for e in line:
                plot.upright(e.demos, e.score_low, e.score_high, look)
                plot.mark(
                    e.demos, e.score_mean, shape, look, f"{method}, {e.demos} demonstrations: {score(e)}"
                )
        plots.append(plot.render())
    legend = []
    for place, (method, way) in enumerate(drawn):
        look, dash, shape = svg.look(place)
        legend.append(
            (svg.key(shape, look, dash, line=True), f"{method}, {way}" if str(way) else method),
        )
    lines: list[list[Item]] = [
        [e.method, e.policy, str(e.shown), number(e.demos, ".0f"), score(e)] for e in mine
    ]
    left = (
        f" Drawn are the first {len(drawn)} of {len(kinds)} lines; the table has all."
        if kinds[MOST_LINES:]
        else ""
    )
    headings = ("Method", "Policy", "Demonstrations", "Episodes", "Score [95 %]")
    return Chart(
        env,
        plots,
        f"Bars: 95 % intervals.{left}",
        legend,
        Table(f"demonstrations {env}", headings, lines),
    )


def _way(entry: Entry) -> Shown:
    """How it was shown, but for how many."""
    return Shown(0, entry.every, entry.demonstrator)
