"""An observation as columns, as a picture, and as words for a terminal or a report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from validation.measure.instruments.names import CAUSES, RUN, WINDOWS
from validation.measure.instruments.result import Observation

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Row = tuple[str, str, str, str, str]

WINDOW_NAMES = dict(zip(WINDOWS, ("whole walk", "one foot on the floor", "both feet"), strict=True))


def observation_columns(seen: Observation) -> dict[str, NDArray[Any]]:
    """Columns of ``instrument.parquet``: truth and what the instrument shows, at every step, SI units."""
    columns: dict[str, NDArray[Any]] = {"time": seen.time}
    for name, values in (
        ("true_zmp", seen.true_zmp),
        ("instrument_zmp", seen.zmp),
        ("instrument_zmp_compensated", seen.zmp_compensated),
        ("instrument_force", seen.force),
    ):
        for index, axis in enumerate("xyz"[: values.shape[1]]):
            columns[f"{name}_{axis}"] = values[:, index]
    for index, name in enumerate(seen.names):
        columns[f"true_{name}"] = seen.signals[:, index]
        columns[f"reading_{name}"] = seen.readings[:, index]
    return columns


def error_rows(seen: Mapping[str, Any]) -> list[Row]:
    """Label, RMSE x and y, largest x and y [mm], of the error.

    Args:
        seen: an observation as :meth:`Observation.as_dict` or a ``summary.json`` has it.
    """
    rows = [_row(words, seen["zmp_error"][window]) for window, words in WINDOW_NAMES.items()]
    rows.append(_row("whole walk, latency taken out", seen["zmp_error_delay_compensated"][RUN]))
    rows.append(_row("whole walk, beyond the method", seen["zmp_error_of_readings"][RUN]))
    return rows


def cause_rows(seen: Mapping[str, Any]) -> list[Row]:
    """The same of every cause alone over the whole walk, the largest first."""
    ordered = sorted(seen["causes"].items(), key=lambda item: -_size(item[1][RUN]))
    return [_row(CAUSES.get(cause, cause), windows[RUN]) for cause, windows in ordered]


def _size(item: Mapping[str, Any]) -> float:
    x, y = item["rmse"]
    return math.hypot(x, y) if _known(x) and _known(y) else -1.0


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def _row(label: str, item: Mapping[str, Any]) -> Row:
    values = (*item["rmse"], *item["maximum"])
    x, y, most_x, most_y = (f"{1e3 * value:.3g}" if _known(value) else "-" for value in values)
    return label, x, y, most_x, most_y


def draw(seen: Observation, *, steps_shown: float = 2.4) -> Figure:
    """True and instrument's ZMP over the middle of the walk, the error, and its causes.

    Args:
        seen: what is drawn.
        steps_shown: length of the piece [s].
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.2), layout="constrained")
    axes = figure.subplots(3, 2, height_ratios=[3, 2, 2])
    time = seen.time
    middle = 0.5 * (time[0] + time[-1]) if len(time) else 0.0
    rows = np.abs(time - middle) <= 0.5 * steps_shown
    causes = sorted(seen.causes, key=lambda cause: _size(seen.causes[cause][RUN].as_dict()))
    for column, axis in enumerate("xy"):
        upper, lower, bars = axes[:, column]
        true = seen.true_zmp[rows, column]
        # Metres walked would flatten the curve: x is drawn less the mean way.
        way = np.polyval(np.polyfit(time[rows], np.nan_to_num(true), 1), time[rows]) if axis == "x" else 0.0
        upper.plot(time[rows], 1e3 * (true - way), color="0.2", lw=2.5, label="truth")
        for values, label, color in (
            (seen.zmp, "instrument", "tab:orange"),
            (seen.zmp_compensated, "latency taken out", "tab:blue"),
        ):
            upper.plot(time[rows], 1e3 * (values[rows, column] - way), color=color, lw=1.0, label=label)
            error = 1e3 * (values - seen.true_zmp)[rows, column]
            lower.plot(time[rows], error, color=color, lw=0.9)
        upper.set(title=f"ZMP {axis}" + (" about the mean way" if axis == "x" else ""), ylabel="[mm]")
        lower.set(xlabel="time [s]", ylabel="error [mm]")
        size = [1e3 * seen.causes[cause][RUN].rmse[column] for cause in causes]
        bars.barh([CAUSES[cause].partition(",")[0] for cause in causes], np.nan_to_num(size), color="0.55")
        bars.set(xlabel=f"RMS error in {axis} by one cause alone [mm]")
        bars.tick_params(axis="y", labelsize=8)
        for each in (upper, lower, bars):
            each.grid(alpha=0.3)
            each.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(loc="upper left", fontsize=8)
    figure.suptitle(f"{seen.instrument.name}: the ZMP that it shows")
    return figure
