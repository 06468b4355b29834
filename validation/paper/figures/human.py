"""Angular momentum and ground forces of the gaits beside published data of people.

Momentum is made dimensionless as Herr & Popovic (2008) do: by mass, mean speed and height of the COM.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampm.exceptions import AmpmError
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run
from validation.paper.figures.canvas import (
    BAND,
    DASHED,
    FAINT,
    INK,
    LEFT,
    MEASURED,
    PLAN,
    inches,
    legend_above,
    zero_line,
)
from validation.paper.figures.walks import Walk, Walks

GAITS: Mapping[str, tuple[str, ...]] = {
    "normal": ("normal",),
    "normal, L_z = 0": ("normal", "body.angular_momentum_z=zero"),
    **{name: (name,) for name in ("momentum", "roll-0.1", "roll-0.4", "roll-0.7", "pitch", "pitch-low")},
}
"""The demos and their presets; ``roll-1.0`` is the normal gait."""

HUMAN_MOMENTUM: Mapping[str, float] = {"x": 0.03, "y": 0.05, "z": 0.01}
"""Bounds of |L| / (m V H) over the stride of ten walking people, mean plus one standard deviation [1], by our
axes: x forward, y lateral, z vertical. Herr & Popovic (2008), J. Exp. Biol. 211:467-481,
doi:10.1242/jeb.008573; their x is medio-lateral and their y anterior-posterior."""

AXES: Mapping[str, str] = {"x": "forward (frontal plane)", "y": "lateral (sagittal plane)", "z": "vertical"}

HUMAN_FORCE = Path(__file__).parent / "data" / "walking_ground_force.csv"
"""Ground force on one foot of walking people over the stance, mean and standard deviation between them; its
header gives source and processing."""

SPEEDS: Mapping[str, float] = {"0p8": 0.8, "1p3": 1.3}
"""Speeds in that table, by the end of its columns' names [m/s]."""

RANGE_STEPS = 6
"""Steps of the short walks by which the measured range is found."""

_CLOSE = 0.003
"""How near an end of the measured range is searched [1]."""

AXIS: Mapping[str, str] = {"c_y": "x", "c_s": "y"}
_SCAN = {"c_y": np.arange(0.05, 1.501, 0.01), "c_s": np.arange(0.5, 1.801, 0.01)}


def figure_human(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Angular momentum of the demos, the range of c_y and c_s nearest to people, and ground forces."""
    demos = {label: walks.walk(gait, settings) for label, (gait, *settings) in GAITS.items()}
    scans = ranges(load_run("normal"))
    for key, found in scans.items():
        found["measured"] = measured_range(partial(peak_of, walks, key), key, found["low"], found["high"])
    plan = demos["normal"].plan
    offset = float(plan.constants.angular_momentum_y_offset)
    kept = ("low", "high", "measured")
    numbers: dict[str, Any] = {
        "peaks": {label: peaks(walk) for label, walk in demos.items()},
        "ranges": {key: {name: found[name] for name in kept} for key, found in scans.items()},
        "angular_momentum_y_offset": {"Nms": offset, "of_m_V_H": offset / scale(plan)},
    }
    figure = Figure(figsize=(9.6, 9.9))
    _bars(figure, numbers["peaks"])
    for k, (key, axis) in enumerate(AXIS.items()):
        _range(inches(figure, 0.85 + 4.55 * k, 4.1, 3.95, 1.75), key, axis, scans[key])
    numbers["forces"] = forces(figure, demos["normal"])
    return figure, numbers


def scale(plan: CentroidalPlan) -> float:
    """Mass times mean speed times height of the COM [N m s]."""
    return plan.mass * plan.constants.mean_velocity * plan.com_height


def peaks(walk: Walk) -> dict[str, float]:
    """Largest simulated |L| / (m V H) about each axis, first step left out."""
    measured = walk.folded(walk.trial.measured.angular_momentum)
    largest = np.abs(measured).max(axis=(0, 1)) / scale(walk.plan)
    return {axis: float(value) for axis, value in zip("xyz", largest, strict=True)}


def ranges(run: RunParameters) -> dict[str, dict[str, Any]]:
    """Planned peaks of |L| / (m V H) over c_y (about x) and c_s (about y), and where people's bound holds.

    The plan alone, other parameters as in ``run``, without the body's constant of L_y.

    Returns:
        By parameter: ``values``, ``peaks``, and ``low`` and ``high`` of the range within the human bound.
    """
    answer = {}
    for component, (key, axis) in enumerate(AXIS.items()):
        values, found = [], []
        for value in _SCAN[key]:
            gait = run.gait.model_copy(update={key: float(value), "steps": 2})
            try:
                plan = plan_gait(gait, run.body.mass)
            except AmpmError:
                continue
            sample = plan.sample(np.linspace(0.0, plan.duration, 801))
            values.append(float(value))
            found.append(float(np.abs(sample.angular_momentum[:, component]).max()) / scale(plan))
        least, bound = int(np.argmin(found)), HUMAN_MOMENTUM[axis]
        # The peak grows to both sides of 1, where it is zero.
        low = np.interp(bound, found[least::-1], values[least::-1])
        high = np.interp(bound, found[least:], values[least:])
        answer[key] = {"values": values, "peaks": found, "low": float(low), "high": float(high)}
    return answer


def inward(ends: Mapping[str, Any]) -> str:
    """A range in hundredths, rounded inwards."""
    return f"{np.ceil(100 * ends['low'] - 1e-6) / 100:.2f} to {np.floor(100 * ends['high'] + 1e-6) / 100:.2f}"


def peak_of(walks: Walks, key: str, value: float) -> float:
    """Measured peak of |L| / (m V H), normal gait, one parameter changed: of L_x for c_y, of L_y for c_s."""
    walk = walks.walk("normal", (f"gait.{key}={value:.4f}",), steps=RANGE_STEPS)
    return peaks(walk)[AXIS[key]]


def measured_range(peak: Callable[[float], float], key: str, low: float, high: float) -> dict[str, Any]:
    """Range in which the measured momentum stays within people's bound: the planned ends, corrected by walks.

    Args:
        peak: measured peak of |L| / (m V H) at a value of the parameter.
        key: ``c_y`` or ``c_s``.
        low: end of the planned range below 1.
        high: end above 1.

    Returns:
        ``low`` and ``high``, the outermost values that were walked within the bound, to about 0.003; and
        ``walked``, every value and its peak.
    """
    bound, walked = HUMAN_MOMENTUM[AXIS[key]], {}
    for at in (low, high):
        for _ in range(6):
            walked[at] = peak(at)
            # The peak grows almost linearly with the distance from 1. Just within: an end must be walked.
            guess = 1.0 + (at - 1.0) * bound / walked[at] * (1.0 - 0.2 * _CLOSE)
            if walked[at] <= bound and abs(guess - at) <= _CLOSE:
                break
            at = guess
    within = [value for value, found in walked.items() if found <= bound]
    pairs = [[value, walked[value]] for value in sorted(walked)]
    return {"low": min(within), "high": max(within), "walked": pairs}


def _bars(figure: Figure, found: Mapping[str, Mapping[str, float]]) -> None:
    """Largest momenta of the demos about the three axes."""
    for k, (letter, name) in enumerate(AXES.items()):
        axis, bound = inches(figure, 1.2 + 2.88 * k, 0.62, 2.4, 2.3), HUMAN_MOMENTUM[letter]
        values = [item[letter] for item in found.values()]
        axis.axvspan(0.0, bound, color=BAND, alpha=0.45, linewidth=0)
        colors = [PLAN if value > bound else LEFT for value in values]
        axis.barh(range(len(values)), values, height=0.62, color=colors)
        for row, value in enumerate(values):
            axis.text(value, row, f" {value:.3f}", va="center", fontsize=7.5)
        axis.set_yticks(range(len(values)), [label if k == 0 else "" for label in found])
        axis.invert_yaxis()
        axis.grid(False, axis="y")
        axis.set_xlim(0, 1.28 * max(*values, bound))
        axis.set_title(f"$L_{letter}$: {name}\nshaded: people, ≤ {bound:g}", fontsize=8.5)
        if k == 1:
            axis.set_xlabel("largest |L| / (m V H) in the simulation")


def _range(axis: Axes, key: str, letter: str, found: Mapping[str, Any]) -> None:
    bound, measured = HUMAN_MOMENTUM[letter], found["measured"]
    axis.axhspan(0, bound, color=BAND, alpha=0.45, linewidth=0, label=f"people: ≤ {bound:g}")
    axis.plot(found["values"], found["peaks"], color=INK, linewidth=1.4, label="plan")
    axis.axvspan(found["low"], found["high"], color=PLAN, alpha=0.35, linewidth=0)
    axis.plot(*np.transpose(measured["walked"]), "o", color=MEASURED, markersize=4, label="simulation")
    for end in (measured["low"], measured["high"]):
        axis.axvline(end, color=MEASURED, linewidth=0.9, linestyle=DASHED)
    axis.set(xlabel=f"${key}$", xlim=(0.65, 1.35), ylim=(0, 3 * bound))
    axis.set_title(
        f"peak of $|L_{letter}|$ / (m V H); within people's bound:\n"
        f"plan: ${key}$ {inward(found)}; simulation: {inward(measured)}",
        fontsize=8.5,
    )
    legend_above(axis)


def human_force() -> Any:
    """Columns of :data:`HUMAN_FORCE`, shape (n,): ``stance_percent`` [%], the others [body weight]."""
    lines = HUMAN_FORCE.read_text(encoding="utf-8").splitlines()
    return np.genfromtxt([line for line in lines if not line.startswith("#")], delimiter=",", names=True)


def forces(figure: Figure, walk: Walk) -> dict[str, dict[str, float]]:
    """Draw one foot's ground force over its stance beside people's; return the largest and the smallest."""
    measured = walk.trial.measured
    force = measured.foot_force[:, 0] / measured.weight
    # The left foot lands one double support before its single support, and leaves one after.
    share = np.linspace(0.0, 1.0, 501)
    times = [start - walk.double + share * (walk.single + 2 * walk.double) for start in walk.stride_starts]
    people, values = human_force(), {}
    for k, (name, component, sign) in enumerate(
        (("vertical", 2, 1.0), ("forward", 0, 1.0), ("medial", 1, -1.0))
    ):
        axis = inches(figure, 0.8 + 3.0 * k, 7.0, 2.45, 2.3)
        ours = sign * np.stack([np.interp(time, measured.time, force[:, component]) for time in times])
        at, mean = people["stance_percent"], ours.mean(axis=0)
        zero_line(axis)
        values[name] = {"simulated_largest": float(ours.max()), "simulated_smallest": float(ours.min())}
        if name == "vertical":
            values[name] |= _humps(mean, "simulated")
        for (end, speed), color, line, alpha in zip(
            SPEEDS.items(), (INK, FAINT), ("-", (0, (4, 2))), (0.8, 0.35), strict=True
        ):
            theirs, deviation = people[f"{name}_mean_{end}"], people[f"{name}_sd_{end}"]
            axis.fill_between(
                at, theirs - deviation, theirs + deviation, color=BAND, alpha=alpha, linewidth=0
            )
            label = f"people, {speed:g} m/s"
            axis.plot(at, theirs, color=color, linewidth=1.3, linestyle=line, label=label)
            largest, smallest = float(theirs.max()), float(theirs.min())
            values[name] |= {f"people_{end}_largest": largest, f"people_{end}_smallest": smallest}
            if name == "vertical":
                values[name] |= _humps(theirs, f"people_{end}")
        band = ours.min(axis=0), ours.max(axis=0)
        axis.fill_between(100 * share, *band, color=MEASURED, alpha=0.3, linewidth=0)
        label = f"simulation, {walk.plan.constants.mean_velocity:.2f} m/s"
        axis.plot(100 * share, mean, color=MEASURED, linewidth=1.3, label=label)
        axis.set_xlim(0, 100)
        axis.set_title(f"{name} force on one foot", pad=19)
        if name == "vertical":
            axis.set_ylabel("[body weight]")
            legend_above(axis, 3)
        if name == "forward":
            axis.set_xlabel("share of the foot's stance [%]; bands: people's standard deviation")
    return values


def _humps(force: Array, who: str) -> dict[str, float]:
    """Largest force in the first and in the last 45 % of stance, and the least between 35 and 65 %.

    These describe the double hump: two peaks and the least force between them.
    """
    count = len(force) - 1
    return {
        f"{who}_first": float(force[: round(0.45 * count) + 1].max()),
        f"{who}_valley": float(force[round(0.35 * count) : round(0.65 * count) + 1].min()),
        f"{who}_second": float(force[round(0.55 * count) :].max()),
    }
