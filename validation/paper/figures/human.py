"""How human the gaits are: angular momentum and ground forces beside what is published of people.

Momentum is made dimensionless as Herr & Popovic (2008) do: by mass, mean speed and height of the COM.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ampm.exceptions import AmpmError
from ampm.parameters import RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run
from validation.paper.figures.canvas import BAND, FAINT, INK, LEFT, MEASURED, PLAN, inches, legend_above
from validation.paper.figures.walks import Walk, Walks

Array = NDArray[np.float64]

GAITS: Mapping[str, tuple[str, ...]] = {
    "normal": ("normal",),
    "normal, L_z = 0": ("normal", "body.angular_momentum_z=zero"),
    **{name: (name,) for name in ("momentum", "roll-0.1", "roll-0.4", "roll-0.7", "pitch", "pitch-low")},
}
"""The demos, and what to walk for them; ``roll-1.0`` is the normal gait."""

HUMAN_MOMENTUM: Mapping[str, float] = {"x": 0.03, "y": 0.05, "z": 0.01}
"""Bounds of |L| / (m V H) over the stride of ten walking people, mean plus one standard deviation [1], by our
axes: x forward, y lateral, z vertical. Herr & Popovic (2008), J. Exp. Biol. 211:467-481,
doi:10.1242/jeb.008573; their x is medio-lateral and their y anterior-posterior."""

AXES: Mapping[str, str] = {"x": "forward (frontal plane)", "y": "lateral (sagittal plane)", "z": "vertical"}

HUMAN_FORCE = Path(__file__).parent / "data" / "walking_ground_force.csv"
"""Ground force on one foot of walking people over the stance, mean and standard deviation between them; its
header says whose, and what was done to it."""

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
    _bars([inches(figure, 1.2 + 2.88 * k, 0.62, 2.4, 2.3) for k in range(3)], numbers["peaks"])
    for k, (key, axis) in enumerate(AXIS.items()):
        _range(inches(figure, 0.85 + 4.55 * k, 4.1, 3.95, 1.75), key, axis, scans[key])
    panels = [inches(figure, 0.8 + 3.0 * k, 7.0, 2.45, 2.3) for k in range(3)]
    numbers["forces"] = _forces(panels, demos["normal"])
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

    The plan alone, other parameters as in ``run``: the constant of L_y, which only a body has, is not in it.

    Returns:
        By parameter: ``values``, ``peaks``, and ``low`` and ``high`` of the range within the human bound.
    """
    answer = {}
    for axis, key in enumerate(AXIS):
        values, found = [], []
        for value in _SCAN[key]:
            gait = run.gait.model_copy(update={key: float(value), "steps": 2})
            try:
                plan = plan_gait(gait, run.body.mass)
            except AmpmError:
                continue
            sample = plan.sample(np.linspace(0.0, plan.duration, 801))
            values.append(float(value))
            found.append(float(np.abs(sample.angular_momentum[:, axis]).max()) / scale(plan))
        low, high = _within(np.array(values), np.array(found), HUMAN_MOMENTUM["xy"[axis]])
        answer[key] = {"values": values, "peaks": found, "low": low, "high": high}
    return answer


def _within(values: Array, found: Array, bound: float) -> tuple[float, float]:
    """Ends of the range about 1 in which a scanned curve is at most the bound, between the scanned values."""
    inside = np.flatnonzero(found <= bound)
    ends = []
    for inner, outer in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
        share = (bound - found[inner]) / (found[outer] - found[inner])
        ends.append(float(values[inner] + share * (values[outer] - values[inner])))
    return ends[0], ends[1]


def inward(ends: Mapping[str, Any]) -> str:
    """A range in hundredths, rounded so that it stays within."""
    return f"{np.ceil(100 * ends['low'] - 1e-6) / 100:.2f} to {np.floor(100 * ends['high'] + 1e-6) / 100:.2f}"


def peak_of(walks: Walks, key: str, value: float) -> float:
    """Measured peak of |L| / (m V H), normal gait, one parameter changed: of L_x for c_y, of L_y for c_s."""
    walk = walks.walk("normal", (f"gait.{key}={value:.4f}",), steps=RANGE_STEPS)
    return peaks(walk)[AXIS[key]]


def measured_range(peak: Callable[[float], float], key: str, low: float, high: float) -> dict[str, Any]:
    """Where the measured momentum stays within people's bound: the planned ends, corrected by walking.

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

    def excess(value: float) -> float:
        walked[value] = peak(value)
        return walked[value] - bound

    ends = []
    for planned in (low, high):
        # The peak grows almost linearly with the distance from 1, so the planned end is a good guess.
        inner, outer = 1.0 + 0.7 * (planned - 1.0), 1.0 + 1.3 * (planned - 1.0)
        at, fit = planned, planned
        for _ in range(6):
            found = excess(at)
            if found > 0:
                outer = at
            else:
                inner = fit = at
            if abs(outer - inner) <= _CLOSE:
                break
            # Regula falsi on the line from 1, kept inside what is known; just within: an end must be walked.
            guess = 1.0 + (at - 1.0) * bound / walked[at] * (1.0 - 0.2 * _CLOSE)
            at = guess if min(inner, outer) < guess < max(inner, outer) else 0.5 * (inner + outer)
            if found <= 0 and abs(guess - fit) <= _CLOSE:
                break
        ends.append(fit)
    pairs = [[value, walked[value]] for value in sorted(walked)]
    return {"low": ends[0], "high": ends[1], "walked": pairs}


def _bars(axes: Sequence[Axes], found: Mapping[str, Mapping[str, float]]) -> None:
    for axes_, (letter, name) in zip(axes, AXES.items(), strict=True):
        bound = HUMAN_MOMENTUM[letter]
        values = [item[letter] for item in found.values()]
        axes_.axvspan(0.0, bound, color=BAND, alpha=0.45, linewidth=0)
        axes_.barh(
            range(len(values)), values, height=0.62, color=[PLAN if v > bound else LEFT for v in values]
        )
        for row, value in enumerate(values):
            axes_.text(value, row, f" {value:.3f}", va="center", fontsize=7.5)
        first = letter == "x"
        axes_.set_yticks(range(len(values)), list(found) if first else [""] * len(values))
        axes_.invert_yaxis()
        axes_.grid(False, axis="y")
        axes_.set_xlim(0, 1.28 * max(*values, bound))
        axes_.set_title(f"$L_{letter}$: {name}\nshaded: people, ≤ {bound:g}", fontsize=8.5)
    axes[1].set_xlabel("largest |L| / (m V H) in the simulation")


def _range(axis: Axes, key: str, letter: str, found: Mapping[str, Any]) -> None:
    bound = HUMAN_MOMENTUM[letter]
    axis.axhspan(0, bound, color=BAND, alpha=0.45, linewidth=0, label=f"people: ≤ {bound:g}")
    axis.plot(found["values"], found["peaks"], color=INK, linewidth=1.4, label="plan")
    axis.axvspan(found["low"], found["high"], color=PLAN, alpha=0.35, linewidth=0)
    measured = found["measured"]
    axis.plot(*np.transpose(measured["walked"]), "o", color=MEASURED, markersize=4, label="simulation")
    for end in (measured["low"], measured["high"]):
        axis.axvline(end, color=MEASURED, linewidth=0.9, linestyle=(0, (3, 2)))
    axis.set_ylim(0, 3 * bound)
    axis.set_xlim(0.65, 1.35)
    axis.set_title(
        f"peak of $|L_{letter}|$ / (m V H); within people's bound:\n"
        f"plan: ${key}$ {inward(found)}; simulation: {inward(measured)}",
        fontsize=8.5,
    )
    axis.set_xlabel(f"${key}$")
    legend_above(axis)


def human_force() -> dict[str, Array]:
    """Columns of :data:`HUMAN_FORCE`, shape (n,): ``stance_percent`` [%], the others [body weight]."""
    lines = [
        line for line in HUMAN_FORCE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")
    ]
    names = lines[0].split(",")
    columns = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]]).T
    return dict(zip(names, columns, strict=True))


def _forces(axes: Sequence[Axes], walk: Walk) -> dict[str, dict[str, float]]:
    """One foot's ground force over its stance, beside people's."""
    measured = walk.trial.measured
    force = measured.foot_force[:, 0] / measured.weight
    constants = walk.plan.constants
    # The left foot lands one double support before its single support, and leaves one after.
    stance = constants.single_support_duration + 2 * constants.double_support_duration
    share = np.linspace(0.0, 1.0, 501)
    first = walk.stride_starts - constants.double_support_duration
    folds = np.stack(
        [
            np.column_stack([np.interp(start + share * stance, measured.time, force[:, k]) for k in range(3)])
            for start in first
        ]
    )
    people = human_force()
    values = {}
    panels = (("vertical", 2, 1.0), ("forward", 0, 1.0), ("medial", 1, -1.0))
    for axis, (name, component, sign) in zip(axes, panels, strict=True):
        ours = sign * folds[..., component]
        at = people["stance_percent"]
        axis.axhline(0.0, color=FAINT, linewidth=0.6)
        values[name] = {"simulated_largest": float(ours.max()), "simulated_smallest": float(ours.min())}
        for (end, speed), color, line in zip(SPEEDS.items(), (INK, FAINT), ("-", (0, (4, 2))), strict=True):
            mean, deviation = people[f"{name}_mean_{end}"], people[f"{name}_sd_{end}"]
            axis.fill_between(
                at, mean - deviation, mean + deviation, color=BAND, alpha=0.8 if end == "0p8" else 0.35,
                linewidth=0,
            )  # fmt: skip
            axis.plot(at, mean, color=color, linewidth=1.3, linestyle=line, label=f"people, {speed:g} m/s")
            least, largest = float(mean.min()), float(mean.max())
            values[name] |= {f"people_{end}_largest": largest, f"people_{end}_smallest": least}
        axis.fill_between(
            100 * share, ours.min(axis=0), ours.max(axis=0), color=MEASURED, alpha=0.3, linewidth=0
        )
        speed = walk.plan.constants.mean_velocity
        label = f"simulation, {speed:.2f} m/s"
        axis.plot(100 * share, ours.mean(axis=0), color=MEASURED, linewidth=1.3, label=label)
        axis.set_xlim(0, 100)
        axis.set_title(f"{name} force on one foot")
    # What the double hump is, in numbers: two peaks over the least force between them.
    for end in SPEEDS:
        values["vertical"] |= _humps(people[f"vertical_mean_{end}"], f"people_{end}")
    values["vertical"] |= _humps(folds.mean(axis=0)[:, 2], "simulated")
    axes[0].set_ylabel("[body weight]")
    axes[1].set_xlabel("share of the foot's stance [%]; bands: people's standard deviation")
    legend_above(axes[0], 3)
    for axis in axes[1:]:
        axis.set_title(axis.get_title(loc="left"), pad=19)
    return values


def _humps(force: Array, who: str) -> dict[str, float]:
    """Largest force in the first and in the last 45 % of stance, and the least between 35 and 65 %."""
    count = len(force) - 1
    return {
        f"{who}_first": float(force[: round(0.45 * count) + 1].max()),
        f"{who}_valley": float(force[round(0.35 * count) : round(0.65 * count) + 1].min()),
        f"{who}_second": float(force[round(0.55 * count) :].max()),
    }
