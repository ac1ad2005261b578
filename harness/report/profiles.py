"""Charts of methods over all runs and tasks: performance profiles, and the probability of improvement."""

from __future__ import annotations

from collections.abc import Sequence

from harness.judge.comparisons import MOST_SEEDS, Runs, improvement, profile, runs_of
from harness.judge.roles import is_rival
from harness.judge.statistics import interquartile_mean
from harness.records import Row
from harness.report.charts import LOOKS
from harness.report.columns import METHOD, NAMES, POLICY
from harness.report.figures import Chart, Plot, look, rules, sign, spans
from harness.report.tables import Column, Table, interval, number

LEVELS = [*(x / 10 for x in range(8)), *(x / 50 for x in range(40, 56))]
"""Scores at which profiles are computed, closer to each other where most methods score."""
MOST_LINES = 7
"""Methods that are drawn."""
MOST_COMPARED = 30
"""Methods that are compared with the best."""
BOOTSTRAP = "Stratified bootstrap over seeds, each task by itself; seeds are taken as independent."


SHARES = (
    METHOD.at(0),
    POLICY.at(1),
    Column("level", "Score", "Normalized score, as in the leaderboard.", str).at(2),
    Column("runs_above", "Share of runs above", "The runs that score more.", str, "interval").at(3),
)
IMPROVEMENTS = (
    METHOD.at(0),
    POLICY.at(1),
    Column("better", "Better than it", "The method with the best mean score.", str, "text").at(2),
    Column(
        "probability",
        "Probability",
        "Probability that a run of the best method scores more than one of this method, in a task drawn at "
        "random; equal scores count half (stratified bootstrap).",
        str,
        "interval",
    ).at(3),
)


def charts(rows: Sequence[Row], without: Sequence[str]) -> list[Chart]:
    """Return both charts of the methods that have enough runs; none where no two have.

    rows: of all environments but those `without`.
    """
    runs: dict[str, dict[str, Runs]] = {}
    for policy in LOOKS:
        every = runs_of(rows, policy, without)
        methods = sorted((m for m in every if is_rival(m)), key=lambda m: -_middle(every[m]))
        if len(methods) > 1:
            runs[policy] = {method: every[method] for method in methods}
    if not runs:
        return []
    most = max(len(s) for methods in runs.values() for one in methods.values() for s in one.values())
    note = BOOTSTRAP + f" Of the first {MOST_SEEDS} seeds." * (most == MOST_SEEDS)
    return [_profiles(runs, note), _improvements(runs, note)]


def _middle(runs: Runs) -> float:
    return interquartile_mean([score for scores in runs.values() for score in scores])


def _profiles(runs: dict[str, dict[str, Runs]], note: str) -> Chart:
    """Return a plot for each policy; a line in a band for each of the best methods."""
    drawn = list(dict.fromkeys(m for methods in runs.values() for m in list(methods)[:MOST_LINES]))
    plots, lines = [], []
    for policy, methods in runs.items():
        best = list(methods)[:MOST_LINES]
        said = f"Share of the runs of {NAMES[policy]} above each score, for {', '.join(best)}."
        plot = Plot(said, f"{NAMES[policy]}: share of runs above", "score")
        plot.axes.set(xlim=(0.0, 1.1), ylim=(-0.02, 1.04))
        for method in best:
            ends = profile(methods[method], LEVELS)
            shares, low, high = ends.T
            colour, style, marker = look(drawn.index(method))
            plot.axes.fill_between(LEVELS, low, high, color=colour, alpha=0.14, linewidth=0)
            (line,) = plot.axes.plot(LEVELS, shares, color=colour, linestyle=style, marker=marker)
            line.set(markevery=4, markersize=5)
            shown = [
                (number(x, ".2f"), interval(*mine)) for x, mine in zip(LEVELS, ends.tolist(), strict=True)
            ]
            lines += [(method, NAMES[policy], *values) for values in shown]
        plots.append(plot.svg())
    left = f" The best {MOST_LINES} by interquartile mean." * (max(map(len, runs.values())) > MOST_LINES)
    reads = f"The higher a line, the more runs score that much. Bands: 95 %. {note}{left}"
    legend = [sign(at, method) for at, method in enumerate(drawn)]
    return Chart("Performance profiles", plots, reads, legend, Table("profiles", SHARES, lines))


def _improvements(runs: dict[str, dict[str, Runs]], note: str) -> Chart:
    """Return a plot for each policy: the probability that the best method is better than each other."""
    plots, lines = [], []
    for policy, methods in runs.items():
        best, *others = list(methods)[: MOST_COMPARED + 1]
        mine = [interval(*improvement(methods[best], methods[other])) for other in others]
        texts = "; ".join(f"{other} {value.number:.2f}" for other, value in zip(others, mine, strict=True))
        said = f"Probability that {best} scores more, {NAMES[policy]}: {texts}."
        plot = Plot(said, f"{NAMES[policy]}: P({best} > …)", "probability", others)
        plot.axes.set_xlim(-0.02, 1.02)
        rules(plot.axes, True, 0.5)
        colour, marker = LOOKS[policy]
        spans(plot.axes, [((value.low, row), (value.high, row)) for row, value in enumerate(mine)], colour)
        tips = [f"{best} better than {other}: {value}" for other, value in zip(others, mine, strict=True)]
        plot.points([(value.number, row) for row, value in enumerate(mine)], colour, marker, tips)
        plots.append(plot.svg())
        lines += [(other, NAMES[policy], best, value) for other, value in zip(others, mine, strict=True)]
    reads = "The method with the best interquartile mean against each other. "
    reads += f"An interval that holds 0.5 is no significant difference. {note}"
    table = Table("improvement", IMPROVEMENTS, lines)
    return Chart("Probability of improvement", plots, reads, [], table)
