"""Lines, areas and words of a picture, and their two writers: SVG for pages and files, PGF for LaTeX."""

import base64
import io
import math
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from ampm.geometry import Array
from validation.show.style import INK
from validation.table import tex

FONT = "DejaVu Sans"
"""Font of files; it comes with matplotlib, so that it is the same everywhere. Pages take the reader's own."""


class Mark(NamedTuple):
    """A curve or an area."""

    points: Array  # shape (N, 2), from the upper left corner of the picture [pt]; NaN interrupts a curve
    stroke: str  # colour of the line; empty for none
    width: float = 0.6  # of the line [pt]
    fill: str = ""  # colour of the area; empty for none
    dash: tuple[float, ...] = ()  # lengths of dashes and gaps [pt]
    opacity: float = 1.0  # [1]
    round: bool = False  # whether every point is a dot
    window: tuple[float, ...] = ()  # left, top, width, height [pt], beyond which nothing is drawn
    label: str = ""  # in the legend of a chart; empty for none


class Word(NamedTuple):
    """A text, of one line or several."""

    x: float  # of the first base line, from the upper left corner of the picture [pt]
    y: float  # likewise
    text: str  # to be written
    size: float = 9.0  # of the letters [pt]
    anchor: str = "start"  # which part of it is at x: start, middle or end
    turned: bool = False  # whether it is read upwards


def svg(items: Iterable[Mark | Word], width: float, height: float, *, embed: bool = False) -> str:
    """A picture of a width and height [pt] as SVG, the lowest item first; ``embed`` puts its letters in."""
    items = list(items)
    parts = []
    for number, (window, inside) in enumerate(groupby(items, lambda item: getattr(item, "window", ()))):
        drawn = "".join(_word(item) if isinstance(item, Word) else _path(item) for item in inside)
        if window:
            x, y, w, h = window
            frame = f'<clipPath id="w{number}"><path d="M{x:g} {y:g}h{w:g}v{h:g}h{-w:g}z"/></clipPath>'
            drawn = f'{frame}<g clip-path="url(#w{number})" stroke-linejoin="round">{drawn}</g>'
        parts.append(drawn)
    letters = "".join(item.text for item in items if isinstance(item, Word))
    face = f"<style>{_font_face(letters)}</style>" if embed else ""
    size = f'width="{width:g}pt" height="{height:g}pt" viewBox="0 0 {width:g} {height:g}"'
    font = f'font-family="{f"{FONT}, " if embed else ""}sans-serif" fill="{INK}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {font}>{face}{"".join(parts)}</svg>'


def _path(mark: Mark) -> str:
    words, pen = [], "M"
    for x, y in mark.points.round(1).tolist():
        if math.isnan(x) or math.isnan(y):
            pen = "M"
        else:  # a line without length is no dot for every renderer
            words.append(f"M{x:g} {y:g}h.01" if mark.round else f"{pen}{x:g} {y:g}")
            pen = "L"
    style = f' fill="{mark.fill or "none"}"'
    if mark.stroke:
        style += f' stroke="{mark.stroke}" stroke-width="{mark.width:g}"'
    if mark.dash:
        style += f' stroke-dasharray="{" ".join(f"{part:.3g}" for part in mark.dash)}"'
    style += ' stroke-linecap="round"' * mark.round
    style += f' opacity="{mark.opacity:g}"' * (mark.opacity < 1.0)
    return f'<path d="{"".join(words)}"{style}/>'


def _word(word: Word) -> str:
    first, *lines = word.text.split("\n")
    more = "".join(f'<tspan x="{word.x:.1f}" dy="1.15em">{escape(line)}</tspan>' for line in lines)
    style = f'font-size="{word.size:g}" text-anchor="{word.anchor}"'
    if word.turned:
        style += f' transform="rotate(-90 {word.x:.1f} {word.y:.1f})"'
    return f'<text x="{word.x:.1f}" y="{word.y:.1f}" {style}>{escape(first)}{more}</text>'


def font_folder() -> Path:
    """Folder of the font of files."""
    from matplotlib import get_data_path  # slow to load, and pages do without

    return Path(get_data_path(), "fonts", "ttf")


def _font_face(text: str) -> str:
    """The font of files with the letters of a text alone, as a rule of CSS."""
    # Imported here: slow to load, and pages do without.
    from fontTools.subset import Options, Subsetter
    from fontTools.ttLib import TTFont

    font, buffer = TTFont(font_folder() / "DejaVuSans.ttf", recalcTimestamp=False), io.BytesIO()
    subset = Subsetter(Options(drop_tables=[*Options().drop_tables, "FFTM"]))
    subset.populate(text=text)
    subset.subset(font)
    font.save(buffer)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f"@font-face{{font-family:'{FONT}';src:url(data:font/ttf;base64,{data})}}"


def pgf(items: Sequence[Mark | Word], width: float, height: float) -> str:
    """A picture as PGF for a LaTeX document that uses the package pgf; letters are of its font."""
    lines = [
        r"\begingroup\begin{pgfpicture}",
        rf"\pgfpathrectangle{{\pgfpointorigin}}{{\pgfqpoint{{{width:g}bp}}{{{height:g}bp}}}}",
        r"\pgfusepath{use as bounding box}",
    ]
    for item in items:
        if isinstance(item, Word):
            lines += _pgf_word(item, height)
        else:
            lines += [r"\begin{pgfscope}", *_pgf_path(item, height), r"\end{pgfscope}"]
    return "\n".join([*lines, r"\end{pgfpicture}\endgroup", ""])


def _pgf_word(word: Word, height: float) -> Iterable[str]:
    side = {"start": "left,", "middle": "", "end": "right,"}[word.anchor]
    turned = ",rotate=90" * word.turned
    for row, line in enumerate(word.text.split("\n")):
        x, y = word.x, height - word.y - 1.15 * word.size * row
        font = rf"\fontsize{{{word.size:g}}}{{{1.2 * word.size:g}}}\selectfont"
        yield rf"\pgftext[x={x:.1f}bp,y={y:.1f}bp,{side}base{turned}]{{{font} {tex(line)}}}"


def _pgf_path(mark: Mark, height: float) -> Iterable[str]:
    def point(x: float, y: float) -> str:
        return rf"\pgfqpoint{{{x:.1f}bp}}{{{y:.1f}bp}}"

    if mark.window:
        x, y, w, h = mark.window
        yield rf"\pgfpathrectangle{{{point(x, height - y - h)}}}{{{point(w, h)}}}\pgfusepath{{clip}}"
    roles = {role: color for role, color in (("stroke", mark.stroke), ("fill", mark.fill)) if color}
    for role, color in roles.items():
        red, green, blue = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
        yield rf"\definecolor{{ampm}}{{rgb}}{{{red:.3g},{green:.3g},{blue:.3g}}}"
        yield rf"\pgfset{role}color{{ampm}}\pgfset{role}opacity{{{mark.opacity:g}}}"
    dash = "".join(f"{{{part:.3g}bp}}" for part in mark.dash)
    yield rf"\pgfsetlinewidth{{{mark.width:g}bp}}\pgfsetdash{{{dash}}}{{0pt}}\pgfsetroundjoin"
    if mark.round:
        yield r"\pgfsetroundcap"
    pen = "moveto"
    for x, y in mark.points.tolist():
        if math.isnan(x) or math.isnan(y):
            pen = "moveto"
        else:
            yield rf"\pgfpath{pen}{{{point(x, height - y)}}}"
            pen = "lineto"
            if mark.round:
                yield rf"\pgfpathlineto{{{point(x, height - y)}}}"
                pen = "moveto"
    yield rf"\pgfusepath{{{','.join(roles)}}}"
