"""The page of a fit: measured and explained curves of the mean stride, and the tables."""

from collections.abc import Mapping, Sequence

import numpy as np

from ampm.geometry import Array
from validation.judge.fit import Strides
from validation.show.chart import DASHED, Chart, Picture, new_charts, picture
from validation.show.page import render_page
from validation.show.style import COMMAND, FAINT, MEASURED, PLAN, SHADE
from validation.table import Table

_COLORS = {"pendulum": FAINT, "rolling": COMMAND, "ampm": PLAN}
_KEYS = {"pendulum": "plain pendulum", "rolling": "rolling ZMP", "ampm": "AMPM", "measured": "measured"}


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
    keys = [(_KEYS[key], color) for key, color in (_COLORS | {"measured": MEASURED}).items()]
    measured = {"zmp": strides.zmp, "force": strides.force, "momentum": strides.momentum}
    pictures = [
        _curves(strides, measured, told, group, k, label)
        for group, k, label in (
            ("zmp", 0, "ZMP along x, less the COM's mean motion"),
            ("zmp", 1, "ZMP along y, less the COM's mean"),
            ("force", 0, "ground force along x"),
            ("force", 1, "ground force along y"),
            ("force", 2, "ground force along z"),
            ("momentum", 1, "angular momentum about y, less its mean"),
            ("momentum", 0, "angular momentum about x, less its mean"),
        )
    ]
    context = {"sentence": sentence, "keys": keys, "pictures": pictures, "tables": tables}
    return render_page("fit.html.j2", f"AMPM fitted to {name}", styles=["report.css"], **context)


def _curves(
    strides: Strides,
    measured: Mapping[str, Array],
    told: Mapping[str, Mapping[str, Array]],
    group: str,
    k: int,
    label: str,
) -> Picture:
    """One signal over the mean stride."""
    scale, unit = {"zmp": (1e3, "mm"), "force": (100.0 / strides.weight, "% BW"), "momentum": (1.0, "N m s")}[
        group
    ]
    ends = np.append(0.0, np.cumsum(strides.durations.mean(axis=0)))
    points = measured[group].shape[2]
    time = (ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(points) + 0.5) / points).ravel()
    motion = np.zeros((len(strides), time.size))
    if group == "zmp":
        motion += strides.com[..., k].mean(axis=(1, 2))[:, None]
    if group == "zmp" and k == 0:
        motion += ((strides.way[:, 4] - strides.way[:, 0]) / ends[-1])[:, None] * (time - time.mean())

    def drawn(values: Array) -> Array:
        return scale * (values[..., k].reshape(len(strides), -1) - motion)

    chart: Chart = new_charts(2.6)[0]
    chart.title, chart.xlabel, chart.ylabel = label, "time from the start of left single support [s]", unit
    curve = drawn(measured[group])
    low, high = np.quantile(curve, (0.025, 0.975), axis=0)
    chart.band(time, low, high, MEASURED, opacity=0.25)
    chart.line(time, curve.mean(axis=0), MEASURED, 2.2)
    for model, color in _COLORS.items():
        chart.line(
            time, drawn(told[model][group]).mean(axis=0), color, 1.2, dash="" if model == "ampm" else DASHED
        )
    for start in (1, 3):
        chart.area(
            ends[[start, start, start + 1, start + 1]], (-np.inf, np.inf, np.inf, -np.inf), SHADE, below=True
        )
    return picture([chart], label)
