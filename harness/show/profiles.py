"""Charts of methods over all runs and tasks: performance profiles, and the probability of improvement."""

from __future__ import annotations

from collections.abc import Sequence

from harness.judge.comparisons import MOST_SEEDS, Runs, improvement, profile, runs_of
from harness.judge.results import Row
from harness.judge.roles import is_rival
from harness.judge.statistics import interquartile_mean
from harness.show import svg
from harness.show.charts import NAMES, POLICIES, Chart
from harness.show.tables import Item, Table, interval

LEVELS = [*(x / 10 for x in range(8)), *(x / 50 for x in range(40, 56))]
"""Closer where scores of methods that work are."""
MOST_LINES = 7
"""Methods that are drawn, and compared with the best."""
MOST_COMPARED = 30
BOOTSTRAP = "Stratified bootstrap over seeds, each task by itself; seeds are taken as independent."


def charts(rows: Sequence[Row], without: Sequence[str]) -> list[Chart]:
    """Both, of the methods that have runs enough; none where no two have. rows: of all environments but those
    `without`."""
    found: dict[str, dict[str, Runs]] = {}
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
    every = dict.fromkeys(m for methods in found.values() for m in [*methods][:MOST_LINES])
    looks = {method: svg.look(place) for place, method in enumerate(every)}
    x = svg.Axis(0.0, 1.1, "score")
    for policy, methods in found.items():
        drawn = [*methods][:MOST_LINES]
        said = f"Share of the runs of {NAMES[policy]} above each score, for {', '.join(drawn)}."
        plot = svg.Plot(f"{NAMES[policy]}: share of runs above", said, x, svg.Axis(-0.02, 1.04))
        for method in drawn:
            shares = profile(methods[method], LEVELS)
            look, dash, _ = looks[method]
            points = list(zip(LEVELS, shares.tolist(), strict=True))
            plot.band(
                [(x, low) for x, (_, low, _) in points], [(x, high) for x, (_, _, high) in points], look
            )
            plot.line([(x, share) for x, (share, _, _) in points], look, dash=dash)
            lines += [
                [method, policy, f"{x:.2f}", interval(share, low, high, "z.2f")]
                for x, (share, low, high) in points
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
        said = "; ".join(f"{other} {value:.2f}" for other, (value, _, _) in its.items())
        title = f"{NAMES[policy]}: P({best} > …)"
        x = svg.Axis(-0.02, 1.02, "probability")
        plot = svg.Plot(
            title, f"Probability that {best} scores more, {NAMES[policy]}: {said}.", x, rows=others
        )
        plot.rule(x=0.5)
        shape, look = POLICIES[policy]
        for row, (other, (value, low, high)) in enumerate(its.items()):
            plot.span(low, high, row, look)
            told = interval(value, low, high, "z.2f")
            plot.mark(value, row, shape, look, f"{best} better than {other}: {told}")
            lines.append([other, policy, best, told])
        plots.append(plot.render())
    table = Table("improvement", ("Method", "Policy", "Better than it", "Probability [95 %]"), lines)
    note = (
        "The method with the best interquartile mean against each other. An interval that holds 0.5 tells "
        f"the two not apart. {BOOTSTRAP}{_capped(found)}"
    )
    return Chart("Probability of improvement", plots, note, [], table)


def _capped(found: dict[str, dict[str, Runs]]) -> str:
    most = max(len(s) for methods in found.values() for runs in methods.values() for s in runs.values())
    return f" Of the first {MOST_SEEDS} seeds." if most == MOST_SEEDS else ""
