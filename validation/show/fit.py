"""The page of a fit: measured and explained curves of the mean stride, and the tables."""

from collections.abc import Sequence

import numpy as np

from ampm.geometry import Array
from validation.judge.compare import SIGNALS
from validation.judge.fit import EXPLAINED, Strides, explained
from validation.judge.metrics import display_unit
from validation.show.chart import DASHED, Picture, new_charts, numbered
from validation.show.page import render_page
from validation.show.style import COMMAND, FAINT, MEASURED, PLAN, SHADE
from validation.table import Table, short_unit

LOOKS = {"pendulum": ("resting ZMP", FAINT), "rolling": ("rolling ZMP", COMMAND), "ampm": ("AMPM", PLAN)}
"""Name and colour of the models of :mod:`validation.judge.fit`."""
_FROM = {"zmp": ", from the COM", "angular_momentum": ", less its mean"}


def fit_page(name: str, sentence: str, strides: Strides, tables: Sequence[Table]) -> str:
    """A complete HTML document on a log: what was found in a sentence, pictures, and tables below them."""
    fits = explained(strides)
    return render_page(
        "curves.html.j2",
        f"AMPM fitted to {name}",
        sentence=sentence,
        keys=[("measured", MEASURED), *LOOKS.values()],
        key_note="means over the strides; each stride is explained by the constants of the others; shade: "
        "95 % of the strides; grey: double support; dashed: no angular momentum",
        runs=[],
        citations=[],
        pictures=numbered(draw_fit(strides, fits, column) for column in range(len(EXPLAINED))),
        tables=tables,
    )


def draw_fit(strides: Strides, fits: dict[str, Array], column: int) -> Picture:
    """One signal over the mean stride, measured and by all models."""
    signal = SIGNALS[EXPLAINED[column]]
    scale, unit = display_unit(signal.unit, strides.weight)
    is_zmp = signal.group == "zmp"
    ends = np.append(0.0, np.cumsum(strides.durations.mean(axis=0)))
    shares = (np.arange(strides.com.shape[2]) + 0.5) / strides.com.shape[2]
    time = (ends[:-1, None] + np.outer(np.diff(ends), shares)).ravel()

    def drawn(values: Array) -> Array:
        return scale * (values[..., column] - is_zmp * strides.com[..., column % 3]).reshape(len(strides), -1)

    title = f"{signal.label[0].upper()}{signal.label[1:]}{_FROM.get(signal.group, '')}"
    (chart,) = charts = new_charts(2.6)
    chart.name(title, f"[{short_unit(unit)}]", "time from the start of left single support [s]")
    measured = drawn(strides.signals)
    low, high = np.quantile(measured, (0.025, 0.975), axis=0)
    chart.band(time, low, high, MEASURED, opacity=0.25)
    chart.line(time, measured.mean(axis=0), MEASURED, 2.2)
    for model, (_, color) in LOOKS.items():
        chart.line(time, drawn(fits[model]).mean(axis=0), color, 1.2, dash="" if model == "ampm" else DASHED)
    for begin in (1, 3):  # of the double supports
        chart.shade(ends[begin], ends[begin + 1], SHADE)
    return Picture(charts, title)
