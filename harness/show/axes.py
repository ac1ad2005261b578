"""Figures over what is shown and over dynamics: what more demonstrations are worth, and what is left of what
was learned where a task's dynamics change."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.results import CONTROLS, NOMINAL, REFERENCE, Shown
from harness.show.figures import POLICIES, RED, Picture, file_of, picture, styled

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Told apart by the colour-blind too."""
STYLES = ("-", "--", ":", "-.")
MARKERS = ("o", "D", "s", "^", "v", "P", "X")
MOST_VARIANTS = 12
MOST_LINES = 56
"""Of a figure: more leave its legend no room for it."""


def draw_axes(env: str, entries: Sequence[Entry], flag: str = "") -> list[Picture]:
    """The figures of one env, from all its lines, that have something to show. flag: what is said above
    each."""
    with styled():
        return [*_over_demonstrations(env, entries, flag), *_over_dynamics(env, entries, flag)]


def _over_demonstrations(env: str, entries: Sequence[Entry], flag: str) -> list[Picture]:
    """A panel for pi_star and one for pi_R, where there are any; a line for each method and each other way to
    show."""
    mine = [
        e
        for e in entries
        if e.dynamics == NOMINAL and e.demos and e.method not in (REFERENCE, *CONTROLS) and e.seeds_ok
    ]
    ways = sorted({_way(e) for e in mine})
    every = [(method, way) for method in dict.fromkeys(e.method for e in mine) for way in ways]
    lines = every[:MOST_LINES]
    counts = sorted({e.demos for e in mine})
    if len(counts) < 2:
        return []
    policies = [policy for policy in ("pi_star", "pi_R") if any(e.policy == policy for e in mine)]
    scored: dict[object, list[Entry]] = {}
    for e in mine:
        if math.isfinite(e.score_mean):
            scored.setdefault((e.method, _way(e), e.policy), []).append(e)
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    shared: Axes | None = None
    for place, policy in enumerate(policies):
        axes = figure.add_subplot(1, len(policies), place + 1, sharey=shared)
        shared = shared or axes
        for number, (method, way) in enumerate(lines):
            known = scored.get((method, way, policy), [])
            colour, marker = look(list(dict.fromkeys(m for m, _ in lines)).index(method))
            axes.errorbar(
                [e.demos * (1 + 0.02 * (number - len(lines) / 2)) for e in known],
                [e.score_mean for e in known],
                [_below(known), _above(known)],
                color=colour,
                linestyle=STYLES[ways.index(way) % len(STYLES)],
                marker=marker,
                markersize=4,
                linewidth=1.2,
                label=f"{method}, {way}" if str(way) else method,
            )
        for level in (0.0, 1.0):
            axes.axhline(level, color="#888888", linewidth=1, linestyle="--", zorder=0)
        axes.set_xscale("log")
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.minorticks_off()
        axes.set_xlabel("demonstrations")
        axes.set_title(POLICIES[policy][0])
    assert shared is not None
    shared.set_ylim(*_around([e.score_mean for e in mine]))
    shared.set_ylabel("normalized score, 95 % intervals")
    figure.legend(*shared.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    if flag:
        figure.suptitle(flag, color=RED)
    told = "; ".join(f"{e.method} {e.policy} with {e.demos}: {as_text(e.score_mean, '.2f')}" for e in mine)
    title = f"{env}: scores against demonstrations"
    if len(every) > len(lines):
        title += f" (the first {len(lines)} of {len(every)} lines)"
    return [picture(f"{file_of(env)}_demonstrations.png", title, f"{title}. {told}.", figure)]


def look(number: int) -> tuple[str, str]:
    """Colour and marker of a method; those that share a colour have other markers."""
    return COLOURS[number % len(COLOURS)], MARKERS[(number + number // len(COLOURS)) % len(MARKERS)]


def _over_dynamics(env: str, entries: Sequence[Entry], flag: str) -> list[Picture]:
    """A panel for each variant, of what is shown first: policies carried over, those trained there on R*, and
    the expert carried over."""
    mine = [e for e in entries if e.dynamics != NOMINAL]
    if all(e.method == REFERENCE for e in mine):
        return []
    first = min(e.shown for e in mine)
    mine = [e for e in mine if e.shown == first]
    variants = list(dict.fromkeys(e.dynamics for e in mine))[:MOST_VARIANTS]
    methods = list(dict.fromkeys(e.method for e in mine if e.method != REFERENCE))
    size = max(6.8, 2 + 2.4 * len(variants)), 1.4 + 0.36 * len(methods)
    figure = Figure(figsize=size, layout="constrained")
    shared: Axes | None = None
    told = []
    for place, variant in enumerate(variants):
        axes = figure.add_subplot(1, len(variants), place + 1, sharey=shared)
        for row, method in enumerate(methods):
            if method in CONTROLS:
                axes.axhspan(row - 0.5, row + 0.5, color="#eeeeee", linewidth=0, zorder=-1)
        for entry in (e for e in mine if e.dynamics == variant and math.isfinite(e.score_mean)):
            told.append(f"{variant}: {entry.method} {entry.policy} {as_text(entry.score_mean, '.2f')}")
            if entry.policy == "expert":
                axes.axvline(entry.score_mean, color="#009e73", linewidth=1.2, linestyle=":")
            if entry.method == REFERENCE:
                continue
            _, colour, marker = POLICIES[entry.policy]
            y = methods.index(entry.method) + (-0.15 if entry.policy == "pi_star" else 0.15)
            if math.isfinite(entry.score_low):
                axes.plot([entry.score_low, entry.score_high], [y, y], color=colour, linewidth=1.5)
            axes.scatter(entry.score_mean, y, s=26, color=colour, marker=marker, edgecolors="white", zorder=3)
        for level in (0.0, 1.0):
            axes.axvline(level, color="#888888", linewidth=1, linestyle="--", zorder=0)
        axes.set_xlim(*_around([e.score_mean for e in mine if e.dynamics == variant]))
        axes.set_title(variant, parse_math=False)
        if shared is None:
            axes.set_yticks(range(len(methods)), methods, parse_math=False)
            axes.set_ylim(len(methods) - 0.5, -0.5)
        else:
            axes.tick_params(axis="y", labelleft=False)
        shared = shared or axes
    figure.supxlabel(
        "score: 0 random there, 1 RL on the true reward there; dotted: the expert carried over", fontsize=9
    )
    for name, (_, colour, marker) in POLICIES.items():
        label = r"$\pi^*$ carried over" if name == "pi_star" else r"$\pi_R$, trained there on R*"
        assert shared is not None
        shared.scatter([], [], s=26, color=colour, marker=marker, label=label)
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    if flag:
        figure.suptitle(flag, color=RED)
    title = f"{env}: what was learned, in other dynamics"
    return [picture(f"{file_of(env)}_transfer.png", title, f"{title}. {'; '.join(told)}.", figure)]


def _way(entry: Entry) -> Shown:
    """How it was shown, but for how many."""
    return Shown(0, entry.every, entry.demonstrator)


def _around(scores: Sequence[float]) -> tuple[float, float]:
    """Limits of an axis that shows these scores, 0 and 1; intervals may leave it."""
    known = [score for score in scores if math.isfinite(score)]
    low, high = min([0.0, *known]), max([1.0, *known])
    return low - 0.1 * (high - low), high + 0.1 * (high - low)


def _below(entries: Sequence[Entry]) -> list[float]:
    return [max(0.0, e.score_mean - e.score_low) if math.isfinite(e.score_low) else 0.0 for e in entries]


def _above(entries: Sequence[Entry]) -> list[float]:
    return [max(0.0, e.score_high - e.score_mean) if math.isfinite(e.score_high) else 0.0 for e in entries]
