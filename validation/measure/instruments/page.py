"""What an instrument shows of a run, for its report: from the run's folder alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq
from markupsafe import Markup

from validation.measure.instruments.table import cause_rows, error_rows
from validation.show import run_figures as figures
from validation.store.folders import INSTRUMENT_FILE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from validation.store.saved import SavedRun

_MEANINGS = {
    "force-plate": "A model of force plates, one under every footstep, reads the floor's force on the feet.",
    "foot-ft": "A model of force/torque sensors in the ankles reads what the feet pass on to the legs.",
    "imu": "A model of an IMU; its ZMP is that of a point mass at the true COM which accelerates as the IMU.",
}


@dataclass(frozen=True)
class _Picture:
    svg: Markup
    caption: str


def instrument_section(saved: SavedRun) -> dict[str, Any]:
    """Words, tables and pictures of the section; pictures only if the run has its instrument's signals."""
    seen = saved.summary["instrument"]
    latency = seen["latency"]["value"]
    error = seen["zmp_error"]["run"]
    return {
        "name": seen["name"],
        "meaning": _MEANINGS.get(seen["kind"], ""),
        "latency": f"{1e3 * latency:.3g}\u00a0ms",
        "unmeasured": error["unmeasured"],
        "notes": seen["notes"],
        "pictures": _pictures(saved),
        "tables": [
            ("Error that it adds to the ZMP", error_rows(seen)),
            ("Each cause alone", cause_rows(seen)),
        ],
    }


def _pictures(saved: SavedRun) -> list[_Picture]:
    path = saved.directory / INSTRUMENT_FILE
    if not path.is_file() or len(saved.signals) < 2:
        return []
    axes = "xy"
    names = [f"{name}_{axis}" for axis in axes for name in ("true_zmp", "instrument_zmp")]
    table = pq.read_table(path, columns=[*names, *(f"instrument_zmp_compensated_{axis}" for axis in axes)])
    pictures = []
    with figures.style():
        for axis in axes:
            true = table[f"true_zmp_{axis}"].to_numpy()
            errors = {
                "as read": 1e3 * (table[f"instrument_zmp_{axis}"].to_numpy() - true),
                "latency taken out": 1e3 * (table[f"instrument_zmp_compensated_{axis}"].to_numpy() - true),
            }
            figure = _errors(saved, errors, f"ZMP {axis}: instrument \u2212 truth")
            label = f"Error that the instrument adds to the ZMP in {axis}"
            pictures.append(_Picture(Markup(figures.to_svg(figure, f"instrument-{axis}", label)), ""))
    return pictures


def _errors(saved: SavedRun, errors: dict[str, Any], title: str) -> Figure:
    """Errors over one stride from the middle of the walk."""
    signals = saved.signals
    window = figures.middle(signals)
    figure, (axis,) = figures.new_figure(2.4)
    figures.shade_double_support(axis, signals, window)
    axis.axhline(0.0, color=figures.FAINT, linewidth=0.7)
    for (label, values), color in zip(errors.items(), (figures.MEASURED, figures.PLAN), strict=True):
        rows = slice(window.first, min(window.last, len(values)))
        axis.plot(signals.time[rows], np.asarray(values)[rows], color=color, linewidth=0.9, label=label)
    axis.set_ylabel("[mm]")
    axis.set_xlabel("time [s]")
    axis.set_title(title)
    axis.margins(x=0)
    axis.legend(loc="lower right", bbox_to_anchor=(1.01, 1.0), ncols=2, borderaxespad=0.2, handlelength=1.2)
    return figure
