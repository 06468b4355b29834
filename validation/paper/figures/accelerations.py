"""Figures 9 and 10: accelerations of the COM and of hip and knee, in plan, motion and physics."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampm.geometry import Array
from validation.paper.figures.canvas import (
    MEASURED,
    band_legend,
    curves,
    difference,
    inches,
    legend_above,
    shade,
)
from validation.paper.figures.walks import Numbers, Walk, Walks, agreement, less_plan

SMOOTHING = 0.01
"""Interval over which differences of recorded joint velocities are taken for the dark curve [s]."""


def com_accelerations(walk: Walk) -> tuple[Array, Array, Array]:
    """COM acceleration of plan and motion over a stride, (n, 3), and measured ones, (strides, n, 3) [m/s^2].

    The measured one is the net contact force over the mass, less gravity: no derivative is taken.
    """
    planned = walk.plan.sample(walk.stride_starts[0] + walk.phase).com_acceleration
    measured = walk.trial.measured
    force = walk.folded(measured.force / measured.mass)
    return planned, walk.ik.acceleration, force - np.array([0.0, 0.0, measured.gravity])


def figure_9(walks: Walks) -> tuple[Figure, Numbers]:
    """COM acceleration along the forward and the lateral axis over one stride."""
    walk = walks.walk("normal")
    planned, motion, measured = com_accelerations(walk)
    figure, axes = _paper(walk)
    numbers: Numbers = {}
    source = f"simulation (contact force / m), mean of {len(measured)} strides"
    for row, (axis, letter, name) in enumerate((("x", "a", "forward"), ("y", "b", "lateral"))):
        upper, lower = axes[2 * row : 2 * row + 2]
        plan, ik, seen = planned[:, row], motion[:, row], measured[..., row]
        tolerance = walk.limit(f"force_{axis}_rmse") / walk.plan.mass
        curves(upper, walk.phase, plan, ik, seen, tolerance=tolerance, source=source)
        upper.set_title(f"({letter}) COM acceleration along the {name} axis")
        upper.set_ylabel(f"$\\ddot{{{axis}}}_g$ [m/s²]")
        difference(lower, walk.phase, ik - plan, seen - plan, tolerance=tolerance, unit="m/s²")
        lower.set_ylabel("less plan")
        band_legend(lower)
        numbers |= less_plan(f"COM acceleration {axis}", ik - plan, seen - plan, "m/s²")
    legend_above(axes[0])
    return figure, numbers


def joint_accelerations(walk: Walk, joint: str, sign: float) -> tuple[Array, Array, Array]:
    """Acceleration of one hinge: of the motion (n,), and of the simulation, raw and smoothed (strides, n).

    The recorded velocities are differenced over one time step, and over :data:`SMOOTHING`; both are central.
    """
    record = walk.trial.record
    time, dt = record.time, record.time_step
    velocity = sign * record.qd[:, 6 + record.joint_names.index(joint)]
    motion = sign * walk.motion_sample.acceleration[:, walk.robot.velocity_indices((joint,))[0]]
    raw, smooth = (
        walk.folded((velocity[n:] - velocity[:-n]) / (n * dt), 0.5 * (time[n:] + time[:-n]))
        for n in (1, max(2, round(SMOOTHING / dt)))
    )
    return motion, raw, smooth


def figure_10(walks: Walks) -> tuple[Figure, Numbers]:
    """Flexion accelerations of the left hip and knee over one stride."""
    walk = walks.walk("normal")
    leg = walk.robot.description.left_leg
    figure, axes = _paper(walk)
    numbers: Numbers = {}
    over = f"{1e3 * SMOOTHING:.0f} ms"
    # A positive rotation about +y extends the hip and flexes the knee.
    for row, (name, joint, sign) in enumerate((("hip", leg.hip[0], -1.0), ("knee", leg.knee, 1.0))):
        motion, raw, smooth = joint_accelerations(walk, joint, sign)
        upper, lower = axes[2 * row : 2 * row + 2]
        upper.plot(walk.phase, raw[len(raw) // 2], color=MEASURED, linewidth=0.5, alpha=0.5,
                   label="simulation, per time step")  # fmt: skip
        curves(upper, walk.phase, None, motion, smooth, source=f"simulation, over {over}")
        upper.plot([], [], linestyle="", label="(no plan: it has no joints)")
        reach = 1.35 * max(float(np.abs(smooth).max()), float(np.abs(motion).max()))
        upper.set_ylim(-reach, reach)
        upper.set_title(f"({'ab'[row]}) angular acceleration of flexion of the left {name}")
        upper.set_ylabel(f"{name} [rad/s²]")
        difference(lower, walk.phase, None, smooth - motion)
        lower.set_ylabel("less IK")
        band_legend(lower)
        numbers[f"{name} acceleration: simulation ({over}) less IK"] = agreement(smooth - motion, "rad/s²")
    legend_above(axes[0])
    return figure, numbers


def _paper(walk: Walk) -> tuple[Figure, list[Axes]]:
    """Two curves, each over its own error, on common times."""
    figure = Figure(figsize=(8.4, 8.0))
    places = ((0.52, 2.0), (2.82, 0.85), (4.25, 2.0), (6.55, 0.85))
    axes = [inches(figure, 0.8, top, 7.45, height) for top, height in places]
    for axis in axes:
        shade(axis, walk.double_supports)
        axis.set_xlim(0.0, walk.stride)
        axis.tick_params(labelbottom=axis is axes[-1])
        axis.yaxis.set_label_coords(-0.072, 0.5)
    axes[-1].set_xlabel("time from the start of left single support [s]; double support shaded")
    return figure, axes
