"""Readings of an instrument: rows of tables, section of a report, picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from validation.measure.instruments.names import CAUSES, RUN, WINDOWS
from validation.show import style

if TYPE_CHECKING:
    from validation.measure.instruments.observe import Observation
    from validation.store.saved import SavedRun

Row = tuple[str, str, str, str, str]
WINDOW_NAMES = dict(zip(WINDOWS, ("whole walk", "one foot on the floor", "both feet"), strict=True))

_MEANINGS = {
    "force-plate": "A model of force plates, one under every footstep, reads the floor's force on the feet.",
    "foot-ft": "A model of force/torque sensors in the ankles reads what the feet pass on to the legs.",
    "imu": "A model of an IMU; its ZMP is that of a point mass at the true COM which accelerates as the IMU.",
}


def instrument_section(saved: SavedRun) -> dict[str, Any]:
    """Text and tables of the section of a report."""
    observed = saved.summary["instrument"]
    latency = observed["latency"]["value"]
    error = observed["zmp_error"]["run"]
    return {
        "name": observed["name"],
        "meaning": _MEANINGS.get(observed["kind"], ""),
        "latency": f"{1e3 * latency:.3g}\u00a0ms",
        "unmeasured": error["unmeasured"],
        "notes": observed["notes"],
        "tables": [
            ("Error that it adds to the ZMP", error_rows(observed)),
            ("Each cause alone", cause_rows(observed)),
        ],
    }


def error_rows(observed: Mapping[str, Any]) -> list[Row]:
    """Label, RMSE x and y, largest x and y [mm], of the error.

    Args:
        observed: an observation as :meth:`Observation.as_dict` or a ``summary.json`` has it.
    """
    rows = [_row(words, observed["zmp_error"][window]) for window, words in WINDOW_NAMES.items()]
    rows.append(_row("whole walk, latency taken out", observed["zmp_error_delay_compensated"][RUN]))
    rows.append(_row("whole walk, beyond the method", observed["zmp_error_of_readings"][RUN]))
    return rows


def cause_rows(observed: Mapping[str, Any]) -> list[Row]:
    """The same of every cause alone over the whole walk, the largest first."""
    ordered = sorted(observed["causes"].items(), key=lambda item: -_size(item[1][RUN]))
    return [_row(CAUSES.get(cause, cause), windows[RUN]) for cause, windows in ordered]


def _numbers(values: Sequence[float | None]) -> list[float]:
    """Numbers with NaN for unmeasured ones, which are None in a ``summary.json``."""
    return [math.nan if value is None else value for value in values]


def _size(item: Mapping[str, Any]) -> float:
    """RMSE in the floor plane [m]; -1 where nothing was measured."""
    size = math.hypot(*_numbers(item["rmse"]))
    return size if math.isfinite(size) else -1.0


def _row(label: str, item: Mapping[str, Any]) -> Row:
    values = _numbers((*item["rmse"], *item["maximum"]))
    x, y, most_x, most_y = (f"{1e3 * value:.3g}" if math.isfinite(value) else "–" for value in values)
    return label, x, y, most_x, most_y


@style.into_file
def draw(observed: Observation) -> Figure:
    """Draw true and instrument's ZMP over the middle of the walk, the error, and its causes."""
    figure = Figure(figsize=(9.0, 7.2), dpi=130, layout="constrained")
    axes = figure.subplots(3, 2, height_ratios=[3, 2, 2])
    time = observed.time
    middle = 0.5 * (time[0] + time[-1]) if len(time) else 0.0
    rows = np.abs(time - middle) <= 1.2  # [s]
    causes = sorted(observed.causes, key=lambda cause: _size(vars(observed.causes[cause][RUN])))
    for column, axis in enumerate("xy"):
        upper, lower, bars = axes[:, column]
        true = observed.true_zmp[rows, column]
        # Without the mean travel, which would flatten the curve.
        way = np.polyval(np.polyfit(time[rows], np.nan_to_num(true), 1), time[rows]) if axis == "x" else 0.0
        upper.plot(time[rows], 1e3 * (true - way), color="0.2", lw=2.5, label="truth")
        for values, label, color in (
            (observed.zmp, "instrument", "tab:orange"),
            (observed.zmp_compensated, "latency taken out", "tab:blue"),
        ):
            upper.plot(time[rows], 1e3 * (values[rows, column] - way), color=color, lw=1.0, label=label)
            error = 1e3 * (values - observed.true_zmp)[rows, column]
            lower.plot(time[rows], error, color=color, lw=0.9)
        upper.set(title=f"ZMP {axis}" + (" about the mean way" if axis == "x" else ""), ylabel="[mm]")
        lower.set(xlabel="time [s]", ylabel="error [mm]")
        size = [1e3 * observed.causes[cause][RUN].rmse[column] for cause in causes]
        bars.barh([CAUSES[cause].partition(",")[0] for cause in causes], np.nan_to_num(size), color="0.55")
        bars.set(xlabel=f"RMS error in {axis} by one cause alone [mm]")
        style.legend(upper)
    figure.suptitle(f"{observed.instrument.name}: the ZMP that it shows")
    return figure
