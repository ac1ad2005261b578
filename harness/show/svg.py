"""Plots as SVG for a page: text stays text, and the page's style says what colours are, light or dark."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from markupsafe import Markup, escape
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator

Point = tuple[float, float]
DASHES = ("", "6 3", "2 2", "8 3 2 3")
SHAPES = {
    "disc": "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0",
    "diamond": "M0-5L5 0L0 5L-5 0Z",
    "square": "M-4-4H4V4H-4Z",
    "up": "M0-5L5 4H-5Z",
    "down": "M0 5L5-4H-5Z",
    "cross": "M-4-4L4 4M-4 4L4-4",
    "ring": "M-6 0a6 6 0 1 0 12 0a6 6 0 1 0-12 0",
}
LOOKS = 7
"""Colours of the style, 'c0' to 'c6'; lines that share one differ in dashes and marker."""
LETTER = 6.2
"""Width of one, in the plot's units."""


@dataclass(frozen=True)
class Axis:
    """From values to places. log: of positive values; zero has a place before them, where `zero` says so."""

    low: float
    high: float
    label: str = ""
    log: bool = False
    zero: bool = False

    def share(self, value: float) -> float:
        """Where the value is, 0 at the axis's beginning and 1 at its end; what is beyond stays at the end."""
        if self.log and value <= 0:
            return 0.0
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        where = ((math.log10(value) if self.log else value) - low) / (high - low)
        return min(1.0, max(0.0, 0.1 + 0.9 * where if self.zero else where))

    def ticks(self, most: int = 5) -> list[tuple[float, str]]:
        """Values and their texts."""
        few = self.log and self.high < 150 * self.low
        finder = (
            LogLocator(subs=(1, 2, 5) if few else (1,), numticks=most)
            if self.log
            else MaxNLocator(most, steps=[1, 2, 2.5, 5, 10])
        )
        inside = [float(v) for v in finder.tick_values(self.low, self.high) if self.low <= v <= self.high]
        large = self.log or max(abs(self.low), abs(self.high)) >= 1000
        text: Callable[[float], str] = EngFormatter(sep="") if large else lambda value: f"{value:.6g}"
        zero = [(0.0, "0")] if self.zero else []
        return [*zero, *((value, text(value).replace("-", "\N{MINUS SIGN}")) for value in inside)]


def around(values: Sequence[float], label: str, *, least: Sequence[float] = ()) -> Axis:
    """An axis that shows the finite ones of these values, and `least`, with some room."""
    known = [v for v in (*values, *least) if math.isfinite(v)] or [0.0, 1.0]
    room = 0.06 * (max(known) - min(known)) or 0.5 * abs(known[0]) or 0.5
    return Axis(min(known) - room, max(known) + room, label)


def decades(values: Sequence[float], label: str) -> Axis:
    """A logarithmic axis that shows these values, which are not negative."""
    known = [v for v in values if math.isfinite(v) and v > 0] or [1.0, 10.0]
    return Axis(0.7 * min(known), 1.4 * max(known), label, log=True, zero=any(v == 0 for v in values))


class Plot:
    """One plot. said: what it shows, in a sentence. rows: names along the y axis instead of numbers; the y of
    what is drawn is then a row's number from 0, downwards. second: an axis on the right."""

    def __init__(
        self,
        title: str,
        said: str,
        x: Axis,
        y: Axis | None = None,
        rows: Sequence[str] = (),
        second: Axis | None = None,
    ) -> None:
        self._title, self._said = title, said
        self.x, self._second = x, second
        self.y = y or Axis(len(rows) - 0.5, -0.5)
        self._rows = rows
        self.width = 340
        self.left = 14 + LETTER * max((min(len(row), 24) for row in rows), default=0) if rows else 50
        self.right = self.width - (46 if second else 12)
        self.top = 26 if title else 8
        self.bottom = self.top + (max(3, len(rows)) * 18 if rows else 170)
        self._parts: list[str] = []
        self._labels: list[tuple[float, float, float, float]] = []

    def at(self, x: float, y: float, second: bool = False) -> Point:
        """The place of a point."""
        upright = self._second if second and self._second else self.y
        across = self.left + (self.right - self.left) * self.x.share(x)
        return across, self.bottom - (self.bottom - self.top) * upright.share(y)

    def line(
        self, points: Sequence[Point], look: str, *, dash: str = "", second: bool = False, steps: bool = False
    ) -> None:
        """Through the points that are finite. steps: level between them."""
        places = [self.at(x, y, second) for x, y in points if math.isfinite(x) and math.isfinite(y)]
        if steps:
            places = [
                p for a, b in zip(places, [*places[1:], places[-1]], strict=True) for p in (a, (b[0], a[1]))
            ]
        if places:
            self._parts.append(f'<path class="line {look}" d="{_path(places)}"{_dashed(dash)}/>')

    def band(self, low: Sequence[Point], high: Sequence[Point], look: str) -> None:
        """Between two lines."""
        places = [self.at(*point) for point in (*low, *reversed(high)) if math.isfinite(point[1])]
        if places:
            self._parts.append(f'<path class="band {look}" d="{_path(places)}z"/>')

    def mark(self, x: float, y: float, shape: str, look: str, tip: str = "") -> None:
        """A marker; what it stands for is told when the pointer is on it."""
        across, down = self.at(x, y)
        told = f' data-tip="{escape(tip)}"' if tip else ""
        open_one = " open" if shape in ("ring", "cross") else ""
        self._parts.append(
            f'<path class="mark{open_one} {look}"{told} transform="translate({across:.0f} {down:.1f})" '
            f'd="{SHAPES[shape]}"/>'
        )

    def dots(self, points: Sequence[Point], look: str) -> None:
        """Small ones, of single runs."""
        places = [self.at(x, y) for x, y in points if math.isfinite(x)]
        if places:
            path = "".join(f"M{x:.0f} {y:.1f}h0" for x, y in places)
            self._parts.append(f'<path class="dots {look}" d="{path}"/>')

    def span(self, low: float, high: float, y: float, look: str) -> None:
        """An interval along the x axis."""
        if math.isfinite(low) and math.isfinite(high):
            (a, down), (b, _) = self.at(low, y), self.at(high, y)
            self._parts.append(f'<path class="span {look}" d="M{a:.0f} {down:.1f}H{b:.0f}"/>')

    def upright(self, x: float, low: float, high: float, look: str) -> None:
        """An interval along the y axis."""
        if math.isfinite(low) and math.isfinite(high):
            (across, a), (_, b) = self.at(x, low), self.at(x, high)
            self._parts.append(f'<path class="span thin {look}" d="M{across:.0f} {a:.0f}V{b:.0f}"/>')

    def shade(self, row: int) -> None:
        """A ground under a row."""
        (_, a), (_, b) = self.at(0, row - 0.5), self.at(0, row + 0.5)
        self._parts.insert(
            0, f'<path class="ground" d="M{self.left:.0f} {a:.0f}H{self.right}V{b:.0f}H{self.left:.0f}z"/>'
        )

    def rule(self, *, x: float = math.nan, y: float = math.nan, dash: str = "4 3", look: str = "") -> None:
        """A line across the plot, at a value of either axis."""
        if math.isfinite(x):
            across, _ = self.at(x, 0)
            path = f"M{across:.0f} {self.top}V{self.bottom:.0f}"
        else:
            _, down = self.at(0, y)
            path = f"M{self.left:.0f} {down:.0f}H{self.right}"
        self._parts.insert(0, f'<path class="rule {look}" d="{path}"{_dashed(dash)}/>')

    def name(self, x: float, y: float, text: str, look: str = "") -> None:
        """A name beside a point, where there is room for it."""
        across, down = self.at(x, y)
        long = LETTER * len(text)
        for dx, dy, anchor in ((7, 4, "start"), (-7, 4, "end"), (0, -8, "middle"), (0, 16, "middle")):
            left = across + dx - {"start": 0, "end": long, "middle": long / 2}[anchor]
            box = (left, down + dy - 10, left + long, down + dy + 2)
            inside = box[0] >= self.left and box[2] <= self.width and box[1] >= self.top - 8
            if inside and not any(_overlap(box, other) for other in self._labels):
                self._labels.append(box)
                self._parts.append(
                    f'<text class="name {look}" x="{across + dx:.0f}" y="{down + dy:.0f}" '
                    f'text-anchor="{anchor}">{escape(text)}</text>'
                )
                return

    def taken(self, x: float, y: float) -> None:
        """Names stay clear of this point."""
        across, down = self.at(x, y)
        self._labels.append((across - 4, down - 4, across + 4, down + 4))

    def render(self) -> Markup:
        """The SVG."""
        height = self.bottom + (36 if self.x.label else 22)
        title = f'<text class="title" x="4" y="14">{escape(_short(self._title, 48))}</text>'
        frame = [title] if self._title else []
        for value, text in self.x.ticks(5):
            across, _ = self.at(value, 0)
            frame.append(f'<text class="tick" x="{across:.0f}" y="{self.bottom + 14:.0f}">{text}</text>')
        if self._rows:
            for row, name in enumerate(self._rows):
                _, down = self.at(0, row)
                at = f'x="{self.left - 6:.0f}" y="{down + 4:.0f}"'
                frame.append(f'<text class="row" {at}>{escape(_short(name, 24))}</text>')
        else:
            frame += self._upright_ticks(self.y, self.left - 6, False)
        if self._second:
            frame += self._upright_ticks(self._second, self.right + 6, True)
        axis = f"M{self.left:.0f} {self.top}V{self.bottom:.0f}H{self.right}"
        frame.append(f'<path class="axis" d="{axis}{f"V{self.top}" if self._second else ""}"/>')
        if self.x.label:
            middle = (self.left + self.right) / 2
            frame.append(
                f'<text class="tick" x="{middle:.0f}" y="{height - 4:.0f}">{escape(self.x.label)}</text>'
            )
        return Markup(
            f'<svg viewBox="0 0 {self.width} {height:.0f}" role="img" aria-label="{escape(self._said)}">'
            f"{''.join(frame)}{''.join(self._parts)}</svg>"
        )

    def _upright_ticks(self, axis: Axis, across: float, second: bool) -> list[str]:
        kind = "row second" if second else "row"
        return [
            f'<text class="{kind}" x="{across:.0f}" y="{down + 4:.0f}">{text}</text>'
            for value, text in axis.ticks(5)
            for down in [self.bottom - (self.bottom - self.top) * axis.share(value)]
        ]


def look(number: int) -> tuple[str, str, str]:
    """Class, dashes and marker of one of several lines; no two of 28 look alike, in colour or without."""
    shapes = ("disc", "diamond", "square", "up", "down", "cross")
    return (
        f"c{number % LOOKS}",
        DASHES[(number + number // LOOKS) % len(DASHES)],
        shapes[number % len(shapes)],
    )


def key(shape: str, look: str, dash: str = "", *, line: bool = False) -> Markup:
    """The sign of a legend."""
    stroke = f'<path class="line {look}" d="M0 8H28"{_dashed(dash)}/>' if line else ""
    marker = SHAPES.get(shape, "")
    open_one = " open" if shape in ("ring", "cross") else ""
    mark = f'<path class="mark{open_one} {look}" transform="translate(14 8)" d="{marker}"/>' if marker else ""
    return Markup(f'<svg class="key" viewBox="0 0 28 16" aria-hidden="true">{stroke}{mark}</svg>')


def _path(places: Sequence[Point]) -> str:
    """Whole units, each from the one before."""
    rounded = [(round(x), round(y)) for x, y in places]
    kept = [rounded[0], *(b for a, b in pairwise(rounded) if a != b)]
    (x, y), *_ = kept
    moves = " ".join(f"{b[0] - a[0]} {b[1] - a[1]}" for a, b in pairwise(kept))
    return f"M{x} {y}l{moves}".replace(" -", "-") if moves else f"M{x} {y}h0"


def _dashed(dash: str) -> str:
    return f' stroke-dasharray="{dash}"' if dash else ""


def _overlap(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
