"""The page of a fit: measured and explained curves of the mean stride, and the tables."""

from collections.abc import Mapping, Sequence

import numpy as np

from ampm.geometry import Array
from validation.judge.fit import Strides
from validation.show.chart import DASHED, Picture, new_charts, numbered
from validation.show.page import render_page
from validation.show.style import COMMAND, FAINT, MEASURED, PLAN, SHADE
from validation.table import Table

_MODELS = {"pendulum": ("plain pendulum", FAINT), "rolling": ("rolling ZMP", COMMAND), "ampm": ("AMPM", PLAN)}
_CURVES = (
    ("zmp", 0, "ZMP along x, less the COM's mean motion"),
    ("zmp", 1, "ZMP along y, less the COM's mean"),
    ("force", 0, "ground force along x"),
    ("force", 1, "ground force along y"),
    ("force", 2, "ground force along z"),
    ("momentum", 1, "angular momentum about y, less its mean"),
    ("momentum", 0, "angular momentum about x, less its mean"),
)
"""Signal, axis and title."""


def fit_page(
    name: str,
    sentence: str,
    strides: Strides,
    told: Mapping[str, Mapping[str, Array]],
    tables: Sequence[Table],
) -> str:
    """A complete HTML document.

    Args:
        name: of the log.
        sentence: what was found.
        strides: measured.
        told: what every model says of them.
        tables: below the pictures.
    """
    return render_page(
        "fit.html.j2",
        f"AMPM fitted to {name}",
        styles=["report.css"],
        sentence=sentence,
        keys=[("measured", MEASURED), *_MODELS.values()],
        pictures=numbered(_picture(strides, told, *curve) for curve in _CURVES),
        tables=tables,
    )


def _picture(
    strides: Strides, told: Mapping[str, Mapping[str, Array]], group: str, k: int, title: str
) -> Picture:
    """One signal over the mean stride."""
    units = {"zmp": (1e3, "mm"), "force": (100.0 / strides.weight, "% BW"), "momentum": (1.0, "N m s")}
    scale, unit = units[group]
    ends = np.append(0.0, np.cumsum(strides.durations.mean(axis=0)))
    points = strides.zmp.shape[2]
    time = (ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(points) + 0.5) / points).ravel()
    motion = np.zeros((len(strides), time.size))
    if group == "zmp":
        motion += strides.com[..., k].mean(axis=(1, 2))[:, None]
    if group == "zmp" and k == 0:
        motion += (np.ptp(strides.way, axis=1) / ends[-1])[:, None] * (time - time.mean())

    def drawn(values: Array) -> Array:
        return scale * (values[..., k].reshape(len(strides), -1) - motion)

    chart = new_charts(2.6)[0]
    chart.title, chart.xlabel, chart.ylabel = title, "time from the start of left single support [s]", unit
    curves = drawn(strides.measured[group])
    low, high = np.quantile(curves, (0.025, 0.975), axis=0)
    chart.band(time, low, high, MEASURED, opacity=0.25)
    chart.line(time, curves.mean(axis=0), MEASURED, 2.2)
    for model, (_, color) in _MODELS.items():
        dash = "" if model == "ampm" else DASHED
        chart.line(time, drawn(told[model][group]).mean(axis=0), color, 1.2, dash=dash)
    for double in (ends[1:3], ends[3:5]):
        chart.area(np.repeat(double, 2), (-np.inf, np.inf, np.inf, -np.inf), SHADE, below=True)
    return Picture([chart], title)
