"""Figures 4 and 5: COM, ZMP and ground force in both planes, as drawn geometry of a plan."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ampm.body import SoleGeometry
from ampm.gait import GaitPlan
from validation.paper_figures.canvas import COM, FAINT, FORCE, INK, PLAN, SHADE, ZMP, arrow

Array = NDArray[np.float64]

_WEIGHT_LENGTH = 0.62
"""Length at which a force of one body weight is drawn [m]."""
_INSTANTS = 5


def figure_4(plan: GaitPlan, sole: SoleGeometry) -> Figure:
    """Sagittal plane: COM, ZMP and ground force during single and double support, to scale.

    Args:
        plan: of a gait whose moment is not zero, or force and COM fall on one line.
        sole: for the soles' length.
    """
    constants, height = plan.constants, plan.parameters.com_height
    single, double = constants.single_support_duration, constants.double_support_duration
    figure = Figure(figsize=(8.2, 6.0))
    axes = figure.subplots(1, 2, width_ratios=[0.72, 0.92])
    for axis, start, duration, centre, letter in (
        (axes[0], 0.0, single, plan.footsteps[1].position[0], "a"),
        (axes[1], single, double, plan.footsteps[1].position[0] + 0.5 * plan.parameters.step_length, "b"),
    ):
        sample = plan.sample(start + duration * np.linspace(1e-9, 1 - 1e-9, _INSTANTS))
        com, zmp = sample.com[:, 0] - centre, sample.zmp[:, 0] - centre
        force = sample.force[:, [0, 2]] * _WEIGHT_LENGTH / (plan.mass * plan.gravity)
        feet = (
            (0.0,)
            if letter == "a"
            else (-0.5 * plan.parameters.step_length, 0.5 * plan.parameters.step_length)
        )
        for x in feet:
            _sole(axis, x + sole.heel_x, x + sole.tip_x)
        _travel(axis, com, zmp, height, force)
        names = ("P_0", "P_1", "Z_0", "Z_1") if letter == "a" else ("P_1", "P_0'", "Z_1", "Z_0'")
        length = ("l_s", constants.l_s, "a_s") if letter == "a" else ("l_d", constants.l_d, "a_d")
        for index, side, align in ((0, 0, "right"), (-1, 1, "left")):
            gap = 0.012 if side else -0.012
            axis.text(com[index] + gap, height + 0.022, f"${names[side]}$", ha=align, fontsize=11)
            axis.text(zmp[index] + gap, 0.022, f"${names[2 + side]}$", ha=align, fontsize=11, color=ZMP)
        _span(axis, com[0], com[-1], height + 0.095, f"$2\\,{length[0]}$ = {2e3 * length[1]:.0f} mm")
        _span(
            axis,
            zmp[0],
            zmp[-1],
            -0.062,
            f"$2\\,{length[0]}/{length[2]}$ = {1e3 * abs(zmp[-1] - zmp[0]):.0f} mm",
        )
        name, slope = ("c_s", plan.parameters.c_s) if letter == "a" else ("c_d", constants.c_d)
        phase = "single" if letter == "a" else "double"
        axis.set_title(f"({letter}) {phase} support, ${name}$ = {slope:.3g}, {duration:.3f} s")
        axis.set_xlabel(f"x from the {'stance foot' if letter == 'a' else 'midpoint of the feet'} [m]")
        _frame(axis, 0.36 if letter == "a" else 0.46, height)
    axes[0].set_ylabel("z [m]")
    axes[0].yaxis.set_label_coords(-0.12, 0.28)
    _key(figure, "Darker: later.")
    figure.subplots_adjust(left=0.1, right=0.985, bottom=0.155, top=0.94, wspace=0.2)
    return figure


def figure_5(plan: GaitPlan, sole: SoleGeometry) -> Figure:
    """Frontal plane: single support about the stance foot, double support about the middle.

    Args:
        plan: as for :func:`figure_4`.
        sole: for the soles' width.
    """
    constants, height = plan.constants, plan.parameters.com_height
    single, double = constants.single_support_duration, constants.double_support_duration
    half = 0.5 * plan.parameters.step_width
    figure = Figure(figsize=(8.2, 6.0))
    axes = figure.subplots(1, 2)
    for axis, letter in zip(axes, "ab", strict=True):
        start, duration, centre = (0.0, single, half) if letter == "a" else (single, double, 0.0)
        sample = plan.sample(start + duration * np.linspace(1e-9, 1 - 1e-9, _INSTANTS))
        com, zmp = sample.com[:, 1] - centre, sample.zmp[:, 1] - centre
        force = sample.force[:, [1, 2]] * _WEIGHT_LENGTH / (plan.mass * plan.gravity)
        for y in (half, -half):
            _sole(
                axis,
                y - centre - sole.half_width,
                y - centre + sole.half_width,
                quiet=letter == "a" and y < 0,
            )
        axis.axvline(-centre, color=FAINT, linewidth=0.7, linestyle=(0, (6, 3, 1, 3)))
        _travel(axis, com, zmp, height, force, returns=letter == "a")
        axis.set_xlim(*((-0.235, 0.075) if letter == "a" else (-0.155, 0.155)))
        axis.set_ylim(-0.16, height + 0.2)
        axis.grid(False)
        axis.set_yticks([0.0, 0.5, height], ["0", "0.5", f"$H$ = {height:g}"])
        axis.set_xlabel(f"y from the {'stance foot' if letter == 'a' else 'midline'}, left [m]")
        name = "single" if letter == "a" else "double"
        axis.set_title(f"({letter}) {name} support, $c_y$ = {plan.parameters.c_y:.3g}, {duration:.3f} s")
        if letter == "a":
            turn = float(np.max(com))
            _span(axis, -constants.s, 0.0, height + 0.125, f"$s$ = {1e3 * constants.s:.1f} mm")
            _span(
                axis, -half, -constants.s, -0.062, f"$\\beta$ = {1e3 * constants.beta:.1f} mm", aside=-0.047
            )
            axis.annotate(
                f"turns back at {-1e3 * turn:.0f} mm", (turn, height), (turn + 0.012, height - 0.1),
                fontsize=8, color=FAINT, arrowprops={"arrowstyle": "-", "color": FAINT, "linewidth": 0.6},
            )  # fmt: skip
            axis.text(-half - 0.004, 0.3, "midline", ha="right", rotation=90, fontsize=8, color=FAINT)
        else:
            _span(axis, com[0], com[-1], height + 0.125, f"$2\\beta$ = {2e3 * constants.beta:.1f} mm")
            _span(axis, zmp[0], zmp[-1], -0.062, f"$2(s + \\beta)$ = {2e3 * half:.0f} mm")
    axes[0].set_ylabel("z [m]")
    axes[0].yaxis.set_label_coords(-0.12, 0.28)
    _key(
        figure, "Darker: later. Widths are stretched. In (a) the way back is drawn lower than the way there."
    )
    figure.subplots_adjust(left=0.1, right=0.985, bottom=0.165, top=0.94, wspace=0.22)
    return figure


def _travel(
    axis: Axes, com: Array, zmp: Array, height: float, force: Array, *, returns: bool = False
) -> None:
    """COM and ZMP at some instants, the line between them, and the force on the body."""
    level = height + (np.array([0.02, 0.01, 0.0, -0.01, -0.02]) if returns else np.zeros(len(com)))
    axis.plot(com, level, color=PLAN, linewidth=5, alpha=0.7, zorder=2)
    axis.plot([zmp.min(), zmp.max()], [0, 0], color=ZMP, linewidth=4, alpha=0.35, zorder=2)
    for index in range(len(com)):
        # The way back of a path that turns covers the way there.
        alpha = 0.35 + 0.65 * index / (len(com) - 1)
        axis.plot(
            [zmp[index], com[index]],
            [0, level[index]],
            color=FAINT,
            linewidth=0.7,
            linestyle=(0, (3, 2)),
            zorder=1,
        )
        foot = np.array([zmp[index], 0.0])
        arrow(axis, foot, foot + force[index], alpha=alpha)
        axis.plot(com[index], level[index], "o", color=COM, markersize=5, alpha=alpha, zorder=5)
        axis.plot(zmp[index], 0.0, "s", color=ZMP, markersize=4.5, alpha=alpha, zorder=5)


def _key(figure: Figure, note: str) -> None:
    """Legend and note under both drawings."""
    handles = [
        Line2D([], [], color=COM, marker="o", markersize=5, linestyle="", label="COM"),
        Line2D([], [], color=ZMP, marker="s", markersize=4.5, linestyle="", label="ZMP"),
        Line2D([], [], color=FORCE, linewidth=1.4, label="ground force"),
        Line2D([], [], color=FAINT, linewidth=0.7, linestyle=(0, (3, 2)), label="line from ZMP to COM"),
    ]
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.07, 0.012), ncols=4, fontsize=8.5)
    figure.text(0.1, 0.008, note, fontsize=8, color=FAINT)


def _sole(axis: Axes, back: float, front: float, *, quiet: bool = False) -> None:
    axis.fill_between(
        [back, front], -0.022, -0.004, color=SHADE if quiet else "#cbd2d9", linewidth=0, zorder=1
    )


def _span(axis: Axes, low: float, high: float, level: float, text: str, aside: float = 0.0) -> None:
    """A dimension line with its text above or below."""
    axis.annotate(
        "", xy=(high, level), xytext=(low, level),
        arrowprops={"arrowstyle": "|-|,widthA=0.25,widthB=0.25", "color": INK, "linewidth": 0.7,
                    "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    below = level < 0
    axis.text(
        0.5 * (low + high) + aside, level + (-0.016 if below else 0.014), text, ha="center",
        va="top" if below else "bottom", fontsize=8.5,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
    )  # fmt: skip


def _frame(axis: Axes, reach: float, height: float) -> None:
    axis.set_aspect("equal")
    axis.set_xlim(-reach, reach)
    axis.set_ylim(-0.16, height + 0.2)
    axis.grid(False)
    axis.set_yticks([0.0, 0.5, height], ["0", "0.5", f"$H$ = {height:g}"])
