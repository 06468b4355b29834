"""Figures 8, 11 and 12: bodies in motion, posed from the simulated joint angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.bridge import to_pinocchio
from validation.paper_figures.canvas import (
    FAINT,
    FORCE,
    INK,
    LEFT,
    MEASURED,
    PLAN,
    RIGHT,
    SHADE,
    arrow,
    bare,
    inches,
    legend_above,
    shade,
)
from validation.paper_figures.skeleton import FRONT, SIDE, draw, mark_com, pose
from validation.paper_figures.walks import Walk

Array = NDArray[np.float64]

_WIDTH = 9.6
_WEIGHT_LENGTH = 0.55
_FRAMES = 9
_STRIP = 2.3  # height of a strip of frames [in]
_LOADED = 0.08
"""Share of the weight from which on a foot's force is drawn: an arrow needs room for its head [1]."""


def figure_8(walk: Walk) -> Figure:
    """Side view of a gait: a trace in place, and a stride frame by frame with the ground forces."""
    figure = Figure(figsize=(_WIDTH, 7.35))
    trace, strip = (
        inches(figure, 0.2, 0.42, _WIDTH - 0.4, 3.8),
        inches(figure, 0.2, 4.75, _WIDTH - 0.4, _STRIP),
    )
    _trace(trace, figure, walk)
    trace.set_title("Simulated gait where it was walked, every tenth of a step")
    _strip(strip, figure, walk, SIDE)
    strip.set_title(f"One stride, frame by frame (ground force: 1 body weight = {_WEIGHT_LENGTH:g} m)")
    return figure


def figure_11(walks: Sequence[Walk]) -> Figure:
    """Front view of two gaits that differ in c_y, and what the trunk and the momentum do."""
    figure = Figure(figsize=(_WIDTH, 8.55))
    for row, walk in enumerate(walks):
        axis = inches(figure, 0.2, 0.42 + 2.75 * row, _WIDTH - 0.4, _STRIP)
        _strip(axis, figure, walk, FRONT)
        axis.set_title(f"({'ab'[row]}) $c_y$ = {walk.plan.parameters.c_y:g}, seen from the front")
    left, right = inches(figure, 0.7, 6.4, 3.9, 1.65), inches(figure, 5.5, 6.4, 3.9, 1.65)
    _compare(left, right, walks, 0, "roll", [f"$c_y$ = {walk.plan.parameters.c_y:g}" for walk in walks])
    return figure


def figure_12(walk: Walk, normal: Walk) -> Figure:
    """Side view of a gait with a large angular momentum about the lateral axis, beside the normal one."""
    figure = Figure(figsize=(_WIDTH, 6.15))
    strip = inches(figure, 0.2, 0.42, _WIDTH - 0.4, _STRIP)
    _strip(strip, figure, walk, SIDE)
    gait = walk.plan.parameters
    strip.set_title(
        f"$c_s$ = {gait.c_s:g}, steps of {gait.step_length:g} m, $v_0$ = {gait.switching_velocity:g} m/s"
    )
    left, right = inches(figure, 0.7, 3.75, 3.9, 1.9), inches(figure, 5.5, 3.75, 3.9, 1.9)
    _compare(
        left,
        right,
        (walk, normal),
        1,
        "pitch",
        [f"$c_s$ = {w.plan.parameters.c_s:g}" for w in (walk, normal)],
    )
    return figure


def _trace(axis: Axes, figure: Figure, walk: Walk) -> None:
    """Bodies at true positions, drawn thin, those that begin a step whole."""
    strides = min(3, len(walk.stride_starts))
    times = walk.stride_starts[0] + walk.stride * np.linspace(0.0, strides, 20 * strides + 1)
    times = times[times <= walk.trial.record.time[-1]]
    bodies = [pose(walk.robot, walk.configuration(time)) for time in times]
    centre = 0.5 * float(bodies[0].com[0] + bodies[-1].com[0])
    low, high = centre - 2.45, centre + 2.45
    scale = _limits(axis, figure, low, high)
    _floor(axis, low, high)
    for index, body in enumerate(bodies):
        whole = index % 10 == 0
        draw(
            axis,
            body,
            SIDE,
            points_per_metre=scale,
            slim=0.75 if whole else 0.1,
            alpha=1.0 if whole else 0.55,
        )
    path = walk.plan.sample(np.linspace(times[0], times[-1], 400)).com
    axis.plot(path[:, 0], path[:, 2], color=PLAN, linewidth=3.2, zorder=5, label="planned COM")
    com = walk.trial.record.com
    rows = (walk.trial.record.time >= times[0]) & (walk.trial.record.time <= times[-1])
    axis.plot(com[rows, 0], com[rows, 2], color=MEASURED, linewidth=0.9, zorder=6, label="simulated COM")
    for step in walk.plan.footsteps:
        if low + 0.2 < step.position[0] < high - 0.2:
            axis.annotate(
                step.foot, (step.position[0], -0.05), ha="center", va="top", fontsize=7.5,
                color=LEFT if step.foot == "left" else RIGHT,
            )  # fmt: skip
    axis.legend(loc="lower right", fontsize=8, ncols=2, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def _strip(axis: Axes, figure: Figure, walk: Walk, view: tuple[int, int]) -> None:
    """A stride as frames beside each other, with the measured force on either foot."""
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
        mark_com(axis, body, view, shift=shift)
        for foot in range(2):
            force = measured.foot_force[row, foot]
            if force[2] < _LOADED * measured.weight:
                continue
            points = record.point_foot == foot
            load = record.point_force[row][points, 2]
            centre = (load @ record.point_position[row][points]) / load.sum()
            start = np.array([centre[view[0]] + shift, 0.0])
            arrow(
                axis, start, start + force[list(view)] * _WEIGHT_LENGTH / measured.weight, width=1.6, zorder=8
            )
        axis.text(
            index * spacing, -0.06, f"{100 * at / walk.stride:.0f} %\n{names[index % 4]}", ha="center",
            va="top", fontsize=7.5, color=INK if index % 4 == 3 else FAINT,
        )  # fmt: skip
    axis.plot([], [], color=LEFT, linewidth=3, label="left")
    axis.plot([], [], color=RIGHT, linewidth=3, label="right")
    axis.plot([], [], color=FORCE, linewidth=1.6, label="ground force")
    axis.legend(loc="lower right", fontsize=8, ncols=3, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def _compare(
    left: Axes, right: Axes, walks: Sequence[Walk], component: int, what: str, labels: Sequence[str]
) -> None:
    """Angle of the trunk, and angular momentum, of two walks: plan, motion and simulation."""
    for axis in (left, right):
        axis.axhline(0.0, color=FAINT, linewidth=0.6)
        shade(axis, [(a / walks[0].stride, b / walks[0].stride) for a, b in walks[0].double_supports])
        axis.set_xlim(0.0, 1.0)
        axis.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100"])
        axis.set_xlabel("share of the stride [%]")
    for walk, label, line in zip(walks, labels, ("-", (0, (4, 2))), strict=True):
        share = walk.phase / walk.stride
        rows = slice(None, None, 4)
        simulated = np.degrees(
            [_trunk(walk, walk.configuration(walk.middle + t), what) for t in walk.phase[rows]]
        )
        motion = np.degrees([_trunk(walk, q, what) for q in walk.motion_sample.q[rows]])
        left.plot(share[rows], motion, color=PLAN, linewidth=3.4, linestyle=line, label=f"IK, {label}")
        left.plot(
            share[rows],
            simulated,
            color=MEASURED,
            linewidth=1.1,
            linestyle=line,
            label=f"simulation, {label}",
        )
        planned = walk.plan.sample(walk.middle + walk.phase).angular_momentum[:, component]
        measured = walk.folded(walk.trial.measured.angular_momentum[:, component])
        right.plot(share, planned, color=PLAN, linewidth=3.4, linestyle=line, label=f"plan, {label}")
        right.plot(share, measured.mean(axis=0), color=MEASURED, linewidth=1.0, linestyle=line,
                   label=f"simulation, {label}")  # fmt: skip
    left.set_title(f"{what} of the trunk")
    left.set_ylabel(f"{'to the right' if what == 'roll' else 'forward'} [°]")
    axis_name = "xy"[component]
    right.set_title(f"angular momentum about the COM, $L_{axis_name}$")
    right.set_ylabel("[N m s]")
    legend_above(left, 2)
    legend_above(right, 2)


def _trunk(walk: Walk, q: Array, what: str) -> float:
    body = pose(walk.robot, q)
    return body.trunk_roll if what == "roll" else body.trunk_pitch


def _limits(axis: Axes, figure: Figure, low: float, high: float) -> float:
    """Set equal scales from the width, the floor near the bottom; return points per metre."""
    box = axis.get_position()
    width, height = box.width * figure.get_figwidth(), box.height * figure.get_figheight()
    metres = (high - low) * height / width
    axis.set_xlim(low, high)
    axis.set_ylim(-0.36, metres - 0.36)
    bare(axis)
    return 72.0 * width / (high - low)


def _floor(axis: Axes, low: float, high: float) -> None:
    axis.fill_between([low, high], -0.03, 0.0, color=SHADE, linewidth=0, zorder=0)
    axis.plot([low, high], [0, 0], color=FAINT, linewidth=0.8, zorder=1)


def numbers(walk: Walk) -> dict[str, float]:
    """What a gait's trunk and momentum do, in the simulation: largest angles [°] and momenta [N m s]."""
    angles = np.array(
        [
            [body.trunk_roll, body.trunk_pitch]
            for body in (pose(walk.robot, walk.configuration(walk.middle + t)) for t in walk.phase[::4])
        ]
    )
    measured = np.abs(walk.folded(walk.trial.measured.angular_momentum)).max(axis=(0, 1))
    planned = np.abs(walk.plan.sample(walk.middle + walk.phase).angular_momentum).max(axis=0)
    roll, pitch = np.degrees(angles).T
    return {
        "trunk_roll_largest_deg": float(np.abs(roll).max()),
        "trunk_pitch_smallest_deg": float(pitch.min()),
        "trunk_pitch_largest_deg": float(pitch.max()),
        **{f"planned_L_{axis}_peak_Nms": float(planned[k]) for k, axis in enumerate("xy")},
        **{f"measured_L_{axis}_peak_Nms": float(measured[k]) for k, axis in enumerate("xyz")},
    }
