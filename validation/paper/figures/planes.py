"""Figures 4 and 5: COM, ZMP and ground force in both planes, in plan, motion and simulation.

The gait's moment must not be zero, otherwise the force passes through the COM.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ampm.geometry import Array
from validation.paper.figures.canvas import (
    DASHED,
    FAINT,
    FORCE,
    INK,
    MEASURED,
    MOTION,
    PLAN,
    SHADE,
    arrow,
    band_legend,
    difference,
    inches,
)
from validation.paper.figures.walks import Numbers, Walk, Walks, less_plan

_WEIGHT_LENGTH = 0.62
"""Length at which a force of one body weight is drawn [m]."""
_INSTANTS = 5
_BETWEEN = 40  # points of a curve from one instant to the next
_HEIGHT = 9.65  # of both figures [in]


def figure_4(walks: Walks) -> tuple[Figure, Numbers]:
    """Sagittal plane: COM, ZMP and ground force during single and double support, to scale."""
    walk = walks.walk("momentum")
    plan, gait, sole = walk.plan, walk.gait, walk.robot.description.sole
    constants, half, stance = plan.constants, 0.5 * gait.step_length, plan.contacts.footsteps[1].position[0]
    figure, (single, double) = _paper((2.88, 3.68), (0.8, 4.75))

    _sole(single, sole.heel_x, sole.tip_x)
    com, zmp = _support(single, walk, 0, 0.0, walk.single, stance)
    _name_ends(single, com, gait.com_height + 0.022, "P_0", "P_1", INK)
    _name_ends(single, zmp, 0.022, "Z_0", "Z_1", FORCE)
    _span(single, com[0], com[-1], gait.com_height + 0.095, f"$2\\,l_s$ = {2e3 * constants.l_s:.0f} mm")
    _span(single, zmp[0], zmp[-1], -0.062, f"$2\\,l_s/a_s$ = {1e3 * abs(zmp[-1] - zmp[0]):.0f} mm")
    single.set_title(f"(a) single support, $c_s$ = {gait.c_s:.3g}, {walk.single:.3f} s")
    single.set(xlabel="x from the stance foot [m]", xlim=(-0.36, 0.36), aspect="equal")

    for x in (-half, half):
        _sole(double, x + sole.heel_x, x + sole.tip_x)
    com, zmp = _support(double, walk, 0, walk.single, walk.double, stance + half)
    _name_ends(double, com, gait.com_height + 0.022, "P_1", "P_0'", INK)
    _name_ends(double, zmp, 0.022, "Z_1", "Z_0'", FORCE)
    _span(double, com[0], com[-1], gait.com_height + 0.095, f"$2\\,l_d$ = {2e3 * constants.l_d:.0f} mm")
    _span(double, zmp[0], zmp[-1], -0.062, f"$2\\,l_d/a_d$ = {1e3 * abs(zmp[-1] - zmp[0]):.0f} mm")
    double.set_title(f"(b) double support, $c_d$ = {constants.c_d:.3g}, {walk.double:.3f} s")
    double.set(xlabel="x from the midpoint of the feet [m]", xlim=(-0.46, 0.46), aspect="equal")
    _key(figure, "Darker: later. In the drawings plan, IK and simulation cover each other; below, enlarged.")
    return figure, _errors(figure, walk, 0)


def figure_5(walks: Walks) -> tuple[Figure, Numbers]:
    """Frontal plane: single support about the stance foot, double support about the middle."""
    walk = walks.walk("momentum")
    constants, height, sole = walk.plan.constants, walk.gait.com_height, walk.robot.description.sole
    half = 0.5 * walk.gait.step_width
    figure, axes = _paper((3.6, 3.6), (0.8, 4.85))
    for axis, centre in zip(axes, (half, 0.0), strict=True):
        for y in (half, -half):
            edges = (y - centre - sole.half_width, y - centre + sole.half_width)
            _sole(axis, *edges, color=SHADE if y < 0 < centre else _SOLE)
        axis.axvline(-centre, color=FAINT, linewidth=0.7, linestyle=(0, (6, 3, 1, 3)))
    slope = f"$c_y$ = {walk.gait.c_y:.3g}"

    axis = axes[0]
    com, _ = _support(axis, walk, 1, 0.0, walk.single, half, returns=True)
    axis.set(xlabel="y from the stance foot, left [m]", xlim=(-0.235, 0.075))
    axis.set_title(f"(a) single support, {slope}, {walk.single:.3f} s")
    _span(axis, -constants.s, 0.0, height + 0.125, f"$s$ = {1e3 * constants.s:.1f} mm")
    _span(axis, -half, -constants.s, -0.062, f"$\\beta$ = {1e3 * constants.beta:.1f} mm", aside=-0.047)
    turn = float(np.max(com))
    axis.annotate(
        f"turns back at {-1e3 * turn:.0f} mm", (turn, height), (turn + 0.012, height - 0.1),
        fontsize=8, color=FAINT, arrowprops={"arrowstyle": "-", "color": FAINT, "linewidth": 0.6},
    )  # fmt: skip
    axis.text(-half - 0.004, 0.3, "midline", ha="right", rotation=90, fontsize=8, color=FAINT)

    axis = axes[1]
    com, zmp = _support(axis, walk, 1, walk.single, walk.double, 0.0)
    axis.set(xlabel="y from the midline, left [m]", xlim=(-0.155, 0.155))
    axis.set_title(f"(b) double support, {slope}, {walk.double:.3f} s")
    _span(axis, com[0], com[-1], height + 0.125, f"$2\\beta$ = {2e3 * constants.beta:.1f} mm")
    _span(axis, zmp[0], zmp[-1], -0.062, f"$2(s + \\beta)$ = {2e3 * half:.0f} mm")
    _key(
        figure, "Darker: later. Widths are stretched. In (a) the way back is drawn lower than the way there."
    )
    return figure, _errors(figure, walk, 1)


def _paper(widths: tuple[float, float], lefts: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Two drawings, of single and of double support."""
    figure = Figure(figsize=(8.6, _HEIGHT))
    axes = [inches(figure, x, 0.35, w, 4.9) for x, w in zip(lefts, widths, strict=True)]
    axes[0].set_ylabel("z [m]")
    axes[0].yaxis.set_label_coords(-0.12, 0.28)
    return figure, axes


def _errors(figure: Figure, walk: Walk, component: int) -> Numbers:
    """Draw COM and ZMP of motion and simulation less the plan, in both supports; return their sizes."""
    name = "xy"[component]
    numbers: Numbers = {}
    for what, top in (("COM", 8.05), ("ZMP", 6.65)):
        motion, simulated = walk.away(what.lower(), component)
        numbers |= less_plan(f"{what} {name}", motion, simulated, "m")
        tolerance = 1e3 * walk.limit(f"zmp_{name}_rmse") if what == "ZMP" else None
        for left, support, start, end in (
            (0.8, "single", 0.0, walk.single),
            (5.0, "double", walk.single, walk.double_supports[0][1]),
        ):
            axis = inches(figure, left, top, 3.45, 1.05)
            rows = (walk.phase >= start) & (walk.phase <= end)
            time, errors = walk.phase[rows] - start, simulated[:, rows]
            difference(axis, time, 1e3 * motion[rows], 1e3 * errors, tolerance=tolerance, unit="mm")
            axis.set_xlim(0.0, time[-1])
            if what == "ZMP":
                axis.tick_params(labelbottom=False)
            else:
                axis.set_xlabel(f"time from the start of {support} support [s]")
            if support == "single":
                axis.set_ylabel(f"{what} {name} less\nplan [mm]")
                axis.yaxis.set_label_coords(-0.13, 0.5)
                band_legend(axis)
    return numbers


def _support(
    axis: Axes, walk: Walk, component: int, start: float, duration: float, centre: float, *,
    returns: bool = False,
) -> tuple[Array, Array]:  # fmt: skip
    """Draw COM, ZMP and ground force in one plane during a support, and the line from ZMP to COM.

    The plan at some instants, motion and simulation (mean of the strides) as curves over it. The way back of
    a path that ``returns`` is drawn lower, to keep both ways visible.

    Returns:
        Planned COM and ZMP at the instants, from ``centre`` [m].
    """
    plan = walk.plan
    height, per_weight = walk.gait.com_height, _WEIGHT_LENGTH / (plan.mass * plan.gravity)
    # The same instants of all three: in a double support the ZMP moves 7 mm in 2 ms.
    share = np.linspace(1e-9, 1 - 1e-9, _BETWEEN * (_INSTANTS - 1) + 1)
    sample = plan.sample(start + duration * share)
    lift = 0.02 - 0.04 * share if returns else np.zeros(len(share))
    at = slice(None, None, _BETWEEN)

    com, zmp = sample.com[at, component] - centre, sample.zmp[at, component] - centre
    level, force = height + lift[at], sample.force[at][:, [component, 2]] * per_weight
    axis.plot(com, level, color=PLAN, linewidth=5, alpha=0.7, zorder=2)
    axis.plot([zmp.min(), zmp.max()], [0, 0], color=FORCE, linewidth=4, alpha=0.35, zorder=2)
    for index, alpha in enumerate(np.linspace(0.35, 1.0, _INSTANTS)):
        line: Any = {"color": FAINT, "linewidth": 0.7, "linestyle": DASHED, "zorder": 1}
        axis.plot([zmp[index], com[index]], [0, level[index]], **line)
        foot = np.array([zmp[index], 0.0])
        arrow(axis, foot, foot + force[index], alpha=alpha)
        axis.plot(com[index], level[index], "o", color=INK, markersize=5, alpha=alpha, zorder=5)
        axis.plot(zmp[index], 0.0, "s", color=FORCE, markersize=4.5, alpha=alpha, zorder=5)

    def also(name: str, simulation: bool) -> Array:
        values = walk.deviation[name][1].mean(axis=0) if simulation else walk.deviation[name][0]
        columns = [np.interp(start + duration * share, walk.phase, column) for column in values.T]
        return np.asarray(getattr(sample, name) + np.column_stack(columns))

    for simulation, color, width in ((False, MOTION, 2.0), (True, MEASURED, 0.9)):
        place, point = also("com", simulation), also("zmp", simulation)[:, component] - centre
        style: Any = {"color": color, "zorder": 2.2 + simulation}
        axis.plot(place[:, component] - centre, place[:, 2] + lift, linewidth=width, **style)
        axis.plot(point, np.zeros(len(point)), linewidth=width, **style)
        arrows = also("force", simulation)[at][:, [component, 2]] * per_weight
        for x, (along, up) in zip(point[at], arrows, strict=True):
            axis.plot([x, x + along], [0.0, up], color=color, linewidth=0.6 * width, zorder=4.2 + simulation)
    axis.set_ylim(-0.16, height + 0.2)
    axis.grid(False)
    axis.set_yticks([0.0, 0.5, height], ["0", "0.5", f"$H$ = {height:g}"])
    return com, zmp


def _key(figure: Figure, note: str) -> None:
    """Legend and note under both drawings."""
    handles = [
        Line2D([], [], color=INK, marker="o", markersize=5, linestyle="", label="COM, plan"),
        Line2D([], [], color=FORCE, marker="s", markersize=4.5, linestyle="", label="ZMP, plan"),
        Line2D([], [], color=FORCE, linewidth=1.4, label="ground force, plan"),
        Line2D([], [], color=FAINT, linewidth=0.7, linestyle=DASHED, label="line from ZMP to COM"),
        Line2D([], [], color=MOTION, linewidth=2.0, label="the same, IK"),
        Line2D([], [], color=MEASURED, linewidth=0.9, label="the same, simulation"),
    ]
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.07, 1.0 - 5.72 / _HEIGHT), ncols=6, fontsize=8,
        columnspacing=1.0, handlelength=1.4, handletextpad=0.4,
    )  # fmt: skip
    figure.text(0.093, 1.0 - 6.12 / _HEIGHT, note, fontsize=8, color=FAINT)


_SOLE = "#cbd2d9"


def _sole(axis: Axes, back: float, front: float, color: str = _SOLE) -> None:
    axis.fill_between([back, front], -0.022, -0.004, color=color, linewidth=0, zorder=1)


def _name_ends(axis: Axes, path: Array, level: float, first: str, last: str, color: str) -> None:
    """Names of the ends of a path, beside them."""
    for end, gap, align, name in ((path[0], -0.012, "right", first), (path[-1], 0.012, "left", last)):
        axis.text(end + gap, level, f"${name}$", ha=align, fontsize=11, color=color)


def _span(axis: Axes, low: float, high: float, level: float, text: str, aside: float = 0.0) -> None:
    """A dimension line with its text above or below."""
    axis.annotate(
        "", xy=(high, level), xytext=(low, level),
        arrowprops={"arrowstyle": "|-|,widthA=0.25,widthB=0.25", "color": INK, "linewidth": 0.7,
                    "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    offset, align = (-0.016, "top") if level < 0 else (0.014, "bottom")
    axis.text(
        0.5 * (low + high) + aside, level + offset, text, ha="center", va=align, fontsize=8.5,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
    )  # fmt: skip
