"""Quantities that two walks are compared by, all from stored signals: smaller is better.

``ampm convergence`` studies those about the switches of support, too.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.judge.metrics import METRICS, display_unit, rms
from validation.store.record import StoredRecord
from validation.store.signals import Signals
from validation.trial.record import SimulationRecord

WINDOW = 0.05
"""Half-width of the window about a switch [s]."""
ACROSS = 0.02
"""Interval on either side of a switch over which the ground force is averaged for its change [s]."""


class Quantity(NamedTuple):
    """One quantity of a walk.

    Attributes:
        group: heading that it stands under.
        name: key in JSON; of a metric its name.
        label: in words.
        unit: as shown.
        extreme: whether it is a largest value.
    """

    group: str
    name: str
    label: str
    unit: str
    extreme: bool = False

    @property
    def studied_name(self) -> str:
        """Name in ``convergence.json``."""
        return self.name if self.name in METRICS else f"switch_{self.name}"

    def si_unit(self, weight: float) -> tuple[float, str]:
        """SI value of ``unit``, and the SI unit.

        Args:
            weight: of the body [N].
        """
        table = {
            "mm": (1e-3, "m"),
            "% of body weight": (1e-2 * weight, "N"),
            "body weights/s": (weight, "N/s"),
            "N m/ms": (1e3, "N m/s"),
            "m/s²": (1.0, "m/s^2"),
        }
        return table.get(self.unit, (1.0, self.unit))


RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1].

Perturbing the body's mass by 1e-15 to 1e-12 of itself moves every metric of `normal` and `momentum` that is
not rounding itself by less than 1e-9 of its value; this is a thousand times that.
"""
ABSOLUTE_FLOOR: Mapping[str, float] = {"m": 1e-11, "N": 1e-8, "N m s": 1e-10, "1": 1e-12}
"""The same in a metric's SI unit, for values near zero: ten times the largest observed effect of rounding."""


def rounding(size: Array | float, unit: str) -> Any:
    """Difference between two values that may be rounding.

    Args:
        size: of the values, in SI units.
        unit: SI unit.
    """
    return np.fmax(RELATIVE_FLOOR * np.abs(size), ABSOLUTE_FLOOR.get(unit, 0.0))


JUDGED, OTHER = "judged metrics", "cost"
_COSTS = ("margin_torque", "margin_friction", "margin_slip", "energy_cost_of_transport")
_PLAN = "jump of the plan at a switch, largest"
PLAN = (
    Quantity(_PLAN, "plan_acceleration", "COM acceleration", "m/s²", True),
    Quantity(_PLAN, "plan_zmp", "ZMP", "mm", True),
    Quantity(_PLAN, "plan_moment", "moment about the COM", "N m", True),
)
"""Quantities of the plan alone."""
_NEAR = f"{1e3 * WINDOW:g} ms"
_CHANGE = f"COM acceleration, mean of {1e3 * ACROSS:g} ms after less before"
_FORCE = f"ground force within {_NEAR} of a switch, median over switches"
_ZMP, _TORQUE, _EFFORT = "ZMP error", "torque rates", "feedback: command minus plan"
SWITCH = (
    Quantity(_FORCE, "planned_change", f"{_CHANGE}: planned", "m/s²"),
    Quantity(_FORCE, "measured_change", f"{_CHANGE}: measured", "m/s²"),
    Quantity(_FORCE, "force_rate", "fastest change of the horizontal force", "body weights/s", True),
    Quantity(_FORCE, "vertical_force", "largest error of the vertical force", "% of body weight", True),
    Quantity(_ZMP, "zmp_x_near", f"x, RMSE within {_NEAR} of a switch", "mm"),
    Quantity(_ZMP, "zmp_x_far", "x, RMSE elsewhere", "mm"),
    Quantity(_ZMP, "zmp_y_near", f"y, RMSE within {_NEAR} of a switch", "mm"),
    Quantity(_ZMP, "zmp_y_far", "y, RMSE elsewhere", "mm"),
    Quantity(_TORQUE, "torque_rate_peak", f"fastest joint within {_NEAR}, median", "N m/ms", True),
    Quantity(_TORQUE, "torque_rate_near", f"RMS of all joints within {_NEAR}", "N m/ms"),
    Quantity(_TORQUE, "torque_rate_far", "RMS of all joints elsewhere", "N m/ms"),
    Quantity(_EFFORT, "effort_zmp_near", f"ZMP, RMS within {_NEAR}", "mm"),
    Quantity(_EFFORT, "effort_zmp_far", "ZMP, RMS elsewhere", "mm"),
    Quantity(_EFFORT, "effort_force_near", f"horizontal force, RMS within {_NEAR}", "% of body weight"),
)
"""Quantities about the switches that only a comparison reports."""


def metric_entry(summary: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Value and tolerance of a metric in ``summary.json``; empty where it has none."""
    section = METRICS[name].section
    entry = summary.get(section or "metrics", {}).get(name.partition("_")[2] if section else name)
    return entry if isinstance(entry, Mapping) else {"value": entry}


def metric_limit(summary: Mapping[str, Any], name: str) -> float | None:
    """Tolerance of a metric in ``summary.json``, as shown; None if it is not judged."""
    limit: float | None = metric_entry(summary, name).get("display", {}).get("tolerance")
    return limit


def metric_quantities(weight: float, *summaries: Mapping[str, Any]) -> list[Quantity]:
    """Metrics that one of the runs is judged by, and costs; without checks of the measurement itself.

    Args:
        weight: of the body [N].
        summaries: contents of ``summary.json``.
    """
    found = []
    for name, metric in METRICS.items():
        judged = any(metric_limit(summary, name) is not None for summary in summaries)
        if name in _COSTS or (judged and metric.kind != "instrument"):
            unit = display_unit(metric.unit, weight)[1]
            group = JUDGED if judged else OTHER
            found.append(Quantity(group, name, metric.label, unit, metric.nature == "extreme"))
    return found


def metric_values(summary: Mapping[str, Any], weight: float) -> dict[str, float]:
    """Values of all metrics in ``summary.json``, as shown; NaN where it has none."""
    found = {}
    for name, metric in METRICS.items():
        value = metric_entry(summary, name).get("value")
        found[name] = math.nan if value is None else display_unit(metric.unit, weight)[0] * value
    return found


def switch_rows(signals: Signals) -> NDArray[np.intp]:
    """First row after each planned switch of support, without the switches of the first step."""
    return signals.switches()[2:]


def plan_values(signals: Signals, mass: float) -> dict[str, float]:
    """Quantities of :data:`PLAN`, from the stored samples of the plan; NaN without a switch.

    Args:
        signals: of the walk.
        mass: of the body [kg].
    """
    rows = switch_rows(signals)
    rows = rows[(rows >= 3) & (rows < len(signals) - 2)]
    moment = np.diff(signals.vector("plan_angular_momentum", "xy"), axis=0) / np.diff(signals.time)[:, None]
    return {
        "plan_acceleration": _jump(signals.vector("plan_force") / mass, rows - 1, rows, 0.0),
        "plan_zmp": 1e3 * _jump(signals.vector("plan_zmp", "xy"), rows - 1, rows, 0.0),
        # Differences stand half a row later; that of the row before a switch mixes both sides.
        "plan_moment": _jump(moment, rows - 2, rows, 0.5),
    }


def _jump(values: Array, last: NDArray[np.intp], first: NDArray[np.intp], reach: float) -> float:
    """Largest jump of a sampled series between two rows, NaN without such rows.

    The switch lies somewhere between the rows. Both sides are extrapolated, in straight lines, to both ends
    of this interval. A continuous series has a zero between them, however its slope changes.

    Args:
        values: shape (n, axes).
        last: rows before the jumps, shape (switches,).
        first: rows after them.
        reach: from ``last`` to the interval, and from the interval to ``first`` [rows].
    """
    if not last.size:
        return math.nan
    slope_before, slope_after = values[last] - values[last - 1], values[first + 1] - values[first]
    begin = values[first] - (1.0 + reach) * slope_after - values[last] - reach * slope_before
    end = values[first] - reach * slope_after - values[last] - (1.0 + reach) * slope_before
    least = np.where(begin * end > 0.0, np.minimum(np.abs(begin), np.abs(end)), 0.0)
    return float(least.max())


def switch_values(signals: Signals, record: SimulationRecord | StoredRecord) -> dict[str, float]:
    """Quantities of :data:`SWITCH` in their shown units; NaN without a switch.

    Args:
        signals: plan, command and measurement on one clock.
        record: of the walk.
    """
    time, weight = signals.time, record.mass * record.gravity
    steps = np.round(time / record.time_step).astype(np.intp)
    dt = int(steps[1] - steps[0]) * record.time_step
    begin = signals.first_step()
    rows = switch_rows(signals)
    switches = time[rows[time[rows] < time[-1] - WINDOW]]
    distance = np.abs(time[:, None] - switches).min(axis=1, initial=np.inf)
    judged = np.arange(len(time)) >= begin
    windows = {"near": judged & (distance <= WINDOW), "far": judged & (distance > WINDOW)}

    def peak(series: Array) -> float:
        """Largest value about a switch, median over switches."""
        peaks = [np.nanmax(series[np.abs(time - switch) <= WINDOW]) for switch in switches]
        return float(np.median(peaks)) if peaks else math.nan

    def change(force: Array) -> float:
        """Change of the horizontal force at a switch over the mass, median over switches."""
        changes = []
        for switch in switches - 1e-9:
            before = (time >= switch - ACROSS) & (time < switch)
            after = (time >= switch) & (time < switch + ACROSS)
            changes.append(np.linalg.norm(force[after, :2].mean(axis=0) - force[before, :2].mean(axis=0)))
        return float(np.median(changes)) / record.mass if changes else math.nan

    measured, planned = signals.vector("measured_force"), signals.vector("plan_force")
    force_rate = np.linalg.norm(np.diff(measured[:, :2], axis=0, append=measured[-1:, :2]), axis=1) / dt
    torque = record.torque_at(steps)
    torque_rate = np.abs(np.diff(torque, axis=0, append=torque[-1:])) / dt / 1e3
    zmp = {name: signals.vector(f"{name}_zmp", "xy") for name in ("plan", "command", "measured")}
    error = 1e3 * (zmp["measured"] - zmp["plan"])
    push = signals.vector("command_force", "xy") - signals.vector("plan_force", "xy")
    of_joints = {"zmp_x": error[:, 0], "zmp_y": error[:, 1], "torque_rate": torque_rate}
    of_vectors = {"effort_zmp": 1e3 * (zmp["command"] - zmp["plan"]), "effort_force": 100.0 * push / weight}
    values = {
        "planned_change": change(planned),
        "measured_change": change(measured),
        "force_rate": peak(force_rate) / weight,
        "vertical_force": 100.0 * peak(np.abs(measured[:, 2] - planned[:, 2])) / weight,
        "torque_rate_peak": peak(torque_rate.max(axis=1)),
    }
    for where, inside in windows.items():
        values |= {f"{name}_{where}": rms(series[inside]) for name, series in of_joints.items()}
        values |= {f"{name}_{where}": rms(series[inside]) * 2**0.5 for name, series in of_vectors.items()}
    return {item.name: values[item.name] for item in SWITCH}
