"""Figures 4 and 5: COM, ZMP and ground force in both planes, in plan, motion and simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ampm.description import SoleGeometry
from validation.paper.figures.canvas import (
    COM,
    FAINT,
    FORCE,
    INK,
    MEASURED,
    MOTION,
    PLAN,
    SHADE,
    ZMP,
    arrow,
    inches,
)
from validation.paper.figures.centroidal import peak
from validation.paper.figures.panels import band_legend, difference
from validation.paper.figures.walks import Walk

Array = NDArray[np.float64]

_WEIGHT_LENGTH = 0.62
"""Length at which a force of one body weight is drawn [m]."""
_INSTANTS = 5
_HEIGHT = 9.65  # of both figures [in]


def figure_4(walk: Walk, sole: SoleGeometry) -> Figure:
    """Sagittal plane: COM, ZMP and ground force during single and double support, to scale.

    Args:
        walk: of a gait whose moment is not zero, or force and COM fall on one line.
        sole: for the soles' length.
    """
    plan = walk.plan
    constants, height = plan.constants, plan.com_height
    single, double = constants.single_support_duration, constants.double_support_duration
    figure, axes, panels = _paper((2.88, 3.68), (0.8, 4.75))
    for axis, start, duration, centre, letter in (
        (axes[0], 0.0, single, plan.contacts.footsteps[1].position[0], "a"),
        (axes[1], single, double, plan.contacts.footsteps[1].position[0] + 0.5 * walk.gait.step_length, "b"),
    ):
        sample = plan.sample(start + duration * np.linspace(1e-9, 1 - 1e-9, _INSTANTS))
        com, zmp = sample.com[:, 0] - centre, sample.zmp[:, 0] - centre
        force = sample.force[:, [0, 2]] * _WEIGHT_LENGTH / (plan.mass * plan.gravity)
        feet = (0.0,) if letter == "a" else (-0.5 * walk.gait.step_length, 0.5 * walk.gait.step_length)
        for x in feet:
            _sole(axis, x + sole.heel_x, x + sole.tip_x)
        _travel(axis, com, zmp, height, force)
        _walked(axis, walk, start, duration, centre, 0)
        names = ("P_0", "P_1", "Z_0", "Z_1") if letter == "a" else ("P_1", "P_0'", "Z_1", "Z_0'")
        length = ("l_s", constants.l_s, "a_s") if letter == "a" else ("l_d", constants.l_d, "a_d")
        for index, side, align in ((0, 0, "right"), (-1, 1, "left")):
            gap = 0.012 if side else -0.012
            axis.text(com[index] + gap, height + 0.022, f"${names[side]}$", ha=align, fontsize=11)
            axis.text(zmp[index] + gap, 0.022, f"${names[2 + side]}$", ha=align, fontsize=11, color=ZMP)
        _span(axis, com[0], com[-1], height + 0.095, f"$2\\,{length[0]}$ = {2e3 * length[1]:.0f} mm")
        travel = f"$2\\,{length[0]}/{length[2]}$ = {1e3 * abs(zmp[-1] - zmp[0]):.0f} mm"
        _span(axis, zmp[0], zmp[-1], -0.062, travel)
        name, slope = ("c_s", walk.gait.c_s) if letter == "a" else ("c_d", constants.c_d)
        phase = "single" if letter == "a" else "double"
        axis.set_title(f"({letter}) {phase} support, ${name}$ = {slope:.3g}, {duration:.3f} s")
        axis.set_xlabel(f"x from the {'stance foot' if letter == 'a' else 'midpoint of the feet'} [m]")
        axis.set_aspect("equal")
        _frame(axis, (-0.36, 0.36) if letter == "a" else (-0.46, 0.46), height)
    axes[0].set_ylabel("z [m]")
    axes[0].yaxis.set_label_coords(-0.12, 0.28)
    _key(figure, "Darker: later. In the drawings plan, IK and simulation cover each other; below, enlarged.")
    _errors(panels, walk, 0)
    return figure


def figure_5(walk: Walk, sole: SoleGeometry) -> Figure:
    """Frontal plane: single support about the stance foot, double support about the middle.

    Args:
        walk: as for :func:`figure_4`.
        sole: for the soles' width.
    """
    plan = walk.plan
    constants, height = plan.constants, plan.com_height
    single, double = constants.single_support_duration, constants.double_support_duration
    half = 0.5 * walk.gait.step_width
    figure, axes, panels = _paper((3.6, 3.6), (0.8, 4.85))
    for axis, letter in zip(axes, "ab", strict=True):
        start, duration, centre = (0.0, single, half) if letter == "a" else (single, double, 0.0)
        sample = plan.sample(start + duration * np.linspace(1e-9, 1 - 1e-9, _INSTANTS))
        com, zmp = sample.com[:, 1] - centre, sample.zmp[:, 1] - centre
        force = sample.force[:, [1, 2]] * _WEIGHT_LENGTH / (plan.mass * plan.gravity)
        for y in (half, -half):
            edges = (y - centre - sole.half_width, y - centre + sole.half_width)
            _sole(axis, *edges, faint=letter == "a" and y < 0)
        axis.axvline(-centre, color=FAINT, linewidth=0.7, linestyle=(0, (6, 3, 1, 3)))
        _travel(axis, com, zmp, height, force, returns=letter == "a")
        _walked(axis, walk, start, duration, centre, 1, returns=letter == "a")
        _frame(axis, (-0.235, 0.075) if letter == "a" else (-0.155, 0.155), height)
        axis.set_xlabel(f"y from the {'stance foot' if letter == 'a' else 'midline'}, left [m]")
        name = "single" if letter == "a" else "double"
        axis.set_title(f"({letter}) {name} support, $c_y$ = {walk.gait.c_y:.3g}, {duration:.3f} s")
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
    _errors(panels, walk, 1)
    return figure


def numbers(walk: Walk, component: int) -> dict[str, dict[str, float | str]]:
    """How far the COM and the ZMP of motion and simulation are from the plan, along one axis."""
    name = "xy"[component]
    return peak(
        {f"{what} {name}": walk.deviation[what.lower()].component(component) for what in ("COM", "ZMP")}, "m"
    )


def _paper(
    widths: tuple[float, float], lefts: tuple[float, float]
) -> tuple[Figure, list[Axes], list[list[Axes]]]:
    """Two drawings, single and double support, each over its errors of the ZMP and of the COM."""
    figure = Figure(figsize=(8.6, _HEIGHT))
    axes = [inches(figure, x, 0.35, w, 4.9) for x, w in zip(lefts, widths, strict=True)]
    panels = [[inches(figure, x, top, 3.45, 1.05) for x in (0.8, 5.0)] for top in (6.65, 8.05)]
    for axis in panels[0]:
        axis.tick_params(labelbottom=False)
    return figure, axes, panels


def _errors(panels: Sequence[Sequence[Axes]], walk: Walk, component: int) -> None:
    """ZMP and COM of motion and simulation less the plan, in single and in double support."""
    single, step = walk.double_supports[0]
    name = "xy"[component]
    for row, (axes, what) in enumerate(zip(panels, ("ZMP", "COM"), strict=True)):
        tolerance = 1e3 * walk.limit(f"zmp_{name}_rmse") if what == "ZMP" else None
        for column, (axis, (start, end)) in enumerate(
            zip(axes, ((0.0, single), (single, step)), strict=True)
        ):
            rows = (walk.phase >= start) & (walk.phase <= end)
            motion, simulated = walk.deviation[what.lower()].component(component, rows)
            time = walk.phase[rows] - start
            difference(axis, time, 1e3 * motion, 1e3 * simulated, tolerance=tolerance, unit="mm")
            axis.set_xlim(0.0, time[-1])
            if row == 1:
                axis.set_xlabel(f"time from the start of {('single', 'double')[column]} support [s]")
            if column == 0:
                axis.set_ylabel(f"{what} {name} less\nplan [mm]")
                axis.yaxis.set_label_coords(-0.13, 0.5)
                band_legend(axis)


def _walked(
    axis: Axes, walk: Walk, start: float, duration: float, centre: float, component: int, *,
    returns: bool = False,
) -> None:  # fmt: skip
    """COM, ZMP and force of the motion and of the simulation (mean of the strides) over the drawn plan."""
    # The same instants as those of the plan: in a double support the ZMP moves 7 mm in 2 ms.
    share = np.linspace(1e-9, 1 - 1e-9, 40 * (_INSTANTS - 1) + 1)
    time = start + duration * share
    planned = walk.plan.sample(time)
    lift = 0.02 - 0.04 * share if returns else np.zeros(len(time))

    def at_instants(values: Array) -> Array:
        return np.column_stack([np.interp(time, walk.phase, column) for column in values.T])

    away = {
        name: (at_instants(item.motion), at_instants(item.simulation.mean(axis=0)))
        for name, item in walk.deviation.items()
    }
    for which, (color, width) in enumerate(((MOTION, 2.0), (MEASURED, 0.9))):
        com, zmp = planned.com + away["com"][which], planned.zmp + away["zmp"][which]
        style: Any = {"color": color, "zorder": 2.2 + which}
        axis.plot(com[:, component] - centre, com[:, 2] + lift, linewidth=width, **style)
        axis.plot(
            zmp[:, component] - centre, np.zeros(len(zmp)), color=color, linewidth=width, zorder=2.2 + which
        )
        force = (planned.force + away["force"][which]) * _WEIGHT_LENGTH / (walk.plan.mass * walk.plan.gravity)
        for index in range(0, len(time), 40):
            foot = np.array([zmp[index, component] - centre, 0.0])
            tip = foot + force[index, [component, 2]]
            axis.plot(*np.column_stack([foot, tip]), color=color, linewidth=0.6 * width, zorder=4.2 + which)


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
        line: Any = {"color": FAINT, "linewidth": 0.7, "linestyle": (0, (3, 2)), "zorder": 1}
        axis.plot([zmp[index], com[index]], [0, level[index]], **line)
        foot = np.array([zmp[index], 0.0])
        arrow(axis, foot, foot + force[index], alpha=alpha)
        axis.plot(com[index], level[index], "o", color=COM, markersize=5, alpha=alpha, zorder=5)
        axis.plot(zmp[index], 0.0, "s", color=ZMP, markersize=4.5, alpha=alpha, zorder=5)


def _key(figure: Figure, note: str) -> None:
    """Legend and note under both drawings."""
    handles = [
        Line2D([], [], color=COM, marker="o", markersize=5, linestyle="", label="COM, plan"),
        Line2D([], [], color=ZMP, marker="s", markersize=4.5, linestyle="", label="ZMP, plan"),
        Line2D([], [], color=FORCE, linewidth=1.4, label="ground force, plan"),
        Line2D([], [], color=FAINT, linewidth=0.7, linestyle=(0, (3, 2)), label="line from ZMP to COM"),
        Line2D([], [], color=MOTION, linewidth=2.0, label="the same, IK"),
        Line2D([], [], color=MEASURED, linewidth=0.9, label="the same, simulation"),
    ]
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.07, 1.0 - 5.72 / _HEIGHT), ncols=6, fontsize=8,
        columnspacing=1.0, handlelength=1.4, handletextpad=0.4,
    )  # fmt: skip
    figure.text(0.093, 1.0 - 6.12 / _HEIGHT, note, fontsize=8, color=FAINT)


def _sole(axis: Axes, back: float, front: float, *, faint: bool = False) -> None:
    axis.fill_between(
        [back, front], -0.022, -0.004, color=SHADE if faint else "#cbd2d9", linewidth=0, zorder=1
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


def _frame(axis: Axes, sides: tuple[float, float], height: float) -> None:
    axis.set_xlim(*sides)
    axis.set_ylim(-0.16, height + 0.2)
    axis.grid(False)
    axis.set_yticks([0.0, 0.5, height], ["0", "0.5", f"$H$ = {height:g}"])
