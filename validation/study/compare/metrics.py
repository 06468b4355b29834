"""What two gaits are compared by: figures about the switches of support, and of the whole run.

The same figures are followed by ``ampm convergence``, so that a difference between two gaits can be held
against the numerical uncertainty of both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ampm.planner.support import StepPlan
    from validation.judge.compare import Comparison
    from validation.store.record import StoredRecord
    from validation.store.signals import Signals
    from validation.trial.record import SimulationRecord

Array = NDArray[np.float64]

WINDOW = 0.05
"""Half-width of the window about a switch [s]."""
ACROSS = 0.02
"""Interval on either side of a switch over which the ground force is averaged for its change [s]."""
GRIDS = (0.004, 0.002, 0.001)
"""Largest steps of the inverse kinematics' grid on which the jump of joint accelerations is looked at [s]."""
UNWALKED = ("plan_", "joint_")
"""Beginning of the names of figures that no simulation is in: closed form, and the motion on a given grid."""
_SAME: Mapping[str, str] = {
    "zmp_x_maximum": "zmp_x_maximum",
    "zmp_y_maximum": "zmp_y_maximum",
    "torque": "margin_torque",
    "force_x": "force_x_rmse",
    "force_y": "force_y_rmse",
    "force_z": "force_z_rmse",
    "momentum_x": "angular_momentum_x_rmse",
    "momentum_y": "angular_momentum_y_rmse",
    "slip": "margin_slip",
    "friction": "margin_friction",
    "transport": "energy_cost_of_transport",
    "unsolved": "failed_qp",
}
"""Figures that a trial has under another name."""


def studied_name(name: str) -> str:
    """What ``convergence.json`` calls a figure."""
    return _SAME.get(name, f"switch_{name}")


def si_unit(unit: str, weight: float) -> tuple[float, str]:
    """SI value of a shown unit, and the SI unit.

    Args:
        unit: as in the catalogue.
        weight: of the body [N].
    """
    table = {
        "mm": (1e-3, "m"),
        "%": (1e-2, "1"),
        "% of body weight": (1e-2 * weight, "N"),
        "body weights/s": (weight, "N/s"),
        "N m/ms": (1e3, "N m/s"),
        "m/s²": (1.0, "m/s^2"),
        "rad/s²": (1.0, "rad/s^2"),
        "ticks": (1.0, "1"),
    }
    return table.get(unit, (1.0, unit))


def switch_figures(walk: Comparison) -> list[tuple[str, float, str]]:
    """Name, SI value and SI unit of what only a comparison shows of a walk, for a convergence study."""
    from validation.judge.signals import signals_table
    from validation.store.signals import Signals

    table, record = signals_table(walk), walk.record
    signals = Signals({name: table.column(name).to_numpy() for name in table.column_names})
    values = walked_figures(walk.plan, signals, record)
    weight = record.mass * record.gravity
    found = []
    for _, name, _, unit, _ in catalogue(WINDOW):
        if name in values and name not in _SAME:
            factor, si = si_unit(unit, weight)
            found.append((studied_name(name), factor * values[name], si))
    return found


def catalogue(window: float) -> Iterator[tuple[str, str, str, str, float]]:
    """Group, name, label, unit, and what is noise, of every figure in its order."""
    near = f"{1e3 * window:g} ms"
    group = "jump at a switch: the plan"
    yield group, "plan_acceleration", "COM acceleration", "m/s²", 1e-9
    yield group, "plan_force", "horizontal force", "% of body weight", 1e-9
    yield group, "plan_zmp", "ZMP", "mm", 1e-9
    yield group, "plan_moment", "moment about the COM", "N m", 1e-9
    group = "jump at a switch: joint accelerations of the whole-body motion"
    for step in GRIDS:
        yield group, f"joint_{1e3 * step:g}ms", f"on a grid of {1e3 * step:g} ms", "rad/s²", 1.0
    yield group, "joint_limit", "without a grid (extrapolated)", "rad/s²", 1.0
    group = f"measured ground force, within {near} of a switch (median over switches)"
    change = f"COM acceleration, mean of {1e3 * ACROSS:g} ms after less before"
    yield group, "planned_change", f"{change}: planned", "m/s²", 0.01
    yield group, "measured_change", f"{change}: measured", "m/s²", 0.01
    yield group, "force_rate", "fastest change of the horizontal force", "body weights/s", 0.1
    yield group, "vertical_force", "largest error of the vertical force", "% of body weight", 0.1
    group = "ZMP error"
    for axis in "xy":
        yield group, f"zmp_{axis}_near", f"{axis}, RMSE within {near} of a switch", "mm", 0.05
        yield group, f"zmp_{axis}_far", f"{axis}, RMSE elsewhere", "mm", 0.05
        yield group, f"zmp_{axis}_maximum", f"{axis}, largest", "mm", 0.5
    group = "torque rates"
    yield group, "torque_rate_peak", f"fastest joint within {near} (median over switches)", "N m/ms", 0.1
    yield group, "torque_rate_near", f"RMS of all joints within {near}", "N m/ms", 0.01
    yield group, "torque_rate_far", "RMS of all joints elsewhere", "N m/ms", 0.01
    yield group, "torque", "largest torque, of the motor's limit", "%", 1.0
    group = "feedback: command minus plan"
    yield group, "effort_zmp_near", f"ZMP, RMS within {near}", "mm", 0.05
    yield group, "effort_zmp_far", "ZMP, RMS elsewhere", "mm", 0.05
    yield group, "effort_force_near", f"horizontal force, RMS within {near}", "% of body weight", 0.01
    group = "the whole run"
    for axis in "xyz":
        yield group, f"force_{axis}", f"force {axis}, RMSE", "% of body weight", 0.01
    for axis in "xy":
        yield group, f"momentum_{axis}", f"angular momentum {axis}, RMSE", "N m s", 0.005
    yield group, "slip", "longest slip of a stance foot", "mm", 0.5
    yield group, "friction", "friction used by a loaded foot", "1", 0.05
    yield group, "transport", "mechanical cost of transport", "1", 0.01
    yield group, "unsolved", "unsolved QPs", "ticks", 1.0


def walked_figures(
    plan: StepPlan, signals: Signals, record: SimulationRecord | StoredRecord, window: float = WINDOW
) -> dict[str, float]:
    """What signals and torques of a walk say, in the units of the catalogue; NaN without a switch.

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
        values[f"zmp_{axis}_maximum"] = _largest(error[after_first, column])

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


def summary_figures(summary: Mapping[str, Any], weight: float) -> dict[str, float]:
    """What ``summary.json`` says of the whole run, in the units of the catalogue."""
    values = {"torque": 100.0 * _number(summary["margins"]["torque"]["value"])}
    metrics = summary["metrics"]
    for axis in "xyz":
        values[f"force_{axis}"] = 100.0 * _number(metrics[f"force_{axis}_rmse"]["value"]) / weight
    for axis in "xy":
        values[f"momentum_{axis}"] = _number(metrics[f"angular_momentum_{axis}_rmse"]["value"])
    values["slip"] = 1e3 * _number(summary["margins"]["slip"]["value"])
    values["friction"] = _number(summary["margins"]["friction"]["value"])
    values["transport"] = _number(summary["energy"]["cost_of_transport"])
    return values


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else float("nan")


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else float("nan")
