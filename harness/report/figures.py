"""Figures of boards, drawn by matplotlib: as SVG for a page, whose style says the colours, or as a file."""

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
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from harness.report.tables import Table

COLOURS = ("#0072b2", "#c45100", "#007a58", "#a8457f", "#8f6400", "#6a51c7", "#1c1e21")
"""Colours that the colour-blind can distinguish, readable on white."""
BLUE, ORANGE, GREEN, PINK, *_, INK = COLOURS
GREY, GROUND, PAPER = "#6b7178", "#f0f1f3", "#ffffff"
VARIABLES = {
    **{colour: f"var(--c{number})" for number, colour in enumerate(COLOURS)},
    **{GREY: "var(--cg)", GROUND: "var(--ground)", PAPER: "var(--bg)"},
}
"""Variables of the page's style, by colour."""
STYLES = ("-", "--", ":", "-.")
MARKERS = {"o": "●", "D": "◆", "s": "■", "^": "▲", "v": "▼", "X": "✖"}
"""Markers, and the signs that stand for them in a legend."""
MOST_SEEDS = 100
"""Seeds that have lines of their own; means are of all."""
LONGEST_ALT = 20_000
"""Characters of a figure in words."""
LETTER = 6.4
"""Mean width of a letter of a label, in pixels."""
_STYLE: dict[Any, Any] = {
    **{"svg.fonttype": "none", "text.parse_math": False, "font.family": "DejaVu Sans", "font.size": 11},
    **{"axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": GREY, "axes.linewidth": 0.8},
    **{"axes.titlesize": 12, "axes.titleweight": "bold", "axes.titlelocation": "left"},
    **{"axes.labelcolor": GREY, "xtick.color": GREY, "ytick.color": GREY, "ytick.labelcolor": INK},
    **{"axes.axisbelow": True, "text.color": INK, "lines.linewidth": 1.6},
    **{"savefig.dpi": 200, "figure.dpi": 72},
}


@dataclass(frozen=True)
class Chart:
    """Plots that belong together.

    `note`: help with reading them. `legend`: a colour's number, a sign and its meaning, for each line.
    `table`: the numbers that are drawn. `data`: numbers that are too many for a table. `choices`: a name
    for each plot, where the page shows one plot at a time.
    """

    title: str
    plots: Sequence[Markup]
    note: str = ""
    legend: Sequence[tuple[int, str, str]] = ()
    table: Table | None = None
    data: pd.DataFrame | None = None
    choices: Sequence[str] = ()


@contextmanager
def styled() -> Iterator[None]:
    """Draw figures alike within this context, whatever the user's own settings."""
    with mpl.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


class Plot:
    """A figure of one pair of axes, and the tooltips of its points. `said`: it in words."""

    def __init__(self, said: str, figure: Figure) -> None:
        self.said = said
        self.tips: list[Sequence[str]] = []
        self.figure = figure

    @classmethod
    def of(cls, said: str, title: str = "", label: str = "", rows: Sequence[str] = ()) -> Plot:
        """Return a plot of one pair of axes. `rows`: names along the y axis, from the top, for numbers."""
        width, height = 340.0, 46 + (max(3, len(rows)) * 18 if rows else 190)
        left = 12 + LETTER * max((min(len(row), 24) for row in rows), default=5)
        top = 22 if title else 8
        figure = Figure(figsize=(width / 72, height / 72))
        axes = figure.add_axes((left / width, 34 / height, 1 - (left + 12) / width, 1 - (34 + top) / height))
        axes.set(title=title, xlabel=label)
        if rows:
            label_rows(axes, rows)
        return cls(said, figure)

    @property
    def axes(self) -> Axes:
        """The pair of axes."""
        return self.figure.axes[0]

    def points(
        self,
        places: Sequence[Sequence[float]],
        colour: str,
        marker: str,
        tips: Sequence[str] = (),
        hollow: bool = False,
    ) -> None:
        """Draw markers. `tips`: a text for each, which the pointer brings up."""
        scatter(self.axes, places, colour, marker, hollow=hollow).set_gid(f"tips-{len(self.tips)}")
        self.tips.append(tips)

    def svg(self) -> Markup:
        """Return the plot for a page. Its colours are variables of the page's style, its text is text."""
        mpl.rcParams["svg.hashsalt"] = self.said
        buffer = io.StringIO()
        self.figure.patch.set_visible(False)
        canvas: Any = FigureCanvasSVG(self.figure)
        canvas.print_svg(buffer, metadata={"Date": None})
        text = buffer.getvalue()
        drawn = " ".join(text[text.index('<g id="figure_1"') :].split())
        drawn = re.sub(r'<g id="tips-(\d+)">(.*?)</g>', self._with_tips, drawn)
        drawn = re.sub(r'<g id="[^"]*"', "<g", drawn).replace("xlink:href", "href")
        drawn = re.sub(r' style="([^"]*)"', _as_attributes, drawn)
        drawn = re.sub(r' (?:d|x|y|transform)="[^"]*"', lambda m: re.sub(r"(\.\d)\d+", r"\1", m[0]), drawn)
        drawn = re.sub(r"#[0-9a-f]{6}\b", lambda match: VARIABLES.get(match[0], match[0]), drawn)
        width, height = (72 * side for side in self.figure.get_size_inches())
        said = self.said if len(self.said) <= LONGEST_ALT else self.said[:LONGEST_ALT] + "…"
        head = f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(said)}">'
        return Markup(head + drawn)

    def _with_tips(self, match: re.Match[str]) -> str:
        tips = iter(self.tips[int(match[1])])
        return re.sub("<use ", lambda use: f'{use[0]}data-tip="{escape(next(tips))}" ', match[0])


def _as_attributes(match: re.Match[str]) -> str:
    """Return the properties of a style attribute, which the page forbids, as attributes of their own."""
    pairs = [part.split(": ", 1) for part in match[1].split("; ")]
    kept = [f' {name}="{value}"' for name, value in pairs if name not in ("font-family", "stroke-dashoffset")]
    return "".join(kept)


def look(number: int) -> tuple[str, str, str]:
    """Return colour, line style and marker of one of several lines; no two of 42 look alike."""
    style = STYLES[(number + number // len(COLOURS)) % len(STYLES)]
    return COLOURS[number % len(COLOURS)], style, list(MARKERS)[number % len(MARKERS)]


def sign(number: int, meaning: str) -> tuple[int, str, str]:
    """Return the line of a legend for `look(number)`."""
    return number % len(COLOURS), MARKERS[look(number)[2]], meaning


def around(values: Sequence[float], least: Sequence[float] = ()) -> tuple[float, float]:
    """Return limits of an axis that shows these values where finite, and `least`, with a margin."""
    known = [value for value in (*values, *least) if math.isfinite(value)] or [0.0, 1.0]
    room = 0.06 * (max(known) - min(known)) or 0.5 * abs(known[0]) or 0.5
    return min(known) - room, max(known) + room


def label_rows(axes: Axes, rows: Sequence[str]) -> None:
    """Write names along the y axis, from the top."""
    for place, row in enumerate(rows):
        short = row if len(row) <= 24 else row[:23] + "…"
        axes.text(-0.015, place, short, transform=axes.get_yaxis_transform(), ha="right", va="center")
    axes.set_yticks([])
    axes.set_ylim(max(3, len(rows)) - 0.5, -0.5)


def scatter(
    axes: Axes,
    places: Sequence[Sequence[float]],
    colour: str,
    marker: str,
    tips: Sequence[str] = (),
    hollow: bool = False,
) -> PathCollection:
    """Draw markers with a thin rim. `tips`: for a page alone. `hollow`: with a rim of the colour alone."""
    xs, ys = zip(*places, strict=True) if places else ([], [])
    size, (inner, rim) = 26 if marker == "D" else 34, (PAPER, colour) if hollow else (colour, PAPER)
    return axes.scatter(xs, ys, size, inner, marker=marker, zorder=4, edgecolors=rim, linewidths=0.8)


def spans(axes: Axes, ends: Sequence[tuple[tuple[float, float], tuple[float, float]]], colour: str) -> None:
    """Draw intervals: lines between two points, where both are finite."""
    known = [pair for pair in ends if all(math.isfinite(value) for point in pair for value in point)]
    axes.add_collection(LineCollection(known, colors=colour, linewidths=2, zorder=3), autolim=False)


def rules(axes: Axes, upright: bool, *levels: float) -> None:
    """Draw dashed lines across the plot."""
    for level in levels:
        draw = axes.axvline if upright else axes.axhline
        draw(level, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)


def name_points(axes: Axes, places: Sequence[tuple[float, float]], names: Sequence[str]) -> None:
    """Write names beside points, where no earlier name is near. The limits of the axes are final."""
    written: list[tuple[float, float]] = []
    for place, name in zip(places, names, strict=True):
        x, y = axes.transAxes.inverted().transform(axes.transData.transform(place))
        if not any(abs(x - left) < 0.25 and abs(y - low) < 0.06 for left, low in written):
            axes.annotate(name, place, (5, 4), textcoords="offset points", fontsize=8)
            written.append((x, y))


def plot_seeds(axes: Axes, seeds: Sequence[Sequence[tuple[float, float]]], colour: str) -> None:
    """Draw a thin line for each seed, up to `MOST_SEEDS`, and a thick one for the mean of all."""
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


def as_file(figure: Figure, kind: str) -> bytes:
    """Return the figure as a PNG, PDF or SVG file, of equal bytes for equal figures. `kind`: 'png', ..."""
    buffer = io.BytesIO()
    dates = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    mpl.rcParams["svg.hashsalt"] = "irl-bench"
    figure.savefig(buffer, format=kind, facecolor=PAPER, metadata=dates[kind])
    return buffer.getvalue()
