"""Figures 8, 11 and 12: bodies in motion, posed from the simulated joint angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.paper.figures.canvas import (
    FAINT,
    FORCE,
    INK,
    LEFT,
    MEASURED,
    MOTION,
    PLAN,
    RIGHT,
    SHADE,
    arrow,
    bare,
    inches,
    legend_above,
    shade,
)
from validation.paper.figures.centroidal import of_motion
from validation.paper.figures.panels import band_legend, curves, difference
from validation.paper.figures.skeleton import FRONT, SIDE, draw, mark_com, outline, pose
from validation.paper.figures.walks import Walk
from validation.trial.bridge import to_pinocchio
from validation.trial.plan import PlannedWalk

Array = NDArray[np.float64]

_WIDTH = 9.6
_WEIGHT_LENGTH = 0.55
_FRAMES = 9
_LINES = ("-", (0, (4, 2)))  # of the two walks that a figure compares
_STRIP = 2.3  # height of a strip of frames [in]
_LOADED = 0.08
"""Share of the weight from which on a foot's force is drawn: an arrow needs room for its head [1]."""


def figure_8(walk: Walk) -> Figure:
    """Side view of a gait: where it was walked, a stride in frames, and the COM's distance from the plan."""
    figure = Figure(figsize=(_WIDTH, 10.25))
    trace = inches(figure, 0.6, 0.42, _WIDTH - 0.8, 3.6)
    strip = inches(figure, 0.6, 5.05, _WIDTH - 0.8, _STRIP)
    _trace(trace, figure, walk)
    trace.set_title("Simulated gait where it was walked, every tenth of a step")
    _strip(strip, figure, walk, SIDE)
    strip.set_title("One stride, frame by frame")
    lefts, share = (0.7, 3.75, 6.8), walk.phase / walk.stride
    for component, left in enumerate(lefts):
        axis = inches(figure, left, 8.35, 2.45, 1.3)
        motion, simulated = walk.deviation["com"].component(component)
        difference(axis, share, 1e3 * motion, 1e3 * simulated)
        _stride_axis(axis, walk)
        axis.set_title(f"COM less plan, {'xyz'[component]}", pad=16)
    figure.axes[2].set_ylabel("[mm]")
    band_legend(figure.axes[2])
    return figure


def figure_11(walks: Sequence[Walk]) -> Figure:
    """Front view of two gaits that differ in c_y, and what the trunk and the momentum do."""
    figure = Figure(figsize=(_WIDTH, 10.5))
    for row, walk in enumerate(walks):
        axis = inches(figure, 0.6, 0.42 + 2.95 * row, _WIDTH - 0.8, _STRIP)
        _strip(axis, figure, walk, FRONT)
        axis.set_title(f"({'ab'[row]}) $c_y$ = {walk.gait.c_y:g}, from the front")
    labels = [f"$c_y$ = {walk.gait.c_y:g}" for walk in walks]
    _compare(figure, 6.9, walks, 0, "roll", labels)
    return figure


def figure_12(walk: Walk, normal: Walk) -> Figure:
    """Side view of a gait with a large angular momentum about the lateral axis, beside the normal one."""
    figure = Figure(figsize=(_WIDTH, 7.55))
    strip = inches(figure, 0.6, 0.42, _WIDTH - 0.8, _STRIP)
    _strip(strip, figure, walk, SIDE)
    gait = walk.gait
    strip.set_title(
        f"$c_s$ = {gait.c_s:g}, steps of {gait.step_length:g} m, $v_0$ = {gait.switching_velocity:g} m/s"
    )
    labels = [f"$c_s$ = {w.gait.c_s:g}" for w in (walk, normal)]
    _compare(figure, 3.95, (walk, normal), 1, "pitch", labels)
    return figure


def _trace(axis: Axes, figure: Figure, walk: Walk) -> None:
    """Bodies at true positions, thin but for those that begin a step; COM of plan, motion and simulation."""
    strides = min(3, len(walk.stride_starts))
    times = walk.stride_starts[0] + walk.stride * np.linspace(0.0, strides, 20 * strides + 1)
    times = times[times <= walk.trial.record.time[-1]]
    bodies = [pose(walk.robot, walk.configuration(time)) for time in times]
    centre = 0.5 * float(bodies[0].com[0] + bodies[-1].com[0])
    low, high = centre - 2.45, centre + 2.45
    scale = _limits(axis, figure, low, high, below=0.16)
    _floor(axis, low, high)
    for index, body in enumerate(bodies):
        slim, alpha = (0.1, 0.55) if index % 10 else (0.75, 1.0)
        draw(axis, body, SIDE, points_per_metre=scale, slim=slim, alpha=alpha)
    at = np.linspace(times[0], times[-1], 400)
    path = walk.plan.sample(at).com
    axis.plot(path[:, 0], path[:, 2], color=PLAN, linewidth=4.6, zorder=5, label="COM, plan")
    ik = of_motion(walk.motion.sample(at, walk.robot), walk.robot, walk.plan).com
    axis.plot(ik[:, 0], ik[:, 2], color=MOTION, linewidth=2.2, zorder=5.5, label="IK")
    com = walk.trial.record.com
    rows = (walk.trial.record.time >= times[0]) & (walk.trial.record.time <= times[-1])
    axis.plot(com[rows, 0], com[rows, 2], color=MEASURED, linewidth=0.9, zorder=6, label="simulation")
    for step in walk.plan.contacts.footsteps:
        if low + 0.2 < step.position[0] < high - 0.2:
            axis.annotate(
                step.foot, (step.position[0], -0.04), ha="center", va="top", fontsize=7.5,
                color=LEFT if step.foot == "left" else RIGHT,
            )  # fmt: skip
    axis.legend(loc="lower right", fontsize=8, ncols=3, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    _metres(axis)
    axis.set_xticks(np.arange(np.ceil(2 * low), 2 * high) / 2)
    axis.spines["bottom"].set_visible(True)
    axis.set_xlabel("x [m]")


def _strip(axis: Axes, figure: Figure, walk: Walk, view: tuple[int, int]) -> None:
    """A stride as frames beside each other, with the measured force on either foot.

    Bodies are simulated; the motion's are thin lines over them, the plan's COM is a ring around theirs.
    """
    spacing = 1.02 if view == SIDE else 0.92
    record, measured = walk.trial.record, walk.trial.measured
    scale = _limits(axis, figure, -0.55 * spacing, (_FRAMES - 0.45) * spacing)
    _floor(axis, -0.55 * spacing, (_FRAMES - 0.45) * spacing)
    # Per step: toe off, two instants of the swing, middle of the double support; then the next toe off.
    single, step = walk.double_supports[0]
    instants = [0.004 * single, 0.35 * single, 0.7 * single, 0.5 * (single + step)]
    times = [*instants, *(step + t for t in instants), 2 * step + instants[0]]
    names = ["toe off", "swing", "swing", "double support"]
    for index, at in enumerate(times):
        time = walk.middle + at
        row = min(int(np.argmin(np.abs(record.time - time))), len(measured.time) - 1)
        body = pose(walk.robot, to_pinocchio(record.q[row], record.qd[row])[0])
        middle = body.com[0] if view == SIDE else 0.0
        shift = index * spacing - float(middle)
        draw(axis, body, view, shift=shift, points_per_metre=scale)
        wanted = walk.motion.sample(record.time[row], walk.robot).q[0]
        outline(axis, pose(walk.robot, wanted), view, MOTION, shift=shift)
        planned = walk.plan.sample(record.time[row]).com[0]
        axis.plot(
            planned[view[0]] + shift, planned[2], "o", markersize=8.5, markerfacecolor="none",
            markeredgecolor=PLAN, markeredgewidth=2.2, zorder=5.9,
        )  # fmt: skip
        mark_com(axis, body, view, shift=shift)
        for foot in range(2):
            force = measured.foot_force[row, foot]
            if force[2] < _LOADED * measured.weight:
                continue
            points = record.point_foot == foot
            load = record.point_force[row][points, 2]
            centre = (load @ record.point_position[row][points]) / load.sum()
            start = np.array([centre[view[0]] + shift, 0.0])
            end = start + force[list(view)] * _WEIGHT_LENGTH / measured.weight
            arrow(axis, start, end, width=1.6, zorder=8)
        axis.text(
            index * spacing, -0.06, f"{100 * at / walk.stride:.0f} %\n{names[index % 4]}", ha="center",
            va="top", fontsize=7.5, color=INK if index % 4 == 3 else FAINT,
        )  # fmt: skip
    axis.plot([], [], color=LEFT, linewidth=3, label="left")
    axis.plot([], [], color=RIGHT, linewidth=3, label="right")
    name = f"ground force (1 body weight: {_WEIGHT_LENGTH:g} m)"
    axis.plot([], [], color=FORCE, linewidth=1.6, label=name)
    axis.plot([], [], color=MOTION, linewidth=0.8, label="IK")
    axis.plot([], [], "o", markersize=6, markerfacecolor="none", markeredgecolor=PLAN, markeredgewidth=2.0,
              label="COM, plan")  # fmt: skip
    axis.legend(
        loc="lower right", fontsize=8, ncols=5, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2,
        columnspacing=1.0, handlelength=1.4, handletextpad=0.4,
    )  # fmt: skip
    _metres(axis)
    # Frames stand beside each other: a scale, and no coordinate.
    right, level = (_FRAMES - 0.47) * spacing, axis.get_ylim()[1] - 0.12
    axis.plot([right - 0.5, right], [level, level], color=INK, linewidth=1.2)
    for x in (right - 0.5, right):
        axis.plot([x, x], [level - 0.025, level + 0.025], color=INK, linewidth=0.8)
    axis.text(right - 0.54, level, "0.5 m", ha="right", va="center", fontsize=8)


def _metres(axis: Axes) -> None:
    """Heights on an axis of their own."""
    axis.set_yticks([0.0, 0.5, 1.0, 1.5])
    axis.set_ylabel("z [m]")


def _stride_axis(axis: Axes, walk: Walk) -> None:
    shade(axis, [(a / walk.stride, b / walk.stride) for a, b in walk.double_supports])
    axis.set_xlim(0.0, 1.0)
    axis.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100"])
    axis.set_xlabel("share of the stride [%]")


def _compare(
    figure: Figure, top: float, walks: Sequence[Walk], component: int, what: str, labels: Sequence[str]
) -> None:
    """Angle of the trunk and angular momentum of two walks, and below them what the simulation adds."""
    panels = [
        [inches(figure, left, top + y, 3.85, height) for y, height in ((0.0, 1.6), (2.1, 0.85))]
        for left in (0.75, 5.5)
    ]
    for axis in (axis for column in panels for axis in column):
        _stride_axis(axis, walks[0])
        axis.axhline(0.0, color=FAINT, linewidth=0.6)
    (left, left_error), (right, right_error) = panels
    name = f"angular_momentum_{'xy'[component]}_rmse"
    tolerances = [walk.limit(name) for walk in walks]
    for walk, label, line, tolerance in zip(walks, labels, _LINES, tolerances, strict=True):
        share, motion, angles = trunk(walk, what)
        curves(left, share, None, motion, angles, label=label, line=line)
        difference(left_error, share, None, angles - motion, line=line)
        share = walk.phase / walk.stride
        planned = walk.plan.sample(walk.stride_starts[0] + walk.phase).angular_momentum[:, component]
        away, errors = walk.deviation["angular_momentum"].component(component)
        motion, simulated = planned + away, planned + errors
        curves(right, share, planned, motion, simulated, tolerance=tolerance, label=label, line=line)
        note = "" if len(set(tolerances)) == 1 else f", {label}"
        difference(right_error, share, away, errors, tolerance=tolerance, unit="N m s", line=line, note=note)
    left.set_title(f"{what} of the trunk, {'to the right' if what == 'roll' else 'forward'} (no plan has it)")
    left.set_ylabel("[°]")
    left_error.set_ylabel("simulation\nless IK [°]")
    right.set_title(f"angular momentum about the COM, $L_{'xy'[component]}$")
    right.set_ylabel("[N m s]")
    right_error.set_ylabel("less plan\n[N m s]")
    for axis in (left, right):
        legend_above(axis, 2)
        axis.set_xlabel("")
        axis.tick_params(labelbottom=False)
    for axis in (left_error, right_error):
        band_legend(axis)


def trunk(walk: Walk, what: str) -> tuple[Array, Array, Array]:
    """Roll or pitch of the trunk over a stride.

    Returns:
        Share of the stride, shape (n,); angle in the motion, (n,), and in the simulation, (strides, n) [°].
    """
    phase, record = walk.phase[::4], walk.trial.record
    motion = np.degrees([_trunk(walk, q, what) for q in walk.motion_sample.q[::4]])
    rows = np.unique([*range(0, len(record.time), 3), len(record.time) - 1])
    states = zip(record.q[rows], record.qd[rows], strict=True)
    angles = np.degrees([_trunk(walk, to_pinocchio(q, qd)[0], what) for q, qd in states])
    return phase / walk.stride, motion, walk.folded(angles, record.time[rows])[:, ::4]


def swing(planned: PlannedWalk) -> dict[str, float]:
    """Planned momentum about the forward axis and the trunk's roll in the motion, without a walk."""
    robot, plan = planned.body.robot, planned.plan
    stride = np.linspace(0.0, 2.0 * float(plan.constants.step_duration), 200, endpoint=False)
    roll = [pose(robot, q).trunk_roll for q in planned.motion.sample(stride, robot).q]
    momentum = plan.sample(stride[stride <= plan.duration]).angular_momentum[:, 0]
    return {
        "planned_L_x_peak_Nms": float(np.abs(momentum).max()),
        "trunk_roll_swing_deg": float(np.degrees(np.ptp(roll))),
    }


def _trunk(walk: Walk, q: Array, what: str) -> float:
    body = pose(walk.robot, q)
    return body.trunk_roll if what == "roll" else body.trunk_pitch


def _limits(axis: Axes, figure: Figure, low: float, high: float, below: float = 0.36) -> float:
    """Set equal scales from the width, the floor near the bottom; return points per metre."""
    box = axis.get_position()
    width, height = box.width * figure.get_figwidth(), box.height * figure.get_figheight()
    metres = (high - low) * height / width
    axis.set_xlim(low, high)
    axis.set_ylim(-below, metres - below)
    bare(axis)
    return 72.0 * width / (high - low)


def _floor(axis: Axes, low: float, high: float) -> None:
    axis.fill_between([low, high], -0.03, 0.0, color=SHADE, linewidth=0, zorder=0)
    axis.plot([low, high], [0, 0], color=FAINT, linewidth=0.8, zorder=1)


def numbers(walk: Walk) -> dict[str, float]:
    """Largest trunk angles [°] and momenta [N m s] of a gait in the simulation."""
    roll, pitch = (trunk(walk, what) for what in ("roll", "pitch"))
    measured = np.abs(walk.folded(walk.trial.measured.angular_momentum)).max(axis=(0, 1))
    planned = np.abs(walk.plan.sample(walk.middle + walk.phase).angular_momentum).max(axis=0)
    return {
        "trunk_roll_largest_deg": float(np.abs(roll[2]).max()),
        "trunk_pitch_smallest_deg": float(pitch[2].min()),
        "trunk_pitch_largest_deg": float(pitch[2].max()),
        **{
            f"trunk_{what}_simulation_less_ik_deg": float(np.abs(simulated - motion).max())
            for what, (_, motion, simulated) in (("roll", roll), ("pitch", pitch))
        },
        **{
            f"L_{axis}_{who}_less_plan_Nms": float(np.abs(values).max())
            for k, axis in enumerate("xy")
            for who, values in zip(
                ("ik", "simulation"), walk.deviation["angular_momentum"].component(k), strict=True
            )
        },
        **{f"planned_L_{axis}_peak_Nms": float(planned[k]) for k, axis in enumerate("xy")},
        **{f"measured_L_{axis}_peak_Nms": float(measured[k]) for k, axis in enumerate("xyz")},
    }
