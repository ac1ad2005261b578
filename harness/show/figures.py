"""The figures of a report, as PNGs: equal results give equal bytes."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.results import CONTROLS, NOMINAL, REFERENCE, Row
from harness.show.boards import Board
from harness.show.facts import NO_RESULT

RED = "#b00020"
BLUE, ORANGE = "#0072b2", "#d55e00"
"""Told apart by the colour-blind too."""
POLICIES = {
    "pi_star": (r"$\pi^*$ (the apprentice)", BLUE, "o"),
    "pi_R": (r"$\pi_R$ (RL on R*)", ORANGE, "D"),
}
"""Label, colour and marker."""
MOST_SEEDS = 100
"""Seeds whose own lines and dots are drawn; means are of all."""
LONGEST_ALT = 20_000
"""Characters of what is said of a figure in words."""
_STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "font.size": 9,
}


@dataclass(frozen=True)
class Picture:
    """A figure: its file name, what it says in words, the PNG itself and its size on a page in pixels."""

    file: str
    title: str
    alt: str
    png: bytes
    width: int
    height: int


@contextmanager
def styled() -> Iterator[None]:
    """Within it, figures look alike, whatever the user's own settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def draw_scores(board: Board) -> Picture | None:
    """A point a seed, a diamond or disc at the mean, a bar for its interval; controls on grey. None where
    there is only the reference."""
    if all(entry.method == REFERENCE for entry in board.entries):
        return None
    with styled():
        return _scores(board.name, board.entries, board.rows, board.flag)


def _scores(env: str, entries: Sequence[Entry], rows: Sequence[Row], flag: str) -> Picture:
    methods = list(dict.fromkeys(entry.method for entry in entries if entry.method != REFERENCE))
    figure = Figure(figsize=(8, 1.4 + 0.48 * len(methods)), layout="constrained")
    axes = figure.add_subplot()
    top = _top(entries)
    for value, name in ((0.0, "random"), (1.0, top)):
        axes.axvline(value, color="#888888", linewidth=1, linestyle="--", zorder=0)
        axes.text(value, 1.01, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom")
    told = []
    dots: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        dots.setdefault((row.method, row.policy), []).append(row.normalized_score)
    drawn: dict[str, list[tuple[float, Entry]]] = {}
    for place, method in enumerate(methods):
        ground = "#eeeeee" if method in CONTROLS else "white"
        axes.axhspan(place - 0.5, place + 0.5, color=ground, linewidth=0, zorder=-1)
        mine = [entry for entry in entries if entry.method == method]
        words = []
        for entry in mine:
            y = place + (0.0 if len(mine) == 1 else -0.22 if entry.policy == "pi_star" else 0.18)
            if not math.isfinite(entry.score_mean):
                text = f"{entry.policy} {_why(entry)}"
                box = {"facecolor": ground, "linewidth": 0, "pad": 1}
                style: dict[str, Any] = {"va": "center", "fontsize": 8, "parse_math": False, "bbox": box}
                style["color"] = POLICIES[entry.policy][1]
                axes.text(0.02, y, text, transform=axes.get_yaxis_transform(), **style)
                words.append(f"{entry.policy} n/a")
                continue
            drawn.setdefault(entry.policy, []).append((y, entry))
            words.append(f"{entry.policy} {as_text(entry.score_mean, '.2f')}")
        told.append(f"{method} {', '.join(words)}")
    for policy, its in drawn.items():
        _, colour, marker = POLICIES[policy]
        small = [(x, y + 0.17) for y, e in its for x in dots[e.method, policy][:MOST_SEEDS]]
        bars = [((e.score_low, y), (e.score_high, y)) for y, e in its if math.isfinite(e.score_low)]
        axes.scatter(
            [x for x, _ in small], [y for _, y in small], s=14, color=colour, alpha=0.5, linewidths=0
        )
        axes.add_collection(LineCollection(bars, colors=colour, linewidths=2, zorder=3))
        means, places = [e.score_mean for _, e in its], [y for y, _ in its]
        axes.scatter(means, places, s=38, color=colour, marker=marker, edgecolors="white", zorder=4)
    axes.set_yticks(range(len(methods)), methods, parse_math=False)
    axes.set_ylim(len(methods) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    seeds = f"the first {MOST_SEEDS} seeds" if max(map(len, dots.values())) > MOST_SEEDS else "seeds"
    axes.set_xlabel(f"normalized score (small dots: {seeds}; markers: means; bars: 95 % intervals)")
    if flag:
        axes.set_title(f"{NO_RESULT}: {flag}", color=RED, pad=18)
    for label, colour, marker in POLICIES.values():
        axes.scatter([], [], s=38, color=colour, marker=marker, label=label)
    figure.legend(loc="outside upper right", ncols=2, frameon=False)
    # Of two or three seeds an interval may be many times as wide as all scores.
    shown = [row.normalized_score for row in rows if math.isfinite(row.normalized_score)]
    shown += [entry.score_mean for entry in entries if math.isfinite(entry.score_mean)]
    low, high = min([0.0, *shown]), max([1.0, *shown])
    axes.set_xlim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    alt = f"Mean normalized scores in {env} (0 random, 1 {_top(entries)}): {'; '.join(told)}."
    return picture(f"{file_of(env)}_scores.png", f"{env}: normalized scores", alt, figure)


def _top(entries: Sequence[Entry]) -> str:
    """What scores 1."""
    if entries[0].dynamics != NOMINAL:
        return "RL on the true reward"
    return "demonstrations" if "demonstrations" in {entry.policy for entry in entries} else "expert"


def file_of(board: str) -> str:
    """How the names of a board's figures begin."""
    return re.sub(r"\W+", "_", board)


def _why(entry: Entry) -> str:
    """Why there is no score, in a line."""
    text = " ".join(entry.note.split()) or "no score: what would score 1 is missing, or no better than random"
    return text if len(text) <= 70 else text[:69] + "…"


def plot_seeds(axes: Axes, seeds: Sequence[Sequence[tuple[float, float]]], colour: str) -> None:
    """A thin line a seed, up to `MOST_SEEDS`, a thick one for their mean where all have a point."""
    lines = LineCollection(list(seeds[:MOST_SEEDS]), colors=colour, linewidths=0.8, alpha=0.5)
    axes.add_collection(lines)
    single = [points[0] for points in seeds[:MOST_SEEDS] if len(points) == 1]
    axes.plot(*(zip(*single, strict=True) if single else ([], [])), ".", color=colour, alpha=0.5)
    axes.autoscale_view()
    frame = pd.DataFrame([point for points in seeds for point in points], columns=["x", "y"])
    means = frame.groupby("x")["y"].agg(["mean", "count"])
    means = means[means["count"] == len(seeds)]
    if len(seeds) > 1:
        axes.plot(means.index, means["mean"], color=colour, linewidth=2)
    axes.locator_params(nbins=4)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))


def picture(file: str, title: str, alt: str, figure: Figure) -> Picture:
    width, height = figure.get_size_inches() * 96  # a page has 96 pixels an inch
    if len(alt) > LONGEST_ALT:
        alt = alt[:LONGEST_ALT] + "…"
    return Picture(file, title, alt, png(figure), round(width), round(height))


def png(figure: Figure) -> bytes:
    """The figure's PNG, of equal bytes for equal figures."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()
