"""Charts of methods over all runs and tasks: performance profiles, and the probability of improvement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harness.judge.comparisons import MOST_SEEDS, Runs, improvement, profile, runs_of
from harness.judge.leaderboard import is_rival
from harness.judge.results import Row
from harness.judge.statistics import interquartile_mean
from harness.show import svg
from harness.show.charts import NAMES, POLICIES, Chart
from harness.show.tables import Item, Table, interval

LEVELS = np.round([*np.arange(0.0, 0.79, 0.1), *np.arange(0.8, 1.11, 0.02)], 2)
"""Closer where scores of methods that work are."""
MOST_LINES = 7
"""Methods that are drawn, and compared with the best."""
MOST_COMPARED = 30
BOOTSTRAP = "Stratified bootstrap over seeds, each task by itself; seeds are taken as independent."


def charts(rows: Sequence[Row], without: Sequence[str]) -> list[Chart]:
    """Both, of the methods that have runs enough; none where no two have. rows: what is compared across environments."""
    found = {}
    for policy in POLICIES:
        every = runs_of(rows, policy, without)
        methods = sorted((m for m in every if is_rival(m)), key=lambda m: -_middle(every[m]))
        if len(methods) > 1:
            found[policy] = {method: every[method] for method in methods}
    return [_profiles(found), _improvements(found)] if found else []


def _middle(runs: Runs) -> float:
    return interquartile_mean([score for scores in runs.values() for score in scores])


def _profiles(found: dict[str, dict[str, Runs]]) -> Chart:
    """A plot for each policy; a line for each of the best methods, in a band."""
    plots, lines = [], list[list[Item]]()
    looks = {m: svg.look(i) for i, m in enumerate(dict.fromkeys(m for by in found.values() for m in [*by][:MOST_LINES]))}  # fmt: skip
    x = svg.Axis(0.0, 1.1, "score")
    for policy, methods in found.items():
        drawn = [*methods][:MOST_LINES]
        said = f"Share of the runs of {NAMES[policy]} above each score, for {', '.join(drawn)}."
        plot = svg.Plot(f"{NAMES[policy]}: share of runs above", said, x, svg.Axis(-0.02, 1.04))
        for method in drawn:
            share, low, high = profile(methods[method], LEVELS)
            look, dash, _ = looks[method]
            ends = [list(zip(LEVELS, end, strict=True)) for end in (low, high)]
            plot.band(*ends, look)
            plot.line(list(zip(LEVELS, share, strict=True)), look, dash=dash)
            lines += [
                [method, policy, f"{level:.2f}", interval(*values, "z.2f")]
                for level, *values in zip(LEVELS, share, low, high, strict=True)
            ]
        plots.append(plot.render())
    legend = [(svg.key("", look, dash, line=True), method) for method, (look, dash, _) in looks.items()]
    most = max(map(len, found.values()))
    left = f" Drawn are the best {MOST_LINES} by interquartile mean." if most > MOST_LINES else ""
    table = Table("profiles", ("Method", "Policy", "Score", "Share of runs above"), lines)
    note = f"The higher a line, the more runs score that much. Bands: 95 %. {BOOTSTRAP}{left}{_capped(found)}"
    return Chart("Performance profiles", plots, note, legend, table)


def _improvements(found: dict[str, dict[str, Runs]]) -> Chart:
    """A plot for each policy: how probably the best method is better than each other."""
    plots, lines = [], list[list[Item]]()
    for policy, methods in found.items():
        best, *others = [*methods][: MOST_COMPARED + 1]
        its = {other: improvement(methods[best], methods[other]) for other in others}
        told = "; ".join(f"{other} {value:.2f}" for other, (value, _, _) in its.items())
        title = f"{NAMES[policy]}: P({best} > …)"
        x = svg.Axis(-0.02, 1.02, "probability")
        plot = svg.Plot(
            title, f"Probability that {best} scores more, {NAMES[policy]}: {told}.", x, rows=others
        )
        plot.rule(x=0.5)
        shape, look = POLICIES[policy]
        for row, (other, (value, low, high)) in enumerate(its.items()):
            plot.span(low, high, row, look)
            plot.mark(value, row, shape, look, f"{best} better than {other}: {value:.2f} [{low:.2f}, {high:.2f}]")  # fmt: skip
            lines.append([other, policy, best, interval(value, low, high, "z.2f")])
        plots.append(plot.render())
    table = Table("improvement", ("Method", "Policy", "Better than it", "Probability [95 %]"), lines)
    note = (
        "The method with the best interquartile mean against each other one. An interval that holds 0.5 tells the two "
        f"not apart. {BOOTSTRAP}{_capped(found)}"
    )
    return Chart("Probability of improvement", plots, note, [], table)


def _capped(found: dict[str, dict[str, Runs]]) -> str:
    most = max(len(s) for methods in found.values() for runs in methods.values() for s in runs.values())
    return f" Of the first {MOST_SEEDS} seeds." if most == MOST_SEEDS else ""
