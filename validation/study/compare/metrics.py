"""Quantities that walks are compared by, all from stored runs, in SI units: smaller is better."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.judge.metrics import METRICS, added_metrics, rms
from validation.store.record import StoredRecord
from validation.store.signals import Signals

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
        unit: SI unit.
        extreme: whether it is a largest value.
    """

    group: str
    name: str
    label: str
    unit: str
    extreme: bool = False


JUDGED, COST, OWN = "judged metrics", "cost", "own metrics without a limit"
_COSTS = ("margin_torque", "margin_friction", "energy_cost_of_transport")
_PLAN, _SWITCH = "jump of the plan at a switch, largest", "walk near a switch, and elsewhere"
_NEAR = f"within {1e3 * WINDOW:g} ms"
PLAN = (
    Quantity(_PLAN, "plan_acceleration", "COM acceleration", "m/s^2", True),
    Quantity(_PLAN, "plan_zmp", "ZMP", "m", True),
    Quantity(_PLAN, "plan_moment", "moment about the COM", "N m", True),
)
SWITCH = (
    Quantity(_SWITCH, "force_change", "horizontal force, change at a switch over the mass", "m/s^2"),
    Quantity(_SWITCH, "zmp_x_near", f"ZMP, RMS error along x {_NEAR}", "m"),
    Quantity(_SWITCH, "zmp_x_far", "ZMP, RMS error along x elsewhere", "m"),
    Quantity(_SWITCH, "zmp_y_near", f"ZMP, RMS error along y {_NEAR}", "m"),
    Quantity(_SWITCH, "zmp_y_far", "ZMP, RMS error along y elsewhere", "m"),
    Quantity(_SWITCH, "torque_rate_near", f"torque rate, RMS of all joints {_NEAR}", "N m/s"),
    Quantity(_SWITCH, "torque_rate_far", "torque rate, RMS of all joints elsewhere", "N m/s"),
    Quantity(_SWITCH, "feedback_near", f"ZMP, RMS feedback {_NEAR}", "m"),
    Quantity(_SWITCH, "feedback_far", "ZMP, RMS feedback elsewhere", "m"),
)


def metric_entry(summary: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Value and tolerance of a metric in ``summary.json``; empty where it has none."""
    section = METRICS[name].section if name in METRICS else ""
    entry = summary.get(section or "metrics", {}).get(name.partition("_")[2] if section else name)
    return entry if isinstance(entry, Mapping) else {"value": entry}


def own_metrics(summaries: Iterable[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Entries of the metrics that users have added to runs; this process may not know them."""
    built_in = METRICS.keys() - {metric.name for metric in added_metrics()}
    entries = (item for summary in summaries for item in summary["metrics"].items())
    return {name: entry for name, entry in entries if name not in built_in}


def metric_quantities(judged: set[str], own: Mapping[str, Mapping[str, Any]]) -> list[Quantity]:
    """The judged metrics, without checks of the measurement itself, then costs and users' own metrics."""
    walk = [item for item in METRICS.values() if item.name in judged - own.keys()]
    costs = [METRICS[name] for name in _COSTS if name not in judged]
    found = [
        Quantity(group, item.name, item.label, item.unit, item.nature == "extreme")
        for group, items in ((JUDGED, walk), (COST, costs))
        for item in items
        if item.kind != "instrument"
    ]
    found += [
        Quantity(JUDGED if name in judged else OWN, name, entry["label"], entry["unit"])
        for name, entry in own.items()
    ]
    return sorted(found, key=lambda item: item.group != JUDGED)


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
        "plan_zmp": _jump(signals.vector("plan_zmp", "xy"), rows - 1, rows, 0.0),
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


def switch_values(signals: Signals, record: StoredRecord) -> dict[str, float]:
    """Quantities of :data:`SWITCH`; NaN without a switch.

    Args:
        signals: plan, command and measurement on one clock.
        record: of the walk.
    """
    time = signals.time
    steps = np.round(time / record.time_step).astype(np.intp)
    dt = int(steps[1] - steps[0]) * record.time_step
    rows = switch_rows(signals)
    switches = time[rows[time[rows] < time[-1] - WINDOW]]
    distance = np.abs(time[:, None] - switches).min(axis=1, initial=np.inf)
    judged = np.arange(len(time)) >= signals.first_step()
    torque = record.torque_at(steps)
    plan, command, measured = (
        signals.vector(f"{name}_zmp", "xy") for name in ("plan", "command", "measured")
    )
    series = {
        "zmp_x": measured[:, :1] - plan[:, :1],
        "zmp_y": measured[:, 1:] - plan[:, 1:],
        "torque_rate": np.diff(torque, axis=0, append=torque[-1:]) / dt,
        "feedback": np.linalg.norm(command - plan, axis=1),
    }
    values = {
        "force_change": _force_change(time, signals.vector("measured_force", "xy"), switches) / record.mass
    }
    for where, inside in (("near", distance <= WINDOW), ("far", distance > WINDOW)):
        values |= {f"{name}_{where}": rms(items[judged & inside]) for name, items in series.items()}
    return values


def _force_change(time: Array, force: Array, switches: Array) -> float:
    """Change of the horizontal force across a switch, median over switches [N]; NaN without a switch.

    Args:
        time: shape (n,) [s].
        force: shape (n, 2) [N].
        switches: instants [s].
    """
    changes = []
    for switch in switches - 1e-9:
        before = (time >= switch - ACROSS) & (time < switch)
        after = (time >= switch) & (time < switch + ACROSS)
        changes.append(np.linalg.norm(force[after].mean(axis=0) - force[before].mean(axis=0)))
    return float(np.median(changes)) if changes else math.nan
