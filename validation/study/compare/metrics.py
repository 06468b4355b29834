"""Quantities to compare two gaits by: about the switches of support, and metrics of the whole run.

``ampm convergence`` studies the same quantities, so that a difference between two gaits can be compared with
the numerical uncertainty of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ampm.geometry import Array
from ampm.planner.support import StepPlan
from validation.judge.metrics import METRICS, display_unit, rms
from validation.judge.sizes import BODY_WEIGHT, DEFAULT_BODY, limit_in_si
from validation.store.record import StoredRecord
from validation.store.signals import Signals
from validation.trial.record import SimulationRecord

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
        extreme: whether it is a largest value.
        walked: whether it comes from a simulation; closed form and motion on a given grid do not.
    """

    group: str
    name: str
    label: str
    unit: str
    least: float
    extreme: bool = False
    walked: bool = True

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


_PLAN, _JOINTS = "jump at a switch: the plan", "jump at a switch: joint accelerations of the motion"
UNWALKED = tuple(
    Quantity(*row, walked=False)
    for row in (
        (_PLAN, "plan_acceleration", "COM acceleration", "m/s²", 1e-9),
        (_PLAN, "plan_force", "horizontal force", "% of body weight", 1e-9),
        (_PLAN, "plan_zmp", "ZMP", "mm", 1e-9),
        (_PLAN, "plan_moment", "moment about the COM", "N m", 1e-9),
        *((_JOINTS, f"joint_{1e3 * h:g}ms", f"on a grid of {1e3 * h:g} ms", "rad/s²", 1.0) for h in GRIDS),
        (_JOINTS, "joint_limit", "without a grid (extrapolated)", "rad/s²", 1.0),
    )
)
_NEAR = f"{1e3 * WINDOW:g} ms"
_CHANGE = f"COM acceleration, mean of {1e3 * ACROSS:g} ms after less before"
_FORCE = f"measured ground force, within {_NEAR} of a switch (median over switches)"
_ZMP, _TORQUE, _EFFORT = "ZMP error", "torque rates", "feedback: command minus plan"
SWITCH = (
    Quantity(_FORCE, "planned_change", f"{_CHANGE}: planned", "m/s²", 0.01),
    Quantity(_FORCE, "measured_change", f"{_CHANGE}: measured", "m/s²", 0.01),
    Quantity(_FORCE, "force_rate", "fastest change of the horizontal force", "body weights/s", 0.1, True),
    Quantity(_FORCE, "vertical_force", "largest error of the vertical force", "% of body weight", 0.1, True),
    Quantity(_ZMP, "zmp_x_near", f"x, RMSE within {_NEAR} of a switch", "mm", 0.05),
    Quantity(_ZMP, "zmp_x_far", "x, RMSE elsewhere", "mm", 0.05),
    Quantity(_ZMP, "zmp_y_near", f"y, RMSE within {_NEAR} of a switch", "mm", 0.05),
    Quantity(_ZMP, "zmp_y_far", "y, RMSE elsewhere", "mm", 0.05),
    Quantity(_TORQUE, "torque_rate_peak", f"fastest joint within {_NEAR} (median over switches)", "N m/ms",
             0.1, True),
    Quantity(_TORQUE, "torque_rate_near", f"RMS of all joints within {_NEAR}", "N m/ms", 0.01),
    Quantity(_TORQUE, "torque_rate_far", "RMS of all joints elsewhere", "N m/ms", 0.01),
    Quantity(_EFFORT, "effort_zmp_near", f"ZMP, RMS within {_NEAR}", "mm", 0.05),
    Quantity(_EFFORT, "effort_zmp_far", "ZMP, RMS elsewhere", "mm", 0.05),
    Quantity(_EFFORT, "effort_force_near", f"horizontal force, RMS within {_NEAR}", "% of body weight", 0.01),
)  # fmt: skip
"""Quantities of a walk that only a comparison reports."""
_COSTS = {
    "clearance_shortfall": 0.5e-3,
    "speed_excess": 0.01,
    "margin_torque": 0.01,
    "margin_slip": 0.5e-3,
    "margin_friction": 0.05,
    "energy_cost_of_transport": 0.01,
    "failed_qp": 1.0,
}
"""Metrics that have no limit or one of zero, and their noise [SI unit]."""
_WHOLE = "the whole run"
_NOISE = 0.02
"""Share of a metric's default tolerance below which its value is noise [1]."""


def quantities(weight: float) -> Iterator[Quantity]:
    """All compared quantities, in order: judged metrics of the walk, and its cost.

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
            limit = metric.tolerances.get("default", max(metric.tolerances.values()))
            own = metric.tolerance_unit
            least = 100.0 * limit if own == BODY_WEIGHT else factor * limit_in_si(limit, own, DEFAULT_BODY)
            least *= _NOISE
        else:
            continue
        yield Quantity(_WHOLE, metric.name, metric.label, unit, least or 1e-12)  # a limit of zero


def metric_values(summary: Mapping[str, Any], weight: float) -> dict[str, float]:
    """Values of all metrics in ``summary.json``, as shown; NaN where it has none."""
    found = {}
    for name, metric in METRICS.items():
        section = summary.get(metric.section or "metrics", {})
        entry = section.get(name.partition("_")[2] if metric.section else name)
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        found[name] = math.nan if value is None else display_unit(metric.unit, weight)[0] * value
    return found


def switch_values(
    plan: StepPlan, signals: Signals, record: SimulationRecord | StoredRecord
) -> dict[str, float]:
    """Quantities of :data:`SWITCH` in their shown units; NaN without a switch.

    Args:
        plan: that was walked.
        signals: plan, command and measurement on one clock.
        record: of the walk.
    """
    time, weight = signals.time, record.mass * record.gravity
    steps = np.round(time / record.time_step).astype(np.intp)
    dt = int(steps[1] - steps[0]) * record.time_step
    first = plan.constants.step_duration - 1e-9
    switches = plan.contacts.switch_times
    switches = switches[(switches >= first) & (switches < time[-1] - WINDOW)]
    distance = np.abs(time[:, None] - switches).min(axis=1, initial=np.inf)
    rows = {"near": (time >= first) & (distance <= WINDOW), "far": (time >= first) & (distance > WINDOW)}

    def peak(series: Array) -> float:
        """Largest value about a switch, median over switches."""
        peaks = [np.nanmax(series[np.abs(time - switch) <= WINDOW]) for switch in switches]
        return float(np.median(peaks)) if peaks else math.nan

    def change(force: Array) -> float:
        """Change of the horizontal force at a switch over the mass, median over switches."""
        steps = []
        for switch in switches - 1e-9:
            before = (time >= switch - ACROSS) & (time < switch)
            after = (time >= switch) & (time < switch + ACROSS)
            steps.append(np.linalg.norm(force[after, :2].mean(axis=0) - force[before, :2].mean(axis=0)))
        return float(np.median(steps)) / record.mass if steps else math.nan

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
    for where, inside in rows.items():
        values |= {f"{name}_{where}": rms(series[inside]) for name, series in of_joints.items()}
        values |= {f"{name}_{where}": rms(series[inside]) * 2**0.5 for name, series in of_vectors.items()}
    return {item.name: values[item.name] for item in SWITCH}
