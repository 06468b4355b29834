"""Pictures of pages: curves and areas as SVG, in a tenth of the time that matplotlib takes."""

import math
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ampm.geometry import Array
from validation.show.style import FAINT, GRID, INK

WIDTH = 5.2
"""Width of an ordinary picture [in]: 500 px, so that its 9 pt text stays readable on a telephone."""
DASHED = "4 3"
"""Lengths of dashes and gaps, over the width of the line."""

_TOP, _BOTTOM, _GAP = 30, 30, 58
"""Room for title and legend, for labels below, and for all these between two charts [pt]."""
_RIGHT = 9  # [pt]
_LETTER = 4.7  # mean width of a letter of 8 pt [pt]
_BUCKETS = 420
"""Buckets over a curve: each keeps its smallest and largest sample, so that spikes remain."""


class Picture(NamedTuple):
    """One figure of a page."""

    image: Markup  # markup, without references to anything outside the page
    caption: str  # explanation
    wide: bool  # whether it spans the page


class Mark(NamedTuple):
    """A curve or an area."""

    # shape (N, 2), in the units of the axes; NaN interrupts a curve, infinity is the chart's edge
    points: Array
    style: str  # attributes of SVG
    label: str  # in the legend; empty for none
    color: str  # in the legend
    opacity: float = 1.0  # of curve or area, and in the legend [1]


@dataclass
class Chart:
    """Curves and areas about two axes."""

    left: float  # of the plotted field in the picture [pt]
    top: float  # likewise [pt]
    width: float  # likewise [pt]
    height: float  # likewise [pt]
    title: str = ""  # above
    xlabel: str = ""  # of the axis
    ylabel: str = ""  # of the axis
    xlim: tuple[float, float] | None = None  # of the field; None fits what is drawn
    ylim: tuple[float | None, float | None] = (None, None)  # likewise, either end
    equal: bool = False  # whether both axes have one scale; the field then shows more of one
    yticks: dict[str, float] = field(default_factory=dict)  # texts at heights, instead of numbers
    frame: bool = True  # whether axes, grid and numbers are drawn
    marks: list[Mark] = field(default_factory=list)  # what is drawn, the lowest first

    def line(
        self, x: ArrayLike, y: ArrayLike, color: str, width: float = 1.0, *, dash: str = "", label: str = ""
    ) -> None:
        """Draw a curve through points, shape (N,), of a width [pt]; NaN interrupts it."""
        lengths = " ".join(f"{float(part) * width:.3g}" for part in dash.split())
        dashes = f' stroke-dasharray="{lengths}"' if dash else ""
        style = f'fill="none" stroke="{color}" stroke-width="{width:g}"{dashes}'
        self.marks.append(Mark(np.column_stack([x, y]).astype(float), style, label, color))

    def area(
        self,
        x: ArrayLike,
        y: ArrayLike,
        color: str,
        *,
        opacity: float = 1.0,
        edge: str = "",
        label: str = "",
        below: bool = False,
    ) -> None:
        """Fill a polygon with corners, shape (N,), maybe with an edge, or below what is drawn so far."""
        line = f' stroke="{edge}" stroke-width=".6"' if edge else ""
        style = f'fill="{color}"{line}'
        mark = Mark(np.column_stack([x, y]).astype(float), style, label, color, opacity)
        self.marks.insert(0 if below else len(self.marks), mark)

    def band(self, x: Array, low: Array, high: Array, color: str, *, opacity: float, label: str = "") -> None:
        """Fill what is between two curves without gaps."""
        self.area([*x, *x[::-1]], [*low, *high[::-1]], color, opacity=opacity, label=label)

    def level(self, y: float, color: str, width: float = 0.7, *, dash: str = "", label: str = "") -> None:
        """Draw a horizontal line from edge to edge."""
        self.line([-np.inf, np.inf], [y, y], color, width, dash=dash, label=label)

    def instant(self, x: float, color: str, width: float = 0.7, *, dash: str = "") -> None:
        """Draw a vertical line from edge to edge."""
        self.line([x, x], [-np.inf, np.inf], color, width, dash=dash)

    def dots(self, x: ArrayLike, y: ArrayLike, color: str, size: float) -> None:
        """Draw dots of a diameter [pt]."""
        style = f'fill="none" stroke="{color}" stroke-width="{size:g}" stroke-linecap="round"'
        for at in np.column_stack([x, y]).astype(float):
            self.marks.append(Mark(np.array([at, at]), style, "", color))

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper ends of both axes."""
        points = np.concatenate([np.zeros((0, 2)), *(mark.points for mark in self.marks)])
        ends = []
        for axis, given in enumerate((self.xlim or (None, None), self.ylim)):
            values = points[np.isfinite(points[:, axis]), axis]
            low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
            size = max(abs(low), abs(high), 1e-3)
            margin = axis * 0.05 * (high - low) if high - low > 1e-9 * size else 0.05 * size
            fit = (low - margin, high + margin)
            ends.append([fit[k] if given[k] is None else given[k] for k in (0, 1)])
        low, high = np.array(ends, dtype=float).T
        if self.equal:
            unit = ((high - low) / (self.width, self.height)).max()
            middle, half = (low + high) / 2, unit * np.array([self.width, self.height]) / 2
            low, high = middle - half, middle + half
        return low, high

    def svg(self) -> Iterator[str]:
        """Elements of the picture."""
        low, high = self.limits()
        grid = f'stroke="{GRID}" stroke-width=".6"'
        unit = np.array([self.width, -self.height]) / (high - low)
        x, y = self.left, self.top + self.height
        if self.frame:
            for at, text in _ticks(low[0], high[0], self.width / 55):
                place = x + (at - low[0]) * unit[0]
                yield f'<path d="M{place:.1f} {y:.1f}v{-self.height:.1f}" {grid}/>'
                yield _text(place, y + 11, text, 'text-anchor="middle" font-size="8"')
            named = [(at, text) for text, at in self.yticks.items()]
            for at, text in named or _ticks(low[1], high[1], self.height / 16):
                place = y + (at - low[1]) * unit[1]
                if not named:
                    yield f'<path d="M{x:.1f} {place:.1f}h{self.width:.1f}" {grid}/>'
                yield _text(x - 4, place + 3, text, 'text-anchor="end" font-size="8"')
        window = f'x="{x:.1f}" y="{self.top:.1f}" width="{self.width:.1f}" height="{self.height:.1f}"'
        yield f'<svg {window} stroke-linejoin="round">'
        for mark in self.marks:
            points = np.where(np.isinf(mark.points), np.clip(mark.points, low, high), mark.points)
            path = _path(points - low, unit, self.height)
            yield f'<path d="{path}" {mark.style} opacity="{mark.opacity:g}"/>'
        yield "</svg>"
        if self.frame:
            sides = f"M{x:.1f} {self.top:.1f}v{self.height:.1f}h{self.width:.1f}"
            yield f'<path d="{sides}" fill="none" stroke="{FAINT}" stroke-width=".7"/>'
            middle = self.top + self.height / 2
            turned = f'text-anchor="middle" transform="rotate(-90 9 {middle:.1f})"'
            yield _text(x + self.width / 2, y + 23, self.xlabel, 'text-anchor="middle"')
            yield _text(9, middle, self.ylabel, turned)
        yield from self._heading()

    def _heading(self) -> Iterator[str]:
        """Legend above the field, because curves fill it, and the title above the legend."""
        entries = [mark for mark in self.marks if mark.label]
        lines: list[list[tuple[float, Mark]]] = [[]] if entries else []
        room = 0.0
        for mark in entries:
            needed = 22 + _LETTER * len(mark.label)
            if lines[-1] and room + needed > self.width + 4:
                lines.append([])
            room = needed + (room if lines[-1] else 0.0)
            lines[-1].append((room - needed, mark))
        y = self.top - 5.0
        for entry in reversed(lines):
            for at, mark in entry:
                width = '1" stroke-dasharray="3 2' if "dash" in mark.style else "3"
                start = f"M{self.left + at:.1f} {y - 3:.1f}"
                style = f'stroke="{mark.color}" stroke-width="{width}" opacity="{mark.opacity:g}"'
                yield f'<path d="{start}h10" {style}/>'
                yield _text(self.left + at + 13, y, mark.label, 'font-size="8"')
            y -= 13
        if self.title:
            yield _text(self.left, y - 11 * self.title.count("\n"), self.title)


def _text(x: float, y: float, text: str, style: str = "") -> str:
    lines = text.split("\n")
    more = "".join(f'<tspan x="{x:.1f}" dy="1.15em">{escape(line)}</tspan>' for line in lines[1:])
    return f'<text x="{x:.1f}" y="{y:.1f}" {style}>{escape(lines[0])}{more}</text>' if text else ""


def _path(points: Array, unit: Array, height: float) -> str:
    """Path through points from the lower left corner, interrupted by NaN; in points of a field."""
    words, pen = [], "M"
    for x, y in (points * unit + (0.0, height)).round(1).tolist():
        if math.isnan(x) or math.isnan(y):
            pen = "M"
        else:
            words.append(f"{pen}{x:g} {y:g}")
            pen = "L"
    return "".join(words)


def _ticks(low: float, high: float, most: float) -> list[tuple[float, str]]:
    """Round numbers between two ends, about so many at most, with their texts."""
    least = (high - low) / max(most, 2.0)
    power = math.floor(math.log10(least))
    step = next(n * 10.0**power for n in (1, 2, 2.5, 5, 10) if n * 10.0**power >= least * (1 - 1e-9))
    decimals = len(f"{step:.12f}".rstrip("0").partition(".")[2])
    numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return [(n * step, f"{n * step:.{decimals}f}".replace("-", "\u2212")) for n in numbers]


def new_charts(
    height: float,
    rows: int = 1,
    *,
    width: float = WIDTH,
    left: float = 0.62,
    ratios: Sequence[float] | None = None,
) -> list[Chart]:
    """Charts of a picture, one above the other.

    Args:
        height: of the picture [in].
        rows: number of charts.
        width: of the picture [in].
        left: room for the labels of the vertical axis [in].
        ratios: relative heights of the charts.
    """
    shares = np.array(ratios or [1.0] * rows) / sum(ratios or [1.0] * rows)
    heights = shares * (72 * height - _TOP - _BOTTOM - _GAP * (rows - 1))
    tops = _TOP + np.concatenate([[0.0], np.cumsum(heights + _GAP)[:-1]])
    return [
        Chart(72 * left, float(top), 72 * (width - left) - _RIGHT, float(tall))
        for top, tall in zip(tops, heights, strict=True)
    ]


def picture(charts: Sequence[Chart], label: str, caption: str = "", *, wide: bool = False) -> Picture:
    """A picture of charts for a page.

    Args:
        charts: in one picture.
        label: description of the picture for screen readers.
        caption: explanation.
        wide: whether it spans the page.
    """
    width = max(chart.left + chart.width for chart in charts) + _RIGHT
    height = max(chart.top + chart.height + (_BOTTOM if chart.frame else 0) for chart in charts)
    size = f'width="{width:.0f}pt" height="{height:.0f}pt" viewBox="0 0 {width:.0f} {height:.0f}"'
    font = f'font-family="sans-serif" font-size="9" fill="{INK}"'
    parts = "".join(part for chart in charts for part in chart.svg())
    data = b64encode(f'<svg xmlns="http://www.w3.org/2000/svg" {size} {font}>{parts}</svg>'.encode()).decode()
    return Picture(
        Markup(f'<img alt="{escape(label)}" src="data:image/svg+xml;base64,{data}">'), caption, wide
    )


def decimate(time: Array, value: Array, buckets: int = _BUCKETS) -> tuple[Array, Array]:
    """Thin a curve for drawing without losing its extremes.

    Args:
        time: shape (N,).
        value: shape (N,); NaN where undefined.
        buckets: each yields its smallest and its largest sample.

    Returns:
        Times and values, at most ``2 * buckets`` of each.
    """
    count = len(time)
    if count <= 2 * buckets:
        return time, value
    low, high = (np.where(np.isnan(value), empty, value) for empty in (np.inf, -np.inf))
    parts = np.array_split(np.arange(count), buckets)
    rows = np.unique([(part[low[part].argmin()], part[high[part].argmax()]) for part in parts])
    return time[rows], value[rows]
