"""The page of a fit: measured and explained curves of the mean stride, and the tables."""

from collections.abc import Sequence

import numpy as np

from ampm.geometry import Array
from validation.judge.fit import EXPLAINED, Strides, explained
from validation.judge.metric import display_unit
from validation.show.chart import DASHED, Picture, new_charts, numbered
from validation.show.page import render_page
from validation.show.style import COMMAND, FAINT, MEASURED, PLAN, SHADE
from validation.table import Table, short_unit

LABELS = {
    **{f"zmp_{axis}": f"ZMP along {axis}" for axis in "xy"},
    **{f"force_{axis}": f"ground force along {axis}" for axis in "xyz"},
    **{f"momentum_{axis}": f"angular momentum about {axis}" for axis in "yx"},
}
"""Signals in the order of the page."""
_LESS = {"zmp_x": "the COM's mean motion", "zmp_y": "the COM's mean"}
_LESS |= dict.fromkeys(("momentum_x", "momentum_y"), "its mean")
_MODELS = {"pendulum": ("plain pendulum", FAINT), "rolling": ("rolling ZMP", COMMAND), "ampm": ("AMPM", PLAN)}


def shown_in(signal: str, weight: float) -> tuple[float, str]:
    """Factor and unit in which a signal of a body with a weight [N] is shown."""
    factor, unit = display_unit({"z": "m", "f": "N", "m": "N m s"}[signal[0]], weight)
    return factor, short_unit(unit)


def fit_page(name: str, sentence: str, strides: Strides, tables: Sequence[Table]) -> str:
    """A complete HTML document on a log: what was found in a sentence, pictures, and tables below them."""
    told = explained(strides)
    return render_page(
        "curves.html.j2",
        f"AMPM fitted to {name}",
        styles=["report.css"],
        sentence=sentence,
        keys=[("measured", MEASURED), *_MODELS.values()],
        key_note="means over the strides; each stride is explained by the constants of the others; shade: "
        "95 % of the strides; grey: double support",
        runs=[],
        citations=[],
        pictures=numbered(_picture(strides, told, signal) for signal in LABELS),
        tables=tables,
    )


def _picture(strides: Strides, told: dict[str, Array], signal: str) -> Picture:
    """One signal over the mean stride, measured and by all models."""
    column, (scale, unit) = EXPLAINED.index(signal), shown_in(signal, strides.weight)
    ends = np.append(0.0, np.cumsum(strides.durations.mean(axis=0)))
    points = strides.com.shape[2]
    time = (ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(points) + 0.5) / points).ravel()
    motion = np.zeros((len(strides), time.size))
    if signal.startswith("zmp"):
        motion += strides.com[..., column].mean(axis=(1, 2))[:, None]
    if signal == "zmp_x":
        motion += (np.ptp(strides.way, axis=1) / ends[-1])[:, None] * (time - time.mean())

    def drawn(values: Array) -> Array:
        return scale * (values[..., column].reshape(len(strides), -1) - motion)

    title = ", less ".join(filter(None, (LABELS[signal], _LESS.get(signal))))
    chart = new_charts(2.6)[0]
    chart.name(title, unit, "time from the start of left single support [s]")
    measured = drawn(strides.signals)
    low, high = np.quantile(measured, (0.025, 0.975), axis=0)
    chart.band(time, low, high, MEASURED, opacity=0.25)
    chart.line(time, measured.mean(axis=0), MEASURED, 2.2)
    for model, (_, color) in _MODELS.items():
        chart.line(time, drawn(told[model]).mean(axis=0), color, 1.2, dash="" if model == "ampm" else DASHED)
    for begin in (1, 3):  # of the double supports
        chart.shade(ends[begin], ends[begin + 1], SHADE)
    return Picture([chart], title)
