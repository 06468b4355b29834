"""Quantities to compare two gaits by: about the switches of support, and metrics of the whole run.

The same quantities are followed by ``ampm convergence``, so that a difference between two gaits can be held
against the numerical uncertainty of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from validation.judge.metrics import METRICS, display_unit
from validation.judge.signals import signals_table
from validation.store.signals import Signals

if TYPE_CHECKING:
    from ampm.planner.support import StepPlan
    from validation.judge.compare import Comparison
    from validation.store.record import StoredRecord
    from validation.trial.record import SimulationRecord

Array = NDArray[np.float64]

WINDOW = 0.05
"""Half-width of the window about a switch [s]."""
ACROSS = 0.02
"""Interval on either side of a switch over which the ground force is averaged for its change [s]."""
GRIDS = (0.004, 0.002, 0.001)
"""Largest steps of the inverse kinematics' grid on which the jump of joint accelerations is taken [s]."""


class Quantity(NamedTuple):
    """One quantity of both gaits; smaller is better.

    Attributes:
        group: heading that it stands under.
        name: key in JSON; of a metric its name.
        label: in words.
        unit: as shown.
        least: values below it are noise [unit].
        walked: whether a simulation is in it; closed form, and the motion on a given grid, are not.
    """

    group: str
    name: str
    label: str
    unit: str
    least: float
    walked: bool = True

    @property
    def studied_name(self) -> str:
        """Name in ``convergence.json``."""
        return self.name if self.name in METRICS else f"switch_{self.name}"


_PLAN, _JOINTS = "jump at a switch: the plan", "jump at a switch: joint accelerations of the motion"
UNWALKED = (
    Quantity(_PLAN, "plan_acceleration", "COM acceleration", "m/s²", 1e-9, False),
    Quantity(_PLAN, "plan_force", "horizontal force", "% of body weight", 1e-9, False),
    Quantity(_PLAN, "plan_zmp", "ZMP", "mm", 1e-9, False),
    Quantity(_PLAN, "plan_moment", "moment about the COM", "N m", 1e-9, False),
    *(
        Quantity(_JOINTS, f"joint_{1e3 * h:g}ms", f"on a grid of {1e3 * h:g} ms", "rad/s²", 1.0, False)
        for h in GRIDS
    ),
    Quantity(_JOINTS, "joint_limit", "without a grid (extrapolated)", "rad/s²", 1.0, False),
)
_NEAR = f"{1e3 * WINDOW:g} ms"
_CHANGE = f"COM acceleration, mean of {1e3 * ACROSS:g} ms after less before"
_FORCE = f"measured ground force, within {_NEAR} of a switch (median over switches)"
_ZMP, _TORQUE, _EFFORT = "ZMP error", "torque rates", "feedback: command minus plan"
SWITCH = (
    Quantity(_FORCE, "planned_change", f"{_CHANGE}: planned", "m/s²", 0.01),
    Quantity(_FORCE, "measured_change", f"{_CHANGE}: measured", "m/s²", 0.01),
    Quantity(_FORCE, "force_rate", "fastest change of the horizontal force", "body weights/s", 0.1),
    Quantity(_FORCE, "vertical_force", "largest error of the vertical force", "% of body weight", 0.1),
    Quantity(_ZMP, "zmp_x_near", f"x, RMSE within {_NEAR} of a switch", "mm", 0.05),
    Quantity(_ZMP, "zmp_x_far", "x, RMSE elsewhere", "mm", 0.05),
    Quantity(_ZMP, "zmp_y_near", f"y, RMSE within {_NEAR} of a switch", "mm", 0.05),
    Quantity(_ZMP, "zmp_y_far", "y, RMSE elsewhere", "mm", 0.05),
    Quantity(_TORQUE, "torque_rate_peak", f"fastest joint within {_NEAR} (median over switches)", "N m/ms",
             0.1),
    Quantity(_TORQUE, "torque_rate_near", f"RMS of all joints within {_NEAR}", "N m/ms", 0.01),
    Quantity(_TORQUE, "torque_rate_far", "RMS of all joints elsewhere", "N m/ms", 0.01),
    Quantity(_EFFORT, "effort_zmp_near", f"ZMP, RMS within {_NEAR}", "mm", 0.05),
    Quantity(_EFFORT, "effort_zmp_far", "ZMP, RMS elsewhere", "mm", 0.05),
    Quantity(_EFFORT, "effort_force_near", f"horizontal force, RMS within {_NEAR}", "% of body weight", 0.01),
)  # fmt: skip
"""Quantities of a walk that only a comparison shows."""
_COSTS = {
    "margin_torque": 0.01,
    "margin_slip": 0.5e-3,
    "margin_friction": 0.05,
    "energy_cost_of_transport": 0.01,
    "failed_qp": 1.0,
}
"""Metrics beside the judged ones, and what is noise of them [SI unit]."""
_WHOLE = "the whole run"
_NOISE = 0.02
"""Share of a metric's tolerance below which its value is noise [1]."""


def si_unit(unit: str, weight: float) -> tuple[float, str]:
    """SI value of a shown unit, and the SI unit.

    Args:
        unit: as shown.
        weight: of the body [N].
    """
    table = {
        "mm": (1e-3, "m"),
        "% of body weight": (1e-2 * weight, "N"),
        "body weights/s": (weight, "N/s"),
        "N m/ms": (1e3, "N m/s"),
        "m/s²": (1.0, "m/s^2"),
    }
    return table.get(unit, (1.0, unit))


SWITCH_UNITS: Mapping[str, str] = {item.name: si_unit(item.unit, 1.0)[1] for item in SWITCH}
"""SI units of what only a comparison shows."""


def switch_values(walk: Comparison) -> dict[str, float]:
    """Quantities of :data:`SWITCH` in SI units."""
    table, record = signals_table(walk), walk.record
    signals = Signals({name: table.column(name).to_numpy() for name in table.column_names})
    values, weight = switch_quantities(walk.plan, signals, record), record.mass * record.gravity
    return {item.name: si_unit(item.unit, weight)[0] * values[item.name] for item in SWITCH}


def quantities(weight: float) -> Iterator[Quantity]:
    """Everything that is compared, in its order: the metrics are those that judge the walk, and what it cost.

    Args:
        weight: of the body [N].
    """
    yield from UNWALKED
    yield from SWITCH
    for metric in METRICS.values():
        factor, unit = display_unit(metric.unit, weight)
        if metric.name in _COSTS:
            least = factor * _COSTS[metric.name]
        elif metric.kind != "instrument" and metric.tolerances:
            # Limits on forces are shares of the body's weight, and so is their noise.
            least = _NOISE * max(metric.tolerances.values())
            least *= 100.0 if metric.tolerance_unit else factor
        else:
            continue
        yield Quantity(_WHOLE, metric.name, metric.label, unit, least)


def metric_values(summary: Mapping[str, Any], weight: float) -> dict[str, float]:
    """Values of the compared metrics in ``summary.json``, as shown."""
    found = {}
    for name in (item.name for item in quantities(weight) if item.group == _WHOLE):
        metric = METRICS[name]
        section = summary.get(metric.section or "metrics", {})
        entry = section.get(name.partition("_")[2] if metric.section else name)
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        found[name] = math.nan if value is None else display_unit(metric.unit, weight)[0] * value
    return found


def switch_quantities(
    plan: StepPlan, signals: Signals, record: SimulationRecord | StoredRecord, window: float = WINDOW
) -> dict[str, float]:
    """Quantities of :data:`SWITCH` in their shown units; NaN without a switch.

    Args:
        plan: that was walked.
        signals: plan, command and measurement on one clock.
        record: of the walk.
        window: half-width of the window about a switch [s].
    """
    time, mass = signals.time, record.mass
    weight = mass * record.gravity
    values: dict[str, float] = {}
    after_first = time >= plan.constants.step_duration - 1e-9
    switches = plan.contacts.switch_times
    switches = switches[(switches >= plan.constants.step_duration - 1e-9) & (switches < time[-1] - window)]
    distance = np.abs(time[:, None] - switches).min(axis=1, initial=np.inf)
    near, far = after_first & (distance <= window), after_first & (distance > window)
    about = [np.abs(time - switch) <= window for switch in switches]

    def median_of_peaks(series: Array) -> float:
        return float(np.median([np.nanmax(series[rows]) for rows in about])) if about else np.nan

    measured, planned = signals.vector("measured_force"), signals.vector("plan_force")
    dt = record.time_step

    def change(force: Array) -> float:
        steps = []
        for switch in switches:
            before = (time >= switch - ACROSS - 1e-9) & (time < switch - 1e-9)
            after = (time >= switch - 1e-9) & (time < switch + ACROSS - 1e-9)
            steps.append(np.linalg.norm(force[after, :2].mean(axis=0) - force[before, :2].mean(axis=0)))
        return float(np.median(steps)) / mass if steps else np.nan

    values["planned_change"], values["measured_change"] = change(planned), change(measured)
    rate = np.linalg.norm(np.diff(measured[:, :2], axis=0, append=measured[-1:, :2]), axis=1) / dt
    values["force_rate"] = median_of_peaks(rate) / weight
    values["vertical_force"] = 100.0 * median_of_peaks(np.abs(measured[:, 2] - planned[:, 2])) / weight

    error = 1e3 * (signals.vector("measured_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    for column, axis in enumerate("xy"):
        values[f"zmp_{axis}_near"] = _rms(error[near, column])
        values[f"zmp_{axis}_far"] = _rms(error[far, column])

    torque_rate = np.abs(np.diff(record.torque, axis=0, append=record.torque[-1:])) / dt / 1e3
    values["torque_rate_peak"] = median_of_peaks(torque_rate.max(axis=1))
    values["torque_rate_near"] = _rms(torque_rate[near])
    values["torque_rate_far"] = _rms(torque_rate[far])

    effort = 1e3 * (signals.vector("command_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    values["effort_zmp_near"] = _rms(effort[near]) * np.sqrt(2.0)
    values["effort_zmp_far"] = _rms(effort[far]) * np.sqrt(2.0)
    push = 100.0 * (signals.vector("command_force", "xy") - signals.vector("plan_force", "xy")) / weight
    values["effort_force_near"] = _rms(push[near]) * np.sqrt(2.0)
    return {name: float(value) for name, value in values.items()}


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else float("nan")
