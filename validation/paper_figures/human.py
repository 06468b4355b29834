"""How human the gaits are: angular momentum and ground forces beside what is published of people.

Momentum is made dimensionless as Herr & Popovic (2008) do: by mass, mean speed and height of the COM.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ampm.exceptions import AmpmError
from ampm.gait import GaitPlan, plan_gait
from ampm.parameters import RunParameters, load_run
from validation.paper_figures.canvas import BAND, FAINT, INK, LEFT, MEASURED, PLAN, inches, legend_above
from validation.paper_figures.walks import Walk, Walks

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

HUMAN_FORCE: Mapping[str, tuple[tuple[float, float], ...]] = {
    "vertical": (
        (0, 0), (7, 0.5), (14, 0.95), (23, 1.1), (36, 0.88), (50, 0.78), (63, 0.88), (77, 1.1), (88, 0.8),
        (95, 0.3), (100, 0),
    ),
    "forward": (
        (0, 0), (6, -0.1), (16, -0.2), (35, -0.07), (53, 0.0), (70, 0.09), (86, 0.2), (95, 0.08), (100, 0),
    ),
    "medial": ((0, 0), (4, -0.02), (10, 0.02), (25, 0.05), (50, 0.03), (75, 0.05), (90, 0.02), (100, 0)),
}  # fmt: skip
"""Outline of one foot's ground force in walking at a comfortable speed: share of the stance [%], force [body
weight]. Key points of the curve that textbooks print (Winter 2009, Biomechanics and Motor Control of Human
Movement, 4th ed., ch. 5; peaks of 1.0-1.5 body weights over all speeds: Nilsson & Thorstensson 1989), joined
smoothly: an outline to see the kind of difference by, no measurement."""

_SCAN = {"c_y": np.arange(0.05, 1.501, 0.01), "c_s": np.arange(0.5, 1.801, 0.01)}


def figure_human(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Angular momentum of the demos, the range of c_y and c_s nearest to people, and ground forces."""
    demos = {label: walks.walk(gait, settings) for label, (gait, *settings) in GAITS.items()}
    scans = ranges(load_run("normal"))
    numbers: dict[str, Any] = {
        "peaks": {label: peaks(walk) for label, walk in demos.items()},
        "ranges": {key: {name: found[name] for name in ("low", "high")} for key, found in scans.items()},
    }
    figure = Figure(figsize=(9.6, 9.9))
    _bars([inches(figure, 1.2 + 2.88 * k, 0.62, 2.4, 2.3) for k in range(3)], numbers["peaks"])
    for k, (key, axis) in enumerate((("c_y", "x"), ("c_s", "y"))):
        _range(inches(figure, 0.85 + 4.55 * k, 4.1, 3.95, 1.75), key, axis, scans[key])
    panels = [inches(figure, 0.8 + 3.0 * k, 7.0, 2.45, 2.3) for k in range(3)]
    numbers["forces"] = _forces(panels, demos["normal"])
    return figure, numbers


def scale(plan: GaitPlan) -> float:
    """Mass times mean speed times height of the COM [N m s]."""
    return plan.mass * plan.constants.mean_velocity * plan.parameters.com_height


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
    for key, axis in (("c_y", 0), ("c_s", 1)):
        values, found = [], []
        for value in _SCAN[key]:
            gait = run.gait.model_copy(update={key: float(value), "steps": 2})
            try:
                plan = plan_gait(gait, mass=run.body.mass)
            except AmpmError:
                continue
            sample = plan.sample(np.linspace(0.0, plan.duration, 801))
            values.append(float(value))
            found.append(float(np.abs(sample.angular_momentum[:, axis]).max()) / scale(plan))
        within = [v for v, peak in zip(values, found, strict=True) if peak <= HUMAN_MOMENTUM["xy"[axis]]]
        answer[key] = {"values": values, "peaks": found, "low": min(within), "high": max(within)}
    return answer


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
    axis.axvspan(found["low"], found["high"], color=LEFT, alpha=0.12, linewidth=0)
    axis.set_ylim(0, min(max(found["peaks"]), 8 * bound))
    axis.set_xlim(found["values"][0], found["values"][-1])
    axis.set_title(
        f"planned peak of $|L_{letter}|$ / (m V H); within: ${key}$ {found['low']:.2f} to {found['high']:.2f}"
    )
    axis.set_xlabel(f"${key}$")
    legend_above(axis)


def _forces(axes: Sequence[Axes], walk: Walk) -> dict[str, dict[str, float]]:
    """One foot's ground force over its stance, beside the outline of people's."""
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
    said = {}
    panels = (("vertical", 2, 1.0), ("forward", 0, 1.0), ("medial", 1, -1.0))
    for axis, (name, component, sign) in zip(axes, panels, strict=True):
        points = np.array(HUMAN_FORCE[name])
        ours = sign * folds[..., component]
        outline = PchipInterpolator(points[:, 0], points[:, 1])(100 * share)
        axis.axhline(0.0, color=FAINT, linewidth=0.6)
        axis.plot(100 * share, outline, color=BAND, linewidth=4, label="people (outline)")
        axis.fill_between(
            100 * share, ours.min(axis=0), ours.max(axis=0), color=MEASURED, alpha=0.3, linewidth=0
        )
        axis.plot(100 * share, ours.mean(axis=0), color=MEASURED, linewidth=1.1, label="simulation")
        axis.set_xlim(0, 100)
        axis.set_title(f"{name} force on one foot")
        said[name] = {
            "simulated_largest": float(ours.max()),
            "simulated_smallest": float(ours.min()),
            "people_largest": float(points[:, 1].max()),
            "people_smallest": float(points[:, 1].min()),
        }
    axes[0].set_ylabel("[body weight]")
    axes[1].set_xlabel("share of the foot's stance [%]")
    legend_above(axes[0])
    for axis in axes[1:]:
        axis.set_title(axis.get_title(loc="left"), pad=19)
    return said


def table(numbers: Mapping[str, Any]) -> str:
    """The demos' momentum as a Markdown table.

    Args:
        numbers: as :func:`figure_human` gives them.
    """
    lines = ["| gait | L_x / (m V H) | L_y / (m V H) | L_z / (m V H) |", "|---|---|---|---|"]
    bounds = " | ".join(f"≤ {HUMAN_MOMENTUM[axis]:g}" for axis in "xyz")
    lines.append(f"| people | {bounds} |")
    for gait, found in numbers["peaks"].items():
        cells = [f"{found[a]:.3f}" + (" (within)" if found[a] <= HUMAN_MOMENTUM[a] else "") for a in "xyz"]
        lines.append(f"| `{gait}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def ranges_table(numbers: Mapping[str, Any]) -> str:
    """The ranges of c_y and c_s within the human bounds as a Markdown table."""
    lines = ["| parameter | bound on people | nearest to people |", "|---|---|---|"]
    for key, axis in (("c_y", "x"), ("c_s", "y")):
        found = numbers["ranges"][key]
        bound = f"L_{axis} / (m V H) ≤ {HUMAN_MOMENTUM[axis]:g}"
        lines.append(f"| `gait.{key}` | {bound} | {found['low']:.2f} to {found['high']:.2f} |")
    return "\n".join(lines)


def forces_table(numbers: Mapping[str, Any]) -> str:
    """One foot's ground force, smallest and largest, as a Markdown table."""
    lines = ["| force on one foot [body weight] | people (outline) | simulation, `normal` |", "|---|---|---|"]
    for name, found in numbers["forces"].items():
        people, ours = (
            f"{found[f'{who}_smallest']:.2f} to {found[f'{who}_largest']:.2f}"
            for who in ("people", "simulated")
        )
        lines.append(f"| {name} | {people} | {ours} |")
    return "\n".join(lines)
