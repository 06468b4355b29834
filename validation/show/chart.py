"""Pictures of pages and papers: curves and areas, in a tenth of the time that matplotlib takes."""

import math
import textwrap
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ampm.geometry import Array
from validation.show.style import FAINT, GRID
from validation.show.vector import Mark, Word, font_folder, pgf, svg

WIDTH = 5.2
"""Width of an ordinary picture [in]: 500 px, so that its 9 pt text stays readable on a telephone."""
DASHED = "4 3"
"""Lengths of dashes and gaps, over the width of the line."""

_TOP, _BOTTOM, _GAP = 30, 30, 58
"""Room for title and legend, for labels below, and for all these between two charts [pt]."""
_RIGHT, _LABEL = 9, 15  # room right of the field, and for the label of the vertical axis [pt]


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
    label_at: float = 9.0  # of the label of the vertical axis in the picture [pt]
    xlim: tuple[float | None, float | None] = (None, None)  # ends of the field; None fits what is drawn
    ylim: tuple[float | None, float | None] = (None, None)  # likewise
    equal: bool = False  # whether both axes have one scale; the field then shows more of one
    xticks: dict[str, float] = field(default_factory=dict)  # texts at places, instead of numbers
    yticks: dict[str, float] = field(default_factory=dict)  # likewise
    # what is drawn, the lowest first; points are in the units of the axes, infinity is the chart's edge
    marks: list[Mark] = field(default_factory=list)

    def line(
        self, x: ArrayLike, y: ArrayLike, color: str, width: float = 1.0, *, dash: str = "", label: str = ""
    ) -> None:
        """Draw a curve through points, shape (N,), of a width [pt]; NaN interrupts it."""
        lengths = tuple(float(part) * width for part in dash.split())
        self.marks.append(Mark(_points(x, y), color, width, dash=lengths, label=label))

    def area(
        self, x: ArrayLike, y: ArrayLike, color: str, *, opacity: float = 1.0, edge: str = "", label: str = ""
    ) -> None:
        """Fill a polygon with corners, shape (N,), maybe with an edge."""
        self.marks.append(Mark(_points(x, y), edge, fill=color, opacity=opacity, label=label))

    def band(self, x: Array, low: Array, high: Array, color: str, *, opacity: float, label: str = "") -> None:
        """Fill what is between two curves without gaps."""
        self.area([*x, *x[::-1]], [*low, *high[::-1]], color, opacity=opacity, label=label)

    def shade(self, begin: float, end: float, color: str) -> None:
        """Fill what is between two instants, from edge to edge, below what is drawn so far."""
        corners = _points([begin, begin, end, end], [-np.inf, np.inf, np.inf, -np.inf])
        self.marks.insert(0, Mark(corners, "", fill=color))

    def level(self, y: float, color: str, width: float = 0.7, *, dash: str = "") -> None:
        """Draw a horizontal line from edge to edge."""
        self.line([-np.inf, np.inf], [y, y], color, width, dash=dash)

    def name(self, title: str, ylabel: str, xlabel: str = "time [s]") -> None:
        """Give the chart its title, and the axes their labels."""
        self.title, self.xlabel, self.ylabel = title, xlabel, ylabel

    def instant(self, x: float, color: str, width: float = 0.7, *, dash: str) -> None:
        """Draw a vertical line from edge to edge."""
        self.line([x, x], [-np.inf, np.inf], color, width, dash=dash)

    def dots(self, x: ArrayLike, y: ArrayLike, color: str, size: float) -> None:
        """Draw dots of a diameter [pt]."""
        self.marks.append(Mark(_points(x, y), color, size, round=True))

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper ends of both axes."""
        points = np.concatenate([np.zeros((0, 2)), *(mark.points for mark in self.marks)])
        ends = []
        for axis, given in enumerate((self.xlim, self.ylim)):
            values = points[np.isfinite(points[:, axis]), axis]
            low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
            size = max(abs(low), abs(high), 1e-3)
            margin = 0.05 * (axis or self.equal) * (high - low) if high - low > 1e-9 * size else 0.05 * size
            fit = (low - margin, high + margin) if low or high else (-0.1 if axis else -1.0, 1.0)
            ends.append([fit[k] if given[k] is None else given[k] for k in (0, 1)])
        low, high = np.array(ends, dtype=float).T
        if self.equal:
            unit = max(*(high - low) / (self.width, self.height), 5e-4)  # [m/pt]: who stands does not move
            middle, half = (low + high) / 2, unit * np.array([self.width, self.height]) / 2
            low, high = middle - half, middle + half
        return low, high

    def items(self) -> Iterator[Mark | Word]:
        """What is drawn, in points of the picture."""
        low, high = self.limits()
        unit = np.array([self.width, -self.height]) / (high - low)
        x, y = self.left, self.top + self.height
        for text, at in (self.xticks or _ticks(low[0], high[0], self.width / 55)).items():
            place = x + (at - low[0]) * unit[0]
            if not self.xticks:
                yield Mark(np.array([(place, y), (place, self.top)]), GRID)
            yield Word(place, y + 11, text, 8.0, "middle")
        ticks = self.yticks or _ticks(low[1], high[1], self.height / 16)
        if not self.yticks and max(map(text_width, ticks)) > self.left - _LABEL:
            power = math.floor(math.log10(max(-low[1], high[1])))
            few = _ticks(low[1] / 10.0**power, high[1] / 10.0**power, self.height / 16)
            ticks = {text: at * 10.0**power for text, at in few.items()}
            yield Word(x - 4, self.top - 5, f"1e{power}", 8.0, "end")
        for text, at in ticks.items():
            place = y + (at - low[1]) * unit[1]
            if not self.yticks:
                yield Mark(np.array([(x, place), (x + self.width, place)]), GRID)
            yield Word(x - 4, place + 3, text, 8.0, "end")
        window = (x, self.top, self.width, self.height)
        for mark in self.marks:
            points = np.where(np.isinf(mark.points), np.clip(mark.points, low, high), mark.points)
            yield mark._replace(points=(points - low) * unit + (x, y), window=window)
        yield Mark(np.array([(x, self.top), (x, y), (x + self.width, y)]), FAINT, 0.7)
        yield Word(x + self.width / 2, y + 23, self.xlabel, anchor="middle")
        yield Word(self.label_at, self.top + self.height / 2, self.ylabel, anchor="middle", turned=True)
        yield from self._heading()

    def _legend(self) -> list[list[tuple[float, Mark]]]:
        """Lines of the legend: marks with their places."""
        lines: list[list[tuple[float, Mark]]] = []
        room = math.inf
        for mark in self.marks:
            needed = 22 + text_width(mark.label)
            if mark.label:
                if room + needed > self.width + 4:
                    lines.append([])
                    room = 0.0
                lines[-1].append((room, mark))
                room += needed
        return lines

    def heading_height(self) -> float:
        """Height of legend and title [pt]."""
        return 13.0 * len(self._legend()) + (13.0 + 11.0 * self.title.count("\n") if self.title else 0.0)

    def _heading(self) -> Iterator[Mark | Word]:
        """Legend above the field, because curves fill it, and the title above the legend."""
        y = self.top - 5.0
        for entry in reversed(self._legend()):
            for at, mark in entry:
                x, width = self.left + at, 5.0 if mark.fill else min(3.0, 1.5 * mark.width)
                points = np.array([(x, y - 3), (x + 10, y - 3)])
                yield Mark(points, mark.fill or mark.stroke, width, dash=mark.dash, opacity=mark.opacity)
                yield Word(x + 13, y, mark.label, 8.0)
            y -= 13
        if self.title:
            yield Word(self.left, y - 11 * self.title.count("\n"), self.title)


@dataclass(frozen=True)
class Picture:
    """One figure of a page, or of a paper."""

    charts: Sequence[Chart]  # in one picture
    label: str  # what it shows, also for screen readers
    caption: str = ""  # explanation
    wide: bool = False  # whether it spans the page
    number: int = 0  # on the page, from 1

    @property
    def text(self) -> str:
        """Number and caption."""
        label = self.label[:1].upper() + self.label[1:]
        return f"Figure {self.number}. {label}. {self.caption}".rstrip()

    def __html__(self) -> str:
        """The figure of a page, without references to anything outside it."""
        data = b64encode(svg(*_drawn(self.charts)).encode()).decode()
        image = Markup('<img alt="{}" src="data:image/svg+xml;base64,{}">').format(self.label, data)
        card = Markup('<figure class="card{}">{}<figcaption>{}</figcaption></figure>')
        return card.format(" wide" * self.wide, image, self.text)

    def as_file(self, form: str, width: float | None = None) -> bytes:
        """As SVG, PDF, PNG or PGF with its letters; with a width [pt] its charts are fitted to it."""
        drawn = _drawn(self.charts if width is None else _fitted(self.charts, width))
        if form == "pgf":
            return pgf(*drawn).encode()
        text = svg(*drawn, embed=True)
        if form == "svg":
            return text.encode()
        import vl_convert  # loads a JavaScript engine

        vl_convert.register_font_directory(str(font_folder()))
        if form == "png":  # on white, as a viewer's own background may be dark
            head, end, rest = text.partition(">")
            white = '<rect width="100%" height="100%" fill="#fff"/>'
            return bytes(vl_convert.svg_to_png(f"{head}{end}{white}{rest}", scale=2.0))
        return bytes(vl_convert.svg_to_pdf(text.replace('pt"', '"', 2)))  # of which a pixel is a point


def numbered(pictures: Iterable[Picture]) -> list[Picture]:
    """Pictures with their numbers, in their order."""
    return [replace(item, number=number) for number, item in enumerate(pictures, start=1)]


def _drawn(charts: Sequence[Chart]) -> tuple[list[Mark | Word], float, float]:
    """What is drawn, width and height [pt]."""
    width = max(chart.left + chart.width for chart in charts) + _RIGHT
    height = max(chart.top + chart.height + _BOTTOM for chart in charts)
    items = [item for chart in charts for item in chart.items() if isinstance(item, Mark) or item.text]
    return items, round(width), round(height)


def _fitted(charts: Sequence[Chart], width: float) -> list[Chart]:
    """Charts of a picture that is so wide [pt], with letters of the same size.

    Fields get narrower, those with one scale for both axes lower, too. Titles and legends may get more lines.
    """
    share = (width - _RIGHT) / max(chart.left + chart.width for chart in charts)
    found, moved = [], 0.0
    for chart in charts:
        height, wide = chart.height * (share if chart.equal else 1.0), width - chart.left - _RIGHT
        lines = [textwrap.fill(line, round(wide / 5.0)) for line in chart.title.split("\n")]
        new = replace(chart, width=wide, height=height, title="\n".join(lines))
        moved += max(0.0, new.heading_height() - (chart.top if len(charts) == 1 else _TOP) + 4.0)
        found.append(replace(new, top=chart.top + moved))
        moved += height - chart.height
    return found


def _points(x: ArrayLike, y: ArrayLike) -> Array:
    return np.column_stack([x, y]).astype(float)


def text_width(text: str) -> float:
    """Width of a text of 8 pt, about [pt]."""
    return sum(3.0 if x in "ijlftr.,:;' " else 7.5 if x in "mwMW%" else 5.2 for x in text)


def _ticks(low: float, high: float, most: float) -> dict[str, float]:
    """Texts of round numbers between two ends, about so many at most, at these numbers."""
    least = (high - low) / max(most, 2.0)
    power = math.floor(math.log10(least))
    step = next(n * 10.0**power for n in (1, 2, 2.5, 5, 10) if n * 10.0**power >= least * (1 - 1e-9))
    decimals = len(f"{step:.15f}".rstrip("0").partition(".")[2])
    numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    if len(numbers) < 2:  # one shows no scale
        return _ticks(low, high, 2.0 * max(most, 2.0))
    return {f"{n * step:.{decimals}f}".replace("-", "\u2212"): n * step for n in numbers}


def new_charts(
    height: float, ratios: Sequence[float] = (1.0,), *, width: float = WIDTH, left: float = 0.62
) -> list[Chart]:
    """Charts of a picture of this height and width [in], in rows whose heights have these ratios.

    ``left`` is the room for the labels of the vertical axis [in].
    """
    shares = np.array(ratios) / sum(ratios)
    heights = shares * (72 * height - _TOP - _BOTTOM - _GAP * (len(ratios) - 1))
    tops = _TOP + np.concatenate([[0.0], np.cumsum(heights + _GAP)[:-1]])
    return [
        Chart(72 * left, float(top), 72 * (width - left) - _RIGHT, float(tall))
        for top, tall in zip(tops, heights, strict=True)
    ]


def decimate(time: NDArray[Any], value: Array, buckets: int = 420) -> tuple[NDArray[Any], Array]:
    """Thin a curve, shape (N,), NaN where undefined.

    The smallest and largest sample of each bucket stay, so that spikes remain.
    """
    count = len(time)
    if count <= 2 * buckets:
        return time, value
    low, high = (np.where(np.isnan(value), empty, value) for empty in (np.inf, -np.inf))
    parts = np.array_split(np.arange(count), buckets)
    rows = np.unique([(part[low[part].argmin()], part[high[part].argmax()]) for part in parts])
    return time[rows], value[rows]
